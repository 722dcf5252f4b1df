"""A run on a network: rounds of estimation, if asked for, then the reconstruction."""

from __future__ import annotations

import math
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray
from petsc4py import PETSc

from .enumeration import scores_by_enumeration
from .events import Events, Network
from .gibbs import gibbs
from .meanfield import mean_field, of_all, of_incomplete
from .normalised import normalised
from .reconstruct import ReconstructionError, check_options, reconstruct
from .relaxations import Hybrid, Power, relax
from .slots import Slots

if TYPE_CHECKING:
    from .estimate import Estimation

NAMES = ("background", "branching", "decay")
NOT_A_NUMBER = (72, 83)  # PETSC_ERR_FP and PETSC_ERR_USER, which TAO gives for it


@dataclass(frozen=True)
class Method:
    """How the participants are found.

    Attributes
    ----------
    gap, sweeps
        Of `reconstruct`, for (3.5).
    constraint : Power or Hybrid, optional
        Another normalisation of the weights than that of (3.5).
    normalised : bool
        Maximise (3.4) instead.
    probabilities : {"mean_field", "gibbs", "exact", "none"}
    samples, seed : int
        Of `gibbs`.
    """

    gap: float = 1e-8
    sweeps: int = 5
    constraint: Power | Hybrid | None = None
    normalised: bool = False
    probabilities: str = "mean_field"
    samples: int = 200
    seed: int = 1


