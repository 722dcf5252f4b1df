"""How good predictions are where the truth is known, and predictions that need no model, to compare with.

Truth is the pair of each event, shape (N,), negative where it is not known. Only incomplete events count.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

from .simulate import Seed, stream
from .slots import Slots

TIE = 1e-12  # relative: values as close as rounding leaves equal ones are equal
NORMAL = 1.959963984540054  # 95% of a normal distribution lie within so many standard deviations


@dataclass(frozen=True)
class Share:
    """A share of events, with its 95% confidence interval [`low`, `high`]."""

    share: float
    low: float
    high: float
    events: int


@dataclass(frozen=True)
class Calibration:
    """Slots by their predicted probability: in each bin the mean prediction, the share that came true, the number."""

    predicted: NDArray
    observed: NDArray
    count: NDArray


def ranks_of_truth(slots: Slots, values: NDArray, truth: NDArray, *, seed: Seed) -> NDArray:
    """The place of the true pair when an event's candidates are put in the order of falling `values` (collective).

    Parameters
    ----------
    values : (S,)
        Weights, probabilities or energies of this rank's slots; finite.
    truth : (N,) int
    seed : int or numpy.random.SeedSequence
        Equal values stand in random order, the same on any number of ranks.

    Returns
    -------
    (n,) int64
        1 is the first place; one more than there are candidates if the truth is none of them; 0 for an event that
        does not count.
    """
    true = _is_true(slots, truth)
    column = slots.column
    found = slots.columns(np.ones(len(slots)), true) > 0
    of_true = slots.columns(values, true)[column]
    equal = np.abs(values - of_true) <= TIE * np.abs(of_true)
    above = slots.columns(np.ones(len(slots)), ((values > of_true) & ~equal).astype(float))
    ties = slots.columns(np.ones(len(slots)), equal * (1 - true))
    before = np.floor(stream(seed, "ties").random(slots.count) * (ties + 1))
    ranks = np.where(found, 1 + above + before, 1 + slots.candidates)
    return np.where(_counted(slots, truth), ranks, 0).astype(np.int64)


def top(ranks: NDArray, k: int, runs: NDArray | None = None) -> Share:
    """Share of events whose truth is among the first `k`.

    The interval is Wilson's. Events of one run are not independent of each other: given the `run` of each event, the
    number of events in it is replaced by the number of independent ones that would vary as much as the runs do.

    Parameters
    ----------
    ranks : (n,)
        From `ranks_of_truth`; zeros do not count.
    runs : (n,), optional
        Any label of the simulation an event is from.
    """
    counted = ranks > 0
    events = int(counted.sum())
    if not events:
        return Share(np.nan, 0.0, 1.0, 0)
    hit = ranks[counted] <= k
    share = float(hit.mean())
    independent = float(events) if runs is None else _independent(hit, share, runs[counted])
    return Share(share, *wilson(share, independent), events)


def _independent(hit: NDArray, share: float, runs: NDArray) -> float:
    _, run = np.unique(runs, return_inverse=True)
    many = int(run.max()) + 1
    if many < 2:
        return float(len(hit))
    if share in (0.0, 1.0):  # nothing varies: no run is known to be more than one observation
        return float(many)
    excess = np.bincount(run, weights=hit - share)
    variance = many / (many - 1) * float(excess @ excess) / len(hit) ** 2
    return share * (1 - share) / variance if variance > 0 else float(len(hit))


def wilson(share: float, n: float) -> tuple[float, float]:
    """Wilson's 95% confidence interval of a share of n independent trials."""
    z2 = NORMAL**2 / n
    middle = (share + z2 / 2) / (1 + z2)
    half = np.sqrt(z2 * share * (1 - share) + z2**2 / 4) / (1 + z2)
    return max(0.0, float(middle - half)), min(1.0, float(middle + half))


def log_loss(slots: Slots, probabilities: NDArray, truth: NDArray) -> float:
    """Mean of -ln p of the true pair (collective): infinite if something happened that was held impossible."""
    of_true = slots.columns(probabilities, _is_true(slots, truth))[_counted(slots, truth)]
    with np.errstate(divide="ignore"):
        return float(-np.log(of_true).mean()) if len(of_true) else np.nan


def calibration(slots: Slots, probabilities: NDArray, truth: NDArray, bins: int = 10) -> Calibration:
    """Whether what is predicted with probability p comes true in a share p of cases (collective); empty bins nan."""
    counted = _counted(slots, truth)[slots.column]
    number = np.minimum((probabilities[counted] * bins).astype(np.int64), bins - 1)
    sums = np.array(
        [
            np.bincount(number, minlength=bins),
            np.bincount(number, weights=probabilities[counted], minlength=bins),
            np.bincount(number, weights=_is_true(slots, truth)[counted], minlength=bins),
        ],
        dtype=float,  # of no slots they are whole numbers
    )
    slots.comm.Allreduce(MPI.IN_PLACE, sums)
    count, predicted, observed = sums
    with np.errstate(invalid="ignore"):
        return Calibration(predicted / count, observed / count, count.astype(np.int64))


def guessing(slots: Slots) -> NDArray:
    """(S,) probabilities that know nothing: every candidate alike (collective)."""
    return 1 / slots.spread(slots.candidates)


def most_frequent(slots: Slots) -> NDArray:
    """(S,) probabilities in proportion to one more than a pair's number of complete events (collective)."""
    events = slots.events
    number = slots.network.number(*events.participants[~events.incomplete].T)
    count = np.bincount(number[number >= 0], minlength=len(slots.network))
    return _proportional(slots, 1.0 + count[slots.first_pair + slots.pair])


def linear(slots: Slots) -> NDArray:
    """(S,) probabilities in proportion to b of (3.20), background and complete events alone (collective)."""
    return _proportional(slots, slots.linear)


def _proportional(slots: Slots, values: NDArray) -> NDArray:
    total = slots.columns(values, np.ones(len(values)))[slots.column]
    return np.divide(values, total, out=guessing(slots), where=total > 0)


def _counted(slots: Slots, truth: NDArray) -> NDArray:
    return (truth[slots.event] >= 0) & slots.events.incomplete[slots.event]


def _is_true(slots: Slots, truth: NDArray) -> NDArray:
    return (slots.first_pair + slots.pair == truth[slots.event][slots.column]).astype(float)
