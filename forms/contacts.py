"""All contact of a body together: with obstacles, and of its surface with itself."""

from __future__ import annotations

from collections.abc import Sequence
from math import factorial
from typing import TYPE_CHECKING, Any, Protocol

from numpy.typing import NDArray
from petsc4py import PETSc

from .newton import StepFailure
from .space import Space

if TYPE_CHECKING:
    from scipy.sparse import csr_array

    from extremal.obstacles.colliders import Collider

REACH = 0.1  # of a cell: the distance d̂ below which what comes close is pushed away
STILL = 0.01  # of d̂: what slides by less in a step is held by less than μ λ
FOLLOWED = 1e-2  # relative change of the normal forces at which friction has followed them


class Part(Protocol):
    """One kind of contact. All is collective; displacements are local values."""

    def energy(self) -> float:
        """Energy at the displacement of the space [J]; infinite where something was crossed since the search began."""

    def add_force(self, out: PETSc.Vec) -> None:
        """out += gradient of `energy`; not a number where that is infinite."""

    def add_tangent(self, matrix: PETSc.Mat, projected: bool) -> None:
        """matrix += what of the Hessian its pattern has place for; a search along a line begins here."""

    def search_from(self, u: NDArray) -> None:
        """Searches begin at displacement `u`."""

    def fits(self, u: NDArray) -> bool:
        """Whether the body may go to displacement `u` from where the search began."""

    def clear(self, u: NDArray, time: float) -> bool:
        """Whether contact may begin at displacement `u` and `time` [s]."""

    def begin(self, u: NDArray, start: float, time: float) -> NDArray:
        """Begin a step at `start` that meets what there is at `time` [s]; returns `u` as that leaves it."""

    def set_time(self, time: float) -> None:
        """Put what moves where it is at `time` [s]."""

    def follow(self) -> bool:
        """Take the present normal forces into friction; whether they are hardly new."""

    def check(self, u: NDArray) -> None:
        """Raise LawError where the body cannot start at displacement `u`."""

    def diagnostics(self, u: NDArray, time: float, active: bool) -> dict[str, float]:
        """smallest_gap [m], contact_force [N] and what is its own."""

    def barrier_energy(self, u: NDArray, time: float) -> float:
        """What contact can give back [J]."""

    @property
    def at_rest(self) -> bool:
        """Whether nothing that is met ever moves by itself."""


class Coupling(Part, Protocol):
    """Contact between nodes that have no cell in common."""

    def coupling(self, projected: bool) -> csr_array:
        """Hessian in the rows that this rank owns, without prescribed ones, positive semi-definite if asked."""

    def add_linear(self, change: NDArray, out: PETSc.Vec) -> None:
        """out += positive semi-definite Hessian times `change`."""


