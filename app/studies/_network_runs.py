"""What the studies of networks share: simulated data in many runs, spread over the ranks, and (3.5) for small ones."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

from extremal.hawkes.energy import Energy
from extremal.hawkes.events import Network
from extremal.hawkes.gibbs import gibbs
from extremal.hawkes.meanfield import mean_field, of_incomplete
from extremal.hawkes.scores import ranks_of_truth
from extremal.hawkes.simulate import hide, simulate
from extremal.hawkes.slots import Slots

BACKGROUND, BRANCHING, DECAY = 1e-2, 0.5, 1e-1  # μ [1/day], θ, ω [1/day] of section 3.4
GAP = 1e-10  # relative, proven
ROUNDS = 100_000


@dataclass(frozen=True)
class Data:
    """Simulated events of which `incomplete` have lost one participant, or both."""

    network: Network
    events: int
    incomplete: int
    mode: str = "one"

    def slots(self, seed: np.random.SeedSequence) -> tuple[Slots, NDArray]:
        """Slots on this rank alone, and the true pair of every event."""
        whole = simulate(self.network, count=self.events, seed=seed)
        known = hide(whole, self.incomplete, mode=self.mode, seed=seed)
        return Slots.build(MPI.COMM_SELF, self.network, known), self.network.number(*whole.participants.T)


def complete_network(agents: int) -> Network:
    """All pairs of the agents, with the parameters of section 3.4."""
    return Network.complete(agents, BACKGROUND, BRANCHING, DECAY)


def seed_of(seed: int, *place: int) -> np.random.SeedSequence:
    """The seed of one run, whichever rank makes it."""
    return np.random.SeedSequence(seed, spawn_key=place)


def spread(comm: MPI.Comm, runs: int, one: Callable[[int], NDArray]) -> NDArray:
    """Results of `one` for run 0, 1, ... in their order, shape (runs, ...), on all ranks (collective)."""
    mine = [one(run) for run in range(comm.rank, runs, comm.size)]
    parts = comm.allgather(mine)
    return np.array([parts[run % comm.size][run // comm.size] for run in range(runs)])


def ranks_of_methods(
    data: Data, seed: np.random.SeedSequence, methods: Sequence[Callable[[Slots], NDArray]]
) -> NDArray:
    """The truth's place by each method in one run, shape (methods, n)."""
    slots, truth = data.slots(seed)
    return np.array([ranks_of_truth(slots, method(slots), truth, seed=seed) for method in methods])


def continuous(slots: Slots) -> NDArray:
    """Weights of (3.5): sweeps until the gap is proven, the fastest way for few slots.

    Raises
    ------
    ArithmeticError
        If it is not within a number of rounds that none ever needs.
    """
    energy, x, rounds = Energy(slots), slots.uniform(), 4
    while rounds < ROUNDS:
        x = energy.sweep(x, rounds)
        g = energy.gradient(x)
        if energy.gap(x, g) <= GAP * energy.value(x, g):
            return x
        rounds += rounds // 2
    raise ArithmeticError(f"(3.5): no relative gap of {GAP:g} after {2 * rounds} rounds")


def halved(slots: Slots) -> NDArray:
    """Weights of (3.5) with half the coupling between incomplete events, g = b + A r."""
    return continuous(replace(slots, coupling=0.5 * slots.coupling))


def probable(slots: Slots) -> NDArray:
    """Probabilities of mean field."""
    everything = Slots.build(MPI.COMM_SELF, slots.network, slots.events, complete=True)
    return of_incomplete(everything, slots, mean_field(everything))


def sampled(slots: Slots) -> NDArray:
    """Posterior probabilities, by enough sampling that more changes top 1 by less than a tenth of a per cent."""
    return gibbs(slots, sweeps=150, burn_in=20, seed=1, chains=1)
