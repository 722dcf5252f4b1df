"""Power laws through points, and which points are worth having."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

CONFIDENCE = 0.95
STEEPEST = 30.0  # slope beyond which points stand above each other and follow no power law
NOTICEABLE = 0.99  # an error larger than this part of another is no better than it


@dataclass(frozen=True)
class Fit:
    """y ~ x^slope.

    Attributes
    ----------
    slope, low, high : float
        With its 95% confidence; infinite where two points tell nothing of it.
    level : float
        y at x = 1.
    count : int
        Points.
    """

    slope: float
    low: float
    high: float
    level: float
    count: int

    def at(self, x: float) -> float:
        """Value of the power law."""
        return self.level * x**self.slope


def power_law(x: Sequence[float], y: Sequence[float]) -> Fit | None:
    """Least squares in log-log, None where x hardly differs; values that are not positive are left out.

    Examples
    --------
    >>> fit = power_law([1, 2, 4], [3, 12, 48])
    >>> round(fit.slope, 9), round(fit.level, 9)
    (2.0, 3.0)
    """
    kept = [(math.log(a), math.log(b)) for a, b in zip(x, y) if a > 0 and b > 0 and math.isfinite(a * b)]
    if len({a for a, _ in kept}) < 2:
        return None
    a, b = np.array(kept).T
    spread = ((a - a.mean()) ** 2).sum()
    slope = float(((a - a.mean()) * b).sum() / spread)
    if abs(slope) > STEEPEST:
        return None
    rest = b - b.mean() - slope * (a - a.mean())
    half = math.inf
    if len(kept) > 2:
        from scipy.stats import t

        half = float(t.ppf((1 + CONFIDENCE) / 2, len(kept) - 2) * math.sqrt((rest**2).sum() / (len(kept) - 2) / spread))
    return Fit(slope, slope - half, slope + half, math.exp(b.mean() - slope * a.mean()), len(kept))


def front(costs: Sequence[float], errors: Sequence[float]) -> list[int]:
    """Positions of the points to which no other is at least as cheap and as accurate, to one per cent; cheapest first.

    Examples
    --------
    >>> front([1, 2, 3, 4], [0.5, 0.6, 0.1, 0.1])
    [0, 2]
    """
    best, out = math.inf, []
    for k in sorted(range(len(costs)), key=lambda k: (costs[k], errors[k])):
        if errors[k] < NOTICEABLE * best:
            best = errors[k]
            out.append(k)
    return out