class HawkesProblem:
    """What a session drives: each step but the last is a round of estimation, the last is the reconstruction.

    Parameters
    ----------
    comm : mpi4py.MPI.Comm
    network, events
        The same on all ranks.
    method : Method
    estimation : Estimation, optional
        What improves the parameters; those of `network` are right otherwise.
    rounds : int
        Of estimation.

    Attributes
    ----------
    time : float
        Rounds made.
    network : Network
        With the parameters as they are by now.
    slots : Slots
        Of the incomplete events.
    outside : (n,) int64
        Complete events on what is no active pair of the network: they have no part in anything.
    weights, probabilities : (S,), optional
        The answer.
    found : dict
        Energy and, of (3.5), relative gap and TAO's iterations; empty before.
    """

    def __init__(
        self,
        comm: MPI.Comm,
        network: Network,
        events: Events,
        method: Method,
        estimation: Estimation | None = None,
        rounds: int = 0,
    ) -> None:
        check_options()
        self.comm, self.network, self.events, self.method = comm, network, events, method
        self.estimation, self.rounds = estimation, rounds
        if estimation is not None:
            self.network = estimation.network
        self.time = 0.0
        self.on_iteration: Callable[[dict[str, float]], None] | None = None
        self.slots = Slots.build(comm, network, events)
        complete = np.flatnonzero(~events.incomplete)
        pair = network.number(*events.participants[complete].T)
        self.outside = complete[(pair < 0) | ~network.active[pair]]
        self.weights: NDArray | None = None
        self.probabilities: NDArray | None = None
        self.found: dict[str, float] = {}
        self.size = int(self._count_slots())
        self.effects: dict[str, dict[str, float]] = {"reconstruction": {"slots": self.size}}
        if method.probabilities != "none":
            self.effects[method.probabilities] = {}
        if estimation is not None:
            self.effects["estimation"] = {"rounds": rounds}

    def _count_slots(self) -> float:
        return float(self.comm.allreduce(len(self.slots)))

    # ------------------------------------------------------------------ steps

    def advance(self, dt: float) -> dict[str, float]:
        """Make one round, or the reconstruction if that is what is left (collective).

        Raises
        ------
        ReconstructionError
            On all ranks, where (3.5) is not solved to the gap asked for; the weights reached are kept.
        """
        if self.time < self.rounds:
            self._estimate()
            return {}
        with PETSc.Log.Event("hawkes:reconstruction"):
            figures = self._reconstruct()
        if self.method.probabilities != "none":
            with PETSc.Log.Event(f"hawkes:{self.method.probabilities}"):
                self._find_probabilities()
        return figures

    def _estimate(self) -> None:
        assert self.estimation is not None
        with PETSc.Log.Event("hawkes:estimation"):
            self.estimation.step()
        self.network = self.estimation.network

    def _reconstruct(self) -> dict[str, float]:
        if self.estimation is not None:
            self.slots = Slots.build(self.comm, self.network, self.events)
        m = self.method
        if m.normalised:
            everything = Slots.build(self.comm, self.network, self.events, complete=True)
            answer = normalised(everything)
            self.weights = of_incomplete(everything, self.slots, answer.weights)
            self.found = {"energy": answer.value}
            if answer.reason < 0:
                raise ArithmeticError(f"TAO ended with reason {answer.reason} after {answer.iterations} iterations")
            return {"tao_iterations": answer.iterations}
        if m.constraint is not None:
            relaxed = relax(self.slots, m.constraint)
            self.weights, self.found = relaxed.weights, {"energy": relaxed.energy}
            return {"relaxation_iterations": relaxed.rounds}
        try:
            solved = reconstruct(self.slots, gap=m.gap, sweeps=m.sweeps, start=self.weights, monitor=self._monitor)
        except ReconstructionError as error:
            self.weights = error.reached.weights
            error.wanted_step = math.inf  # type: ignore[attr-defined]
            raise
        except PETSc.Error as error:
            if error.ierr not in NOT_A_NUMBER:
                raise
            raise ArithmeticError("the energy overflows: background, branching and decay are too far apart") from error
        self.weights = solved.weights
        self.found = {"energy": solved.energy, "gap": solved.relative_gap, "tao_iterations": solved.iterations}
        return {"tao_iterations": solved.iterations}

    def _monitor(self, figures: dict[str, float]) -> None:
        if self.on_iteration is not None:
            energy = figures["energy"]
            self.on_iteration(figures | {"gap": figures["gap"] / energy if energy > 0 else 0.0})

    def _find_probabilities(self) -> None:
        m, slots = self.method, self.slots
        if m.probabilities == "gibbs":
            self.probabilities = gibbs(slots, sweeps=m.samples, seed=m.seed)
        elif m.probabilities == "exact":
            self.probabilities = scores_by_enumeration(slots, compensator=True)
        else:
            everything = Slots.build(self.comm, self.network, self.events, complete=True)
            # the answer of (3.5) is a good beginning where excitation is strong
            start = None
            if m.constraint is None and not m.normalised and self.weights is not None:
                start = of_all(everything, slots, self.weights**2)
            self.probabilities = of_incomplete(everything, slots, mean_field(everything, start=start))

    # ------------------------------------------------------------------ what a session asks

    def diagnostics(self) -> dict[str, float]:
        """Counts, means of the parameters over active pairs, and what is known of the answer (collective)."""
        found = {
            "events": float(len(self.events)),
            "incomplete": float(self.events.incomplete.sum()),
            "unresolvable": float(len(self.slots.unresolvable) + len(self.outside)),
            "slots": self._count_slots(),
            **_means(self.network),
            "supercritical": float((self.network.branching >= 1).sum()),
        }
        if self.estimation is not None and math.isfinite(self.estimation.drift):
            found["drift"] = self.estimation.drift
        return found | self.found

    def standard_errors(self) -> dict[str, NDArray] | None:
        """Of the parameters of each pair (K,), where they were estimated (collective)."""
        if self.estimation is None:
            return None
        with PETSc.Log.Event("hawkes:estimation:errors"):
            return self.estimation.standard_errors()

    def state(self) -> dict[str, NDArray[Any]]:
        """Parameters, estimation and answer, on rank 0 (collective)."""
        parts = {"data": _digest(self.network, self.events)}
        parts |= {name: getattr(self.network, name) for name in NAMES}
        parts |= {f"found_{name}": np.array(value) for name, value in self.found.items()}
        if self.estimation is not None:
            parts |= {f"estimation_{name}": values for name, values in self.estimation.state().items()}
        for name in ("weights", "probabilities"):
            values = getattr(self, name)
            if values is not None:
                parts[name] = self.slots.gather(values)
        return parts

    def restore(self, state: dict[str, NDArray[Any]]) -> None:
        """Take over rank 0's state (collective).

        Raises
        ------
        ValueError
            On all ranks, if it is of other data.
        """
        large = {name: state.get(name) for name in ("weights", "probabilities")}
        small = self.comm.bcast({name: values for name, values in state.items() if name not in large})
        present = self.comm.bcast([name for name, values in large.items() if values is not None])
        if not np.array_equal(small["data"], _digest(self.network, self.events)):
            raise ValueError("network or events have been changed since")
        self.network = self.network.with_parameters(*(small[n] for n in NAMES))
        self.slots = Slots.build(self.comm, self.network, self.events)
        prefix = "estimation_"
        if self.estimation is not None:
            own = {name.removeprefix(prefix): v for name, v in small.items() if name.startswith(prefix)}
            self.estimation.restore(own)
        self.found = {n.removeprefix("found_"): float(v) for n, v in small.items() if n.startswith("found_")}
        for name in present:
            setattr(self, name, self.slots.scatter(large[name]))

    def geometry(self) -> None:
        """Nothing with a mesh."""

    def fields(self, names: Any = None) -> None:
        """Nothing with fields."""


def _means(network: Network) -> dict[str, float]:
    active = network.active
    return {name: float(np.average(getattr(network, name), weights=active)) if active.any() else 0.0 for name in NAMES}


def _digest(network: Network, events: Events) -> NDArray:
    """What tells whether network and events are the same, parameters aside."""
    arrays = (network.pairs, events.time, events.participants)
    return np.array([zlib.crc32(array.tobytes()) for array in arrays])
