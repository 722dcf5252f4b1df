"""The other normalisations of the weights: l¹ (3.6), general lᵖ, and the hybrid constraint of section 3.2.3."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from . import kernel
from .energy import Energy, later
from .events import DataError
from .slots import Slots


@dataclass(frozen=True)
class Power:
    """Σ x^p = 1 over the candidates of an event: p = 1 is (3.6), p = 2 is (3.5).

    From p = 2 upwards the energy is concave in x^p, and what rounds over the events find is the maximum; below, it is
    one of several maxima.
    """

    p: float

    def __post_init__(self) -> None:
        if not 1 <= self.p <= 100:
            raise DataError(f"p is {self.p:g}: must be at least 1 and at most 100")


@dataclass(frozen=True)
class Hybrid:
    """Σ f x² + (1 - f) x = 1 over the candidates of an event: f = 1 is (3.5), f = 0 is (3.6).

    Below 0 the left side is concave and a corner is best for each event, as for f = 0.
    """

    f: float

    def __post_init__(self) -> None:
        if not -1 <= self.f <= 1:
            raise DataError(f"f is {self.f:g}: must be at least -1 and at most 1")


@dataclass(frozen=True)
class Relaxation:
    """Weights (S,) of this rank's slots, their energy (3.20), the rounds made, and the last one's largest change."""

    weights: NDArray
    energy: float
    rounds: int
    change: float


def relax(
    slots: Slots,
    constraint: Power | Hybrid,
    *,
    start: NDArray | None = None,
    rounds: int = 500,
    tolerance: float = 1e-9,
) -> Relaxation:
    """Maximise the energy over one event after another until no weight changes (collective).

    Each event's best weights are known: with g its gradient, x ~ g^(1/(p-1)) for `Power`, and
    x = max(0, (g/ℓ - (1 - f))/(2 f)) for `Hybrid`, where ℓ makes the constraint hold; for p = 1 and f <= 0 all weight
    goes to the largest g, the first of equal ones. The energy never falls.

    Parameters
    ----------
    slots : Slots
    constraint : Power or Hybrid
    start : (S,), optional
        Weights of the events not yet visited in the first round; equal ones otherwise.
    rounds : int
        Largest number.
    tolerance : float
        Largest change of a weight in the last round.
    """
    p, f = (constraint.p, np.nan) if isinstance(constraint, Power) else (2.0, constraint.f)
    whole = slots.gather(_equal(slots, p, f) if start is None else start)
    done, change = 0, np.inf
    if whole is not None:
        w = slots.whole
        scratch, future = np.empty(len(w.coupling)), np.empty(len(w))
        room = np.empty(2 * int(np.diff(w.start).max(initial=0)))
        while done < rounds and change > tolerance:
            later(w, whole, scratch, future)
            change = kernel.call(
                "relax", w.count, w.start, w.pair, w.decay, len(w.coupling), w.coupling, w.linear, float(p), float(f),
                scratch, future, room, whole, subject="relaxations",
            )  # fmt: skip
            done += 1
    done, change = slots.comm.bcast((done, change))
    weights = slots.scatter(whole)
    return Relaxation(weights, Energy(slots).value(weights), done, change)


def _equal(slots: Slots, p: float, f: float) -> NDArray:
    """Equal weights which meet the constraint."""
    n = np.maximum(slots.candidates, 1)
    if np.isnan(f):
        each = n ** (-1.0 / p)
    else:  # the root of n (f x² + (1 - f) x) = 1, written so that f = 0 is no exception
        each = 2 / n / ((1 - f) + np.sqrt(np.maximum((1 - f) ** 2 + 4 * f / n, 0)))
    return slots.spread(each)
