"""Slots: the white circles of figure 2.1, an admissible pair for an incomplete event each; shared out by timelines."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

from . import kernel
from .events import UNKNOWN, Events, Network


@dataclass(frozen=True)
class Slots:
    """This rank's slots, event by event in the order of time and pair by pair within an event.

    Attributes
    ----------
    comm : mpi4py.MPI.Comm
    network, events
        Of all ranks.
    first_pair : int
        This rank's timelines begin at this pair; its others follow.
    event : (n,) int64
        The events that have slots, on any rank.
    start : (n + 1,) int64
        Where each of these events' slots begin.
    pair : (S,) int32
        Timeline of each slot, counted from `first_pair`.
    linear : (S,)
        b, what background and complete events give the slot [1/unit of time] (3.20).
    decay : (S,)
        e^{-ω Δt} since the slot before on the same timeline; 0 for the first.
    coupling : (k,)
        θ ω of this rank's timelines.
    cuts : (ranks + 1,) int64
        First pair of each rank.
    """

    comm: MPI.Comm
    network: Network
    events: Events
    first_pair: int
    event: NDArray
    start: NDArray
    pair: NDArray
    linear: NDArray
    decay: NDArray
    coupling: NDArray
    cuts: NDArray

    @classmethod
    def build(cls, comm: MPI.Comm, network: Network, events: Events, *, complete: bool = False) -> Slots:
        """Slots of all incomplete events that some active pair could explain.

        Parameters
        ----------
        network, events
            The same on all ranks.
        complete : bool
            Complete events, too, are slots (one each), and b is the background alone.
        """
        counts, wanted = _candidates(network, events, complete)
        cuts = _even_cuts(_slots_per_pair(network, events, wanted, complete), comm.size)
        low, high = int(cuts[comm.rank]), int(cuts[comm.rank + 1])
        number = np.flatnonzero(counts)
        start, pair = _local_slots(network, events, number, low, high)
        order = np.full(len(events), -1, dtype=np.int32)
        order[number] = np.arange(len(number))
        known = np.full(len(events), -1, dtype=np.int32)
        if not complete:
            whole = ~events.incomplete
            local = network.number(*events.participants[whole].T) - low
            local[(local >= high - low) | (local < 0)] = -1
            known[whole] = local
        part = slice(low, high)
        with np.errstate(over="ignore"):  # an energy that is not finite is refused
            coupling = network.branching[part] * network.decay[part]
        linear, decay = np.empty(len(pair)), np.empty(len(pair))
        background, rate = network.background[part].copy(), network.decay[part].copy()
        scratch = np.empty((2, high - low))
        kernel.call(
            "prepare", len(events), events.time, known, order, start, pair, high - low, background, coupling, rate,
            scratch[0], scratch[1], linear, decay,
        )  # fmt: skip
        return cls(comm, network, events, low, number, start, pair, linear, decay, coupling, cuts)

    def __len__(self) -> int:
        return len(self.pair)

    @property
    def count(self) -> int:
        """Number n of events with slots."""
        return len(self.event)

    @property
    def column(self) -> NDArray:
        """(S,) the number of each slot's event among those with slots."""
        return self.spread(np.arange(self.count))

    @property
    def candidates(self) -> NDArray:
        """(n,) number of slots of each event on all ranks."""
        return self.columns(np.ones(len(self)), np.ones(len(self))).astype(np.int64)

    @property
    def unresolvable(self) -> NDArray:
        """Incomplete events that no active pair could explain."""
        return np.setdiff1d(np.flatnonzero(self.events.incomplete), self.event)

    def columns(self, u: NDArray, v: NDArray) -> NDArray:
        """(n,) sum of u v over the slots of each event (collective)."""
        out = np.empty(self.count)
        kernel.call("columns", self.count, self.start, u, v, out)
        if self.comm.size > 1:
            self.comm.Allreduce(MPI.IN_PLACE, out)
        return out

    def spread(self, values: NDArray) -> NDArray:
        """Values (n,) of the events -> (S,) those of each slot's event."""
        return np.repeat(values, np.diff(self.start))

    def sum(self, values: NDArray) -> float:
        """Sum over the slots of all ranks (collective)."""
        return float(self.comm.allreduce(float(values.sum())))

    def uniform(self) -> NDArray:
        """(S,) equal weights of unit length in each event."""
        return self.spread(1 / np.sqrt(np.maximum(self.candidates, 1)))

    @cached_property
    def whole(self) -> Slots:
        """All slots, for what goes through the events one after another; itself on one rank."""
        if self.comm.size == 1:
            return self
        complete = len(self.event) > 0 and not self.events.incomplete[self.event].all()
        return Slots.build(MPI.COMM_SELF, self.network, self.events, complete=complete)

    def gather(self, values: NDArray) -> NDArray | None:
        """Values (S,) of all ranks in the order of `whole`, on rank 0 (collective)."""
        parts = self.comm.gather(values)
        if parts is None:
            return None
        out = np.empty(len(self.whole))
        for rows, part in zip(self._rows_of_ranks(), parts):
            out[rows] = part
        return out

    def scatter(self, values: NDArray | None) -> NDArray:
        """This rank's share of rank 0's values in the order of `whole` (collective)."""
        parts = None if values is None else [np.ascontiguousarray(values[rows]) for rows in self._rows_of_ranks()]
        return self.comm.scatter(parts if self.comm.rank == 0 else None)

    def _rows_of_ranks(self) -> list[NDArray]:
        owner = np.searchsorted(self.cuts, self.whole.pair, side="right") - 1
        return [np.flatnonzero(owner == rank) for rank in range(self.comm.size)]


