"""From a scene to a run on a network: data read or simulated, method, estimation, and the tables of the result."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from extremal.hawkes.events import DataError
from extremal.hawkes.problem import HawkesProblem, Method
from extremal.hawkes.relaxations import Hybrid, Power

from . import hawkes_data, hawkes_tables, record, results
from .errors import InputError
from .hawkes_data import Data
from .parallel import on_root

if TYPE_CHECKING:
    from extremal.hawkes.estimate import Estimation

    from .hawkes_scene import HawkesScene


class NetworkRun(HawkesProblem):
    """A problem on data of a person: knows names, lines and, if simulated, the truth.

    Parameters
    ----------
    scene : HawkesScene
    data : Data
        The same on all ranks.
    """

    def __init__(self, comm: MPI.Comm, scene: HawkesScene, data: Data) -> None:
        estimation, rounds = None, 0
        if scene.estimation is not None:
            estimation, rounds = _estimation(comm, scene, data), scene.estimation.rounds
        super().__init__(comm, data.network, data.events, method_of(scene), estimation, rounds)
        self.data, self.candidates = data, scene.output.candidates
        self.seed = scene.simulation.seed if scene.simulation is not None else 0
        source = "data" if scene.simulation is None else "simulation"
        self.effects[source] = {
            "agents": len(data.network.agents),
            "pairs": len(data.network),
            "events": len(data.events),
            "incomplete": float(data.events.incomplete.sum()),
        }
        self._scores: dict[str, Sequence[Any]] = {}

    def advance(self, dt: float) -> dict[str, float]:
        """Make a round; the last one is followed by the scores, where the truth is known (collective)."""
        figures = super().advance(dt)
        self._score()
        return figures

    def restore(self, state: dict[str, Any]) -> None:
        """Take over rank 0's state (collective)."""
        super().restore(state)
        self._score()

    def _score(self) -> None:
        if self.data.truth is not None and self.found and self.slots.count:
            with PETSc.Log.Event("hawkes:simulation:scores"):
                self._scores = hawkes_tables.score_table(self, self.data.truth, self.seed)

    def diagnostics(self) -> dict[str, float]:
        """Columns of history.csv (collective)."""
        scores = hawkes_tables.diagnostics_of(self._scores) if self._scores else {}
        return super().diagnostics() | scores

    def tables(self) -> dict[str, dict[str, Sequence[Any]]]:
        """The result by names of files, on rank 0 (collective)."""
        tables = {
            results.PREDICTIONS: hawkes_tables.predictions(self, self.data, self.candidates),
            results.PARAMETERS: hawkes_tables.parameters(self, self.data),
        }
        truth = self.data.truth
        if truth is not None and self.probabilities is not None:
            tables[results.CALIBRATION] = hawkes_tables.calibration(self.slots, self.probabilities, truth)
        if self.comm.rank > 0:
            return {}
        supercritical = int((self.network.branching >= 1).sum())
        if self.estimation is not None and supercritical:
            doubt = "their events would multiply for ever; do not trust these parameters"
            print(f"branching of {supercritical} pairs is 1 or more: {doubt}", flush=True)
        tables[results.EVENTS] = hawkes_tables.events(self.data)
        strange = hawkes_tables.unresolvable(self, self.data)
        if strange["event"]:
            tables[results.UNRESOLVABLE] = strange
        if self._scores:
            tables[results.SCORES] = dict(self._scores)
        return tables


def build(scene: HawkesScene, comm: MPI.Comm) -> NetworkRun:
    """The run a scene describes, at its start (collective); rank 0 tells what is remarkable about the data.

    Raises
    ------
    InputError
        On all ranks, about the line of a table, or about a simulation that cannot be made.
    """
    record.start_log()  # reading and simulating cost time, too
    if scene.simulation is None:
        with PETSc.Log.Event("hawkes:data"):
            data = on_root(comm, lambda: hawkes_data.read(scene))
    else:
        with PETSc.Log.Event("hawkes:simulation"):
            data = simulated(scene, comm)
    run = NetworkRun(comm, scene, data)
    if comm.rank == 0:
        notes = list(data.notes)
        strange = len(run.outside) + len(run.slots.unresolvable)
        if strange:
            notes.append(f"{strange} of {len(data.events)} events are on no active pair: see {results.UNRESOLVABLE}")
        if not data.events.incomplete.any():
            notes.append("no event is incomplete: there is nothing to reconstruct")
        for note in notes:
            print(note, flush=True)
    return run


def simulated(scene: HawkesScene, comm: MPI.Comm) -> Data:
    """Events of a [simulation], the same on every rank (collective)."""
    from extremal.hawkes.simulate import hide, simulate, under_report

    wanted = scene.simulation
    assert wanted is not None
    notes: list[str] = []
    network = on_root(comm, lambda: hawkes_data.read_network(scene, notes))
    try:
        events = simulate(network, count=wanted.count, duration=wanted.duration, seed=wanted.seed)
        if wanted.unreported > 0:
            events = under_report(events, wanted.unreported, seed=wanted.seed)
        truth = network.number(*events.participants.T)
        events = hide(events, wanted.incomplete, mode=wanted.missing, seed=wanted.seed)
    except DataError as error:
        raise InputError(f"{scene.path}: [simulation]: {error}") from None
    number = np.arange(1, len(events) + 1)
    return Data(network, events, number, [repr(t) for t in events.time.tolist()], truth, notes)


def method_of(scene: HawkesScene) -> Method:
    """The method a scene asks for."""
    m = scene.method
    constraint: Power | Hybrid | None = None
    if m.hybrid is not None:
        constraint = Hybrid(m.hybrid)
    elif m.p != 2:
        constraint = Power(m.p)
    normalised = m.functional == "normalised"
    return Method(m.gap, m.sweeps, constraint, normalised, m.probabilities, m.samples, m.seed)


def _estimation(comm: MPI.Comm, scene: HawkesScene, data: Data) -> Estimation:
    from extremal.hawkes.estimate import Estimation, rough_guess

    wanted = scene.estimation
    assert wanted is not None
    begin = rough_guess(data.network, data.events)
    return Estimation(comm, begin, data.events, per_pair=wanted.per_pair, strength=wanted.shrinkage, seed=wanted.seed)
