"""The methods (3.1) and (3.7) made into scores of slots by (3.26): sums over all ways of filling in what is missing."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from . import kernel
from .energy import Energy
from .events import DataError, Network
from .slots import Slots

WORK = 500_000_000  # elementary steps: a few seconds
_MEMORY = 1 << 30  # bytes


def scores_by_enumeration(slots: Slots, *, compensator: bool = False) -> NDArray:
    """Posterior of who took part, (3.26) with f = L of (3.1), divided by the sum over all allocations.

    Exact: L is a product over timelines, so that the sum over all K^n allocations is a product of n-fold set
    functions and costs 3^n a timeline. Where every allocation has likelihood 0 (no background), the answer is the
    limit of a vanishing background of all pairs (see `with_floor`).

    Parameters
    ----------
    slots : Slots
        Of the incomplete events (collective; rank 0 works).
    compensator : bool
        Multiply L by exp(-∫λ), which (3.1) leaves out: matters where parameters differ between pairs.

    Returns
    -------
    (S,) probabilities; those of an event sum to 1.

    Raises
    ------
    DataError
        Where that would take more than about 5e8 steps: more than 15 or so incomplete events.
    """
    whole = slots.whole
    n, used = whole.count, np.unique(whole.pair)
    members = _events_of(whole, used)
    work = sum(2.0 ** (n - len(m)) * 3.0 ** len(m) for m in members)
    if work > WORK or (2 * len(used) + 4) * 2.0**n * 16 > _MEMORY:
        raise DataError(
            f"{n} incomplete events on {len(used)} pairs are too many to go through all allocations "
            f"({work:.1e} steps, at most {WORK:.0e}): about 15 events can be done"
        )
    found = None
    if slots.comm.rank == 0:
        found = _allocations(whole, whole.network, used, members, compensator)
        if found is None:
            found = _allocations(whole, with_floor(whole.network), used, members, compensator)
    return slots.scatter(found)


def energy_scores(slots: Slots) -> NDArray:
    """Scores of the method (3.7), (3.26) with f = Λ, without enumeration (collective).

    The mean of Λ over the allocations with event j on pair i is a constant of j plus g_ij = b_ij + 2 (A x)_ij at
    the weights x = 1/|C_j|, the mean of all allocations: that gradient (S,) is the score.
    """
    return Energy(slots).gradient(1 / slots.spread(slots.candidates))


def with_floor(network: Network) -> Network:
    """The network with a background of 1e-12 of its largest rate for active pairs that have none.

    An event that nothing triggers is impossible on such a pair. Where no other pair could explain it either, this
    stands for the limit of a vanishing background: as few such events as possible.
    """
    least = 1e-12 * max(network.background.max(), (network.branching * network.decay).max())
    μ = np.where((network.background == 0) & network.active, least, network.background)
    return network.with_parameters(μ, network.branching, network.decay)


def _events_of(whole: Slots, used: NDArray) -> list[NDArray]:
    """Numbers (among those with slots) of the events that each pair could explain."""
    order = np.argsort(whole.pair, kind="stable")
    ends = np.searchsorted(whole.pair[order], used, side="right")
    return np.split(whole.column[order], ends[:-1]) if len(used) else []


def _allocations(
    whole: Slots, network: Network, used: NDArray, members: list[NDArray], compensator: bool
) -> NDArray | None:
    """Probabilities of all slots, None if no allocation is possible."""
    events, n = whole.events, whole.count
    complete = np.flatnonzero(~events.incomplete)
    pair = network.number(*events.participants[complete].T)
    tables = []
    for i, mine in zip(used, members):
        there = complete[pair == i]
        number = np.concatenate([there, whole.event[mine]])
        bit = np.concatenate([np.full(len(there), -1), np.arange(len(mine))]).astype(np.int32)
        order = np.argsort(number)
        time, ω, θ = events.time[number[order]], network.decay[i], network.branching[i]
        cost = -θ * np.expm1(-ω * (events.duration - time)) * float(compensator)
        table = np.empty(1 << len(mine))
        kernel.call(
            "subsets", len(time), np.exp(-ω * np.diff(time, prepend=-np.inf)), bit[order], cost, network.background[i],
            θ * ω, len(mine), table, subject="enumeration",
        )  # fmt: skip
        tables.append(table)
    if not n:
        return np.empty(0)
    allowed = np.array([(1 << m).sum() for m in members], dtype=np.int64)
    first = np.cumsum([0, *map(len, tables[:-1])]).astype(np.int64)
    out = np.empty((len(used), n))
    done = kernel.call("allocations", len(used), n, allowed, first, np.concatenate(tables), out, subject="enumeration")
    if done < 0:
        raise MemoryError("going through all allocations")
    return out[np.searchsorted(used, whole.pair), whole.column] if done else None