def _agents_pairs(network: Network, chosen: NDArray) -> tuple[NDArray, NDArray]:
    """Pairs of each agent among the `chosen` ones: where they begin (agents + 1,), and the pairs in their order."""
    pairs = np.flatnonzero(chosen)
    agent = network.pairs[pairs].reshape(-1)
    order = np.argsort(agent, kind="stable")
    start = np.zeros(len(network.agents) + 1, dtype=np.int64)
    np.cumsum(np.bincount(agent, minlength=len(network.agents)), out=start[1:])
    return start, np.repeat(pairs, 2)[order]


def _candidates(network: Network, events: Events, complete: bool) -> tuple[NDArray, NDArray]:
    """Number of candidates of each event (0 for those without slots), and the agent that is known, or UNKNOWN."""
    start, _ = _agents_pairs(network, network.active)
    known = events.participants.max(axis=1)
    degree = np.diff(start)
    counts = np.where(known == UNKNOWN, int(network.active.sum()), degree[known])
    whole = ~events.incomplete
    number = network.number(*events.participants[whole].T)
    counts[whole] = complete * ((number >= 0) & network.active[number])
    return counts, known


def _slots_per_pair(network: Network, events: Events, known: NDArray, complete: bool) -> NDArray:
    part = events.incomplete
    blank = int((part & (known == UNKNOWN)).sum())
    seen = np.bincount(known[part & (known != UNKNOWN)], minlength=len(network.agents))
    load = (blank + seen[network.pairs].sum(axis=1)) * network.active
    if complete:
        number = network.number(*events.participants[~part].T)
        load = load + np.bincount(number[number >= 0], minlength=len(network))
    return load


def _local_slots(network: Network, events: Events, number: NDArray, low: int, high: int) -> tuple[NDArray, NDArray]:
    mine = network.active.copy()
    mine[:low] = False
    mine[high:] = False
    begin, of_agent = _agents_pairs(network, mine)
    everything = np.flatnonzero(mine)
    table = np.concatenate([of_agent, everything])  # the pairs of each agent, then all
    people = events.participants[number]
    known = people.max(axis=1)
    whole = (people != UNKNOWN).all(axis=1)
    first = np.where(known == UNKNOWN, len(of_agent), begin[known])
    count = np.where(known == UNKNOWN, len(everything), begin[known + 1] - begin[known])
    exact = network.number(*people[whole].T)
    here = (exact >= low) & (exact < high) & mine[exact]
    count[whole] = here
    first[whole] = len(of_agent) + np.searchsorted(everything, exact)
    start = np.zeros(len(number) + 1, dtype=np.int64)
    np.cumsum(count, out=start[1:])
    place = np.arange(start[-1]) + np.repeat(first - start[:-1], count)
    return start, (table[place] - low).astype(np.int32)


def _even_cuts(load: NDArray, parts: int) -> NDArray:
    """Cut a row into `parts` runs of nearly equal sums."""
    total = np.cumsum(load + 1e-9)
    inner = np.searchsorted(total, total[-1] * np.arange(1, parts) / parts)
    return np.concatenate([[0], np.maximum.accumulate(inner), [len(load)]]).astype(np.int64)
