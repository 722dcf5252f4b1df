"""Gibbs sampling: the posterior of who took part, with the compensator, exact up to the error of sampling."""

from __future__ import annotations

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

from . import kernel
from .enumeration import with_floor
from .events import Network
from .simulate import Seed, stream
from .slots import Slots


class Sampler:
    """One chain: who took part in each event, all of it known, as likely as the data and the parameters say.

    Attributes
    ----------
    pair : (N,) int32
        The pair of each event; -1 for those that no pair could explain.
    """

    def __init__(self, slots: Slots, random: np.random.Generator) -> None:
        """`slots` are all slots of the incomplete events (`Slots.whole`)."""
        events, network = slots.events, slots.network
        self.pair = np.full(len(events), -1, dtype=np.int32)
        complete = ~events.incomplete
        number = network.number(*events.participants[complete].T)
        self.pair[complete] = np.where(network.active[number], number, -1)
        single = np.diff(slots.start) == 1
        self.pair[slots.event[single]] = slots.pair[slots.start[:-1][single]]
        self._slots, self._random, self._fresh = slots, random, True
        self._order = np.full(len(events), -1, dtype=np.int32)
        self._order[slots.event] = np.arange(slots.count)
        K = len(network)
        self._carried = np.empty(K), np.empty(K, np.int64), np.empty(K, np.int64), np.empty(len(events), np.int64)
        self._room = np.empty(np.diff(slots.start).max(initial=1))

    def sweep(self, network: Network, mean: NDArray, power: float = 1.0) -> None:
        """Move each incomplete event once; its conditional probabilities are added to `mean` (S,).

        The first sweep puts the events where they are likely given the complete ones and those put before. A `power`
        below 1 of the probabilities moves more freely: of use before samples count.
        """
        slots = self._slots
        events, K = slots.events, len(network)
        past, last, head, following = self._carried
        kernel.call(
            "gibbs", len(events), events.time, self._order, slots.start, slots.pair, K, network.background,
            network.branching, network.decay, float(events.duration), self._random.random(slots.count), float(power),
            self._fresh, self.pair, past, last, head, following, self._room, mean, subject="gibbs",
        )  # fmt: skip
        self._fresh = False

    def state(self) -> tuple[NDArray, NDArray]:
        """The pairs, and the state of the random numbers, for `restore`."""
        found = self._random.bit_generator.state
        position = np.array([found["buffer_pos"]], dtype=np.uint64)  # a signed one would make floats of all
        random = [found["state"]["counter"], found["state"]["key"], found["buffer"], position]
        return self.pair.copy(), np.concatenate(random)

    def restore(self, pair: NDArray, random: NDArray) -> None:
        """Go on from what `state` gave of a sampler that had made a sweep."""
        self.pair[:], self._fresh = pair, False
        state = self._random.bit_generator.state
        state["state"] = {"counter": random[:4].copy(), "key": random[4:6].copy()}
        state["buffer"], state["buffer_pos"] = random[6:10].copy(), int(random[10])
        self._random.bit_generator.state = state


def samplers(slots: Slots, chains: int, seed: Seed) -> dict[int, Sampler]:
    """This rank's chains by their number; each has random numbers of its own, whatever the number of ranks."""
    comm = slots.comm
    return {c: Sampler(slots.whole, stream(seed, f"gibbs {c}")) for c in range(comm.rank, chains, comm.size)}


def sum_of_chains(comm: MPI.Comm, mine: dict[int, NDArray]) -> NDArray:
    """Sum over the chains of all ranks, in their order: the same digits on any number of ranks (collective)."""
    found: dict[int, NDArray] = {}
    for part in comm.allgather(mine):
        found.update(part)
    return sum(found[c] for c in sorted(found))


def annealing(sweeps: int) -> NDArray:
    """Powers of the first sweeps, rising to 1: clusters move as a whole only while they are loose."""
    return np.minimum(1.0, np.linspace(0.1, 1.4, sweeps))


def gibbs(slots: Slots, *, sweeps: int = 200, burn_in: int = 50, seed: Seed = 0, chains: int = 4) -> NDArray:
    """Posterior probabilities that each slot is where its event took place (collective).

    Samples of (3.1) times exp(-∫λ), given all complete events; each probability is the mean of the conditional
    probabilities met on the way, which vary less than counts of where the event was. A sweep takes time in proportion
    to the slots times the events within reach of e^{-ωΔt}. Where pairs have no background, chains cannot leave where
    they are: enumeration is the remedy if the events are few.

    Parameters
    ----------
    slots : Slots
        Of the incomplete events.
    sweeps, burn_in : int
        Of each chain: those that count, and those before.
    seed : int or numpy.random.SeedSequence
        The same seed gives the same answer on any number of ranks.
    chains : int
        Independent ones, shared out over ranks.

    Returns
    -------
    (S,) probabilities; those of an event sum to 1.
    """
    network = with_floor(slots.network)
    sums = {}
    for c, sampler in samplers(slots, chains, seed).items():
        mean, unused = np.zeros(len(slots.whole)), np.zeros(len(slots.whole))
        for power in annealing(burn_in):
            sampler.sweep(network, unused, power)
        for _ in range(sweeps):
            sampler.sweep(network, mean)
        sums[c] = mean
    total = sum_of_chains(slots.comm, sums) / (chains * sweeps)
    return slots.scatter(total if slots.comm.rank == 0 else None)
