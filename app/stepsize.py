"""How long the next step is: growth after easy steps, cut-back after failures, milestones hit exactly."""

from __future__ import annotations

import math
from dataclasses import dataclass

# A step is easy up to so many nonlinear iterations; so many easy steps in a row make the next one longer.
EASY_ITERATIONS = 12
EASY_STEPS = 2
GROWTH = 1.5
CUT = 0.5
# Times nearer to each other than this fraction of a step are the same time.
ROUNDING = 1e-9


@dataclass
class StepSize:
    """The length of the steps from now to `end`.

    Parameters
    ----------
    first : float
        Length of the first step [s].
    end : float
        Time at which the run ends [s]; hit exactly.
    smallest : float, optional
        No step is cut below it [s]; `first / 1024` if not given.
    largest : float, optional
        No step grows beyond it [s]; `first` if not given.
    adaptive : bool
        False: every step is `first` long (shorter only to hit a milestone), and is never retried.
    every : float, optional
        Multiples of it are milestones too [s].

    Raises
    ------
    ValueError
        If the lengths contradict each other.
    """

    first: float
    end: float
    smallest: float | None = None
    largest: float | None = None
    adaptive: bool = True
    every: float | None = None

    def __post_init__(self) -> None:
        if not self.first > 0:
            raise ValueError(f"time step {self.first:g}: must be greater than 0")
        self.lower = self.first / 1024 if self.smallest is None else self.smallest
        self.upper = max(self.first, self.lower) if self.largest is None else self.largest
        if not 0 < self.lower <= self.upper:
            raise ValueError(
                f"smallest step {self.lower:g}: must be greater than 0 and at most the largest step, "
                f"{self.upper:g}"
            )
        if self.every is not None and not self.every > 0:
            raise ValueError(f"time between frames {self.every:g}: must be greater than 0")
        self.dt = self._within(self.first) if self.adaptive else self.first
        self.easy_steps = 0

    def finished(self, time: float) -> bool:
        """Tell whether `time` [s] is the end of the run."""
        return time >= self.end - ROUNDING * min(self.dt, abs(self.end) or self.dt)

    def milestone(self, time: float) -> float:
        """Return the next time after `time` which a step must end at [s]."""
        if self.every is None:
            return self.end
        # Counted from zero, not from the last milestone: a restarted run finds the very same numbers.
        return min((math.floor(time / self.every + ROUNDING) + 1) * self.every, self.end)

    def on_milestone(self, time: float) -> bool:
        """Tell whether an output frame is due at `time` [s] (always, without `every`)."""
        if self.every is None or self.finished(time):
            return True
        return abs(time / self.every - round(time / self.every)) <= ROUNDING

    def propose(self, time: float) -> tuple[float, float]:
        """Return the length of the step from `time`, and the time it ends at, both [s].

        Where the step ends on a milestone the second number is that: `time + length` may differ by rounding.
        """
        milestone = self.milestone(time)
        left = milestone - time
        if left <= self.dt * (1 + ROUNDING):
            return left, milestone
        # two equal steps rather than a long one and a sliver
        if self.adaptive and left < 2 * self.dt * (1 - ROUNDING):
            return left / 2, time + left / 2
        return self.dt, time + self.dt

    def accepted(self, dt: float, iterations: float | None = None, wanted: float | None = None) -> None:
        """Note that a step of length `dt` [s] succeeded.

        Parameters
        ----------
        iterations : float, optional
            Nonlinear iterations it took; few of them, or none counted, make it an easy step.
        wanted : float, optional
            Length of the next step as an error estimate asks for [s]; decides alone where given.
        """
        if not self.adaptive:
            return
        if wanted is not None and math.isfinite(wanted):
            self.dt = self._within(wanted)
            return
        if iterations is not None and iterations > EASY_ITERATIONS:
            self.easy_steps = 0
        elif dt >= 0.5 * self.dt:  # a sliver before a milestone proves nothing about longer steps
            self.easy_steps += 1
        if self.easy_steps >= EASY_STEPS:
            self.dt = self._within(self.dt * GROWTH)
            self.easy_steps = 0

    def rejected(self, dt: float, wanted: float | None = None) -> bool:
        """Note that a step of length `dt` [s] failed; return whether a shorter one may be tried.

        Parameters
        ----------
        wanted : float, optional
            A shorter length that an error estimate asks for [s]; half of `dt` if not given; infinite where no
            length would help.
        """
        self.easy_steps = 0
        if not self.adaptive or wanted == math.inf or dt <= self.lower * (1 + ROUNDING):
            return False
        shorter = wanted if wanted is not None and 0 < wanted < dt else CUT * dt
        self.dt = max(shorter, self.lower)
        return True

    def state(self) -> dict[str, float]:
        """Return what `restore` needs to go on in the same way."""
        return {"dt": self.dt, "first": self.first, "easy_steps": self.easy_steps}

    def restore(self, state: dict[str, float]) -> None:
        """Go on from `state`, unless the scene's own step has been changed since: then start from that."""
        if self.adaptive and state["first"] == self.first:
            self.dt = self._within(state["dt"])
            self.easy_steps = int(state["easy_steps"])

    def _within(self, dt: float) -> float:
        return min(max(dt, self.lower), self.upper)
