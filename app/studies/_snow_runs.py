"""What the studies of snow share: scenes as tables, steps with what each took."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from extremal.mpm.problem import SnowProblem

    from ..snow_scene import SnowScene

LEAST = 1e-3  # of the step asked for: a run that wants shorter ones is of no use to a study


@dataclass(frozen=True)
class Step:
    """A step that was made.

    Attributes
    ----------
    dt : float
        [s]
    seconds : float
        Of this rank's processor, failed attempts excluded.
    krylov : int
        Iterations of its linear solve.
    """

    dt: float
    seconds: float
    krylov: int


def scene_of(tables: dict[str, Any]) -> SnowScene:
    """The scene that TOML tables describe."""
    from ..scene import validate

    scene: SnowScene = validate({"part": "snow", **tables}, "scene of a study")
    return scene


def steps(problem: SnowProblem, dt: float, end: float) -> Iterator[Step]:
    """Advance to `end` [s] by steps of `dt` [s], shorter where the problem asks for it (collective).

    Raises
    ------
    ArithmeticError
        If steps become a thousand times shorter than asked for.
    """
    longest = dt
    while problem.time < end * (1 - 1e-9):
        now = min(dt, longest, end - problem.time)
        began = time.process_time()
        try:
            figures = problem.advance(now)
        except ArithmeticError as error:
            longest = min(getattr(error, "wanted_step", None) or now / 2, now * 0.99)
            if longest < LEAST * dt:
                raise
            continue
        yield Step(now, time.process_time() - began, int(figures["krylov_iterations"]))
        longest = figures["wanted_step"]
