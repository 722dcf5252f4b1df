"""Mean field: probabilities of who took part, each event seeing the others through their probabilities; O(slots)."""

from __future__ import annotations

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

from . import kernel
from .enumeration import with_floor
from .slots import Slots


def mean_field(slots: Slots, *, sweeps: int = 10, start: NDArray | None = None, compensator: bool = True) -> NDArray:
    """Probabilities that each slot is where its event took place (collective).

    All events at once, `sweeps` times: q_j = softmax(s_j), with k = θ_i ω_i e^{-ω_i(t_l-t_j)} and
        s_ij = ln λ_i(t_j) + Σ_{l>j} q_il ln(1 + k/λ_i(t_l)) - θ_i (1 - e^{-ω_i(T-t_j)}),
    the logarithm of the likelihood that moving event j to pair i changes, λ by the probabilities of all earlier
    events; λ_i(t_l) without what event j itself gives. meanfield.c says how that takes O(S). The later half of the
    sweeps goes half of the way only, lest strongly excited events alternate between two states.

    Parameters
    ----------
    slots : Slots
        Built with `complete=True`: complete events are slots of probability 1.
    sweeps : int
        Five do where excitation is moderate.
    start : (S,), optional
        Probabilities to begin with, by default equal ones; the squared weights of (3.5) help where excitation is
        strong.
    compensator : bool
        Count what a pair's events would have been expected to trigger by the end; see ERRATA 13 of the source.

    Returns
    -------
    (S,) probabilities; those of an event sum to 1.
    """
    network, n, first = with_floor(slots.network), slots.count, slots.first_pair
    K = len(slots.coupling)
    μ, θ, ω = (p[first : first + K] for p in (network.background, network.branching, network.decay))
    time = slots.spread(slots.events.time[slots.event])
    cost = np.zeros(len(slots))
    if compensator:
        cost -= θ[slots.pair] * np.expm1(ω[slots.pair] * (time - slots.events.duration))
    del time
    q = 1 / slots.spread(slots.candidates) if start is None else start.astype(float)
    rate, score = np.empty(len(slots)), np.empty(len(slots))
    largest, total = np.empty(n), np.empty(n)
    for sweep in range(sweeps):
        score[:] = cost
        kernel.call(
            "scores", len(slots), slots.pair, slots.decay, μ, slots.coupling, q, np.zeros((K, 4)), rate, score,
            subject="meanfield",
        )  # fmt: skip
        kernel.call("largest", n, slots.start, score, largest, subject="meanfield")
        _reduce(slots, largest, MPI.MAX)
        kernel.call("exponentials", n, slots.start, largest, score, total, subject="meanfield")
        _reduce(slots, total, MPI.SUM)
        step = 1.0 if 2 * sweep < sweeps else 0.5
        kernel.call("approach", n, slots.start, score, total, step, q, subject="meanfield")
    return q


def of_incomplete(everything: Slots, slots: Slots, values: NDArray) -> NDArray:
    """Values over the slots of all events -> those over the slots of incomplete events only (collective).

    Parameters
    ----------
    everything, slots : Slots
        Of the same network and events, built with `complete=True` and without.
    values : (S of everything,)
    """
    whole = everything.gather(values)
    return slots.scatter(None if whole is None else whole[_incomplete(everything.whole)])


def of_all(everything: Slots, slots: Slots, values: NDArray) -> NDArray:
    """Values over the slots of incomplete events -> those over the slots of all, 1 where complete (collective)."""
    whole, out = slots.gather(values), None
    if whole is not None:
        out = np.ones(len(everything.whole))
        out[_incomplete(everything.whole)] = whole
    return everything.scatter(out)


def _incomplete(everything: Slots) -> NDArray:
    return everything.spread(everything.events.incomplete[everything.event])


def _reduce(slots: Slots, values: NDArray, op: MPI.Op) -> None:
    if slots.comm.size > 1:
        slots.comm.Allreduce(MPI.IN_PLACE, values, op=op)