class Contacts:
    """Contact with obstacles, of the surface with itself, or both.

    Parameters
    ----------
    obstacles : Part or None
    surface : Coupling or None
    after : str or None
        "untangled": contact begins when no element is inverted, no node in an obstacle and nothing intersects;
        None: at once.

    Attributes
    ----------
    active : bool
        Whether contact has begun.
    """

    def __init__(self, obstacles: Part | None, surface: Coupling | None, after: str | None = None) -> None:
        self.surface, self.active = surface, after is None
        self._parts: Sequence[Part] = [part for part in (obstacles, surface) if part is not None]

    def energy(self) -> float:
        """Energy at the displacement of the space [J]; infinite where something has been crossed."""
        total = 0.0
        for part in self._parts if self.active else ():
            total += part.energy()
            if total == float("inf"):
                break
        return total

    def add_force(self, out: PETSc.Vec) -> None:
        """out += gradient of `energy`; not a number where something has been crossed."""
        for part in self._parts if self.active else ():
            part.add_force(out)

    def add_tangent(self, matrix: PETSc.Mat, projected: bool) -> None:
        """matrix += Hessian as far as its pattern goes; a search along a line from here may not cross anything."""
        for part in self._parts if self.active else ():
            part.add_tangent(matrix, projected)

    def coupling(self, projected: bool) -> csr_array | None:
        """Hessian of the surface's contact with itself in the rows of this rank, as the surface says; None: none."""
        return self.surface.coupling(projected) if self.active and self.surface is not None else None

    def add_linear(self, change: NDArray, out: PETSc.Vec) -> None:
        """out += Hessian of the surface's contact with itself times `change` (local values)."""
        if self.active and self.surface is not None:
            self.surface.add_linear(change, out)

    def search_from(self, u: NDArray) -> None:
        """Searches begin at displacement `u` (local values)."""
        for part in self._parts if self.active else ():
            part.search_from(u)

    def fits(self, u: NDArray) -> bool:
        """Whether the body may go to displacement `u` (local values) from where the search began."""
        return not self.active or all(part.fits(u) for part in self._parts)

    def begin(self, u: NDArray, start: float, time: float, untangled: bool) -> NDArray:
        """Begin a step from displacement `u` (local values) at `start` [s] that meets what there is at `time` [s].

        Contact begins with it if the body is `untangled` and nothing is inside of anything.

        Returns
        -------
        (local nodes * d,)
            The displacement with those nodes moved that obstacles have come upon.

        Raises
        ------
        StepFailure
            On all ranks, where there is no room for that.
        """
        self.active = self.active or (untangled and all(part.clear(u, start) for part in self._parts))
        self.set_time(time)
        if not self.active:
            return u
        for part in self._parts:
            part.search_from(u)
        for part in self._parts:
            pushed = part.begin(u, start, time)
            if pushed is not u and not self.fits(pushed):
                raise StepFailure("an obstacle pushes parts of the surface through each other in one step")
            u = pushed
        return u

    def set_time(self, time: float) -> None:
        """Put what moves where it is at `time` [s]."""
        for part in self._parts:
            part.set_time(time)

    def follow(self) -> bool:
        """Take normal forces at the displacement of the space into friction; whether they are hardly new."""
        return not self.active or all([part.follow() for part in self._parts])

    @property
    def at_rest(self) -> bool:
        """Whether nothing that is met ever moves by itself."""
        return all(part.at_rest for part in self._parts)

    def check(self, u: NDArray) -> None:
        """Refuse a start in which something is inside of something, if contact begins with it.

        Raises
        ------
        LawError
            On all ranks, naming what and where.
        """
        for part in self._parts if self.active else ():
            part.check(u)

    def diagnostics(self, u: NDArray, time: float) -> dict[str, float]:
        """smallest_gap [m], contact_force [N], and intersections of the surface with itself."""
        total: dict[str, float] = {"smallest_gap": float("inf"), "contact_force": 0.0}
        for part in self._parts:
            found = part.diagnostics(u, time, self.active)
            gap = min(total["smallest_gap"], found.pop("smallest_gap"))
            force = total["contact_force"] + found.pop("contact_force")
            total |= {"smallest_gap": gap, "contact_force": force, **found}
        return total

    def barrier_energy(self, u: NDArray, time: float) -> float:
        """Energy of barriers [J], what contact can give back."""
        return sum(part.barrier_energy(u, time) for part in self._parts) if self.active else 0.0


def made(
    space: Space,
    obstacles: Sequence[Collider],
    held: NDArray,
    young_modulus: float,
    *,
    after: str | None = None,
    self: bool = False,
    friction: float = 0.0,
    distance: float | None = None,
    stiffness: float = 1.0,
) -> Contacts:
    """Contact with obstacles if there are any, of the surface with itself if `self`; see `Contact`, `SelfContact`."""
    how: Any = {"distance": distance, "stiffness": stiffness}
    met: Part | None = None
    surface: Coupling | None = None
    if obstacles:
        from .contact import Contact

        met = Contact(space, obstacles, held, young_modulus, **how)
    if self:
        from .self_contact import SelfContact

        surface = SelfContact(space, held, young_modulus, friction=friction, **how)
    return Contacts(met, surface, after)


def mean_edge(space: Space) -> float:
    """Edge of the cells of a regular grid with as many cells as the body [m] (collective)."""
    d, volume = space.dimension, space.comm.allreduce(float(space.weights().sum()))
    return float((volume / space.comm.allreduce(space.cells) * factorial(d)) ** (1 / d))
