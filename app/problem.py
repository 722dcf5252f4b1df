"""What a part of the application must offer so that a session can run it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, Protocol

if TYPE_CHECKING:
    from mpi4py import MPI
    from numpy.typing import NDArray


class Problem(Protocol):
    """What a session drives; every method is collective.

    Attributes
    ----------
    time : float
        Time [s] or load parameter.
    effects : dict
        Effects that are on, with facts about each.
    size : int
        Degrees of freedom, particles or slots.
    on_iteration : callable, optional
        Set by the session; called on all ranks with figures of each solver iteration.
    """

    comm: MPI.Comm
    time: float
    effects: dict[str, dict[str, float]]
    size: int
    on_iteration: Callable[[dict[str, float]], None] | None

    def advance(self, dt: float) -> dict[str, float]:
        """Make one step to `time + dt`, or raise ArithmeticError on all ranks with the state as before."""
        ...

    def diagnostics(self) -> dict[str, float]:
        """Return the columns of history.csv, or raise ArithmeticError on all ranks: the state is worth nothing."""
        ...

    def state(self) -> dict[str, NDArray[Any]]:
        """Return on rank 0 everything `restore` needs, in an order that does not depend on the ranks."""
        ...

    def restore(self, state: dict[str, NDArray[Any]]) -> None:
        """Take over a state from rank 0, or raise ValueError on all ranks: something is missing in it."""
        ...

    def geometry(self) -> tuple[NDArray[Any], NDArray[Any], str] | None:
        """Return on rank 0 points (n, 3) [m], cells (m, k), their meshio name; None elsewhere or meshless."""
        ...

    def fields(
        self, names: Sequence[str] | None = None
    ) -> tuple[dict[str, NDArray[Any]], dict[str, NDArray[Any]]] | None:
        """Return on rank 0 the fields at points and in cells."""
        ...


class ParticleProblem(Problem, Protocol):
    """A problem without a mesh: what moves is particles. `geometry` and `fields` return None.

    Attributes
    ----------
    h : float
        Edge of a cell of the background grid [m].
    solid : Problem, optional
        Only where there is one: a body with a mesh, whose fields are written too.
    """

    h: float

    def particle_fields(self, names: Sequence[str] | None = None) -> dict[str, NDArray[Any]] | None:
        """Return on rank 0 "points", (n, 3) [m], and the fields asked for, in the order of `state`."""
        ...


class TabularProblem(Problem, Protocol):
    """A problem whose result is tables. `geometry` and `fields` return None."""

    def tables(self) -> dict[str, dict[str, Sequence[Any]]]:
        """Return on rank 0 columns by their names, by the names of CSV files; {} elsewhere."""
        ...
