"""What a person sees of a run: a bar with the time left on a terminal, one line a step otherwise."""

from __future__ import annotations

import math
import os
import sys
import time as clock
from collections.abc import Mapping
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.progress import Progress as Bar

# Diagnostics worth a place in a line, in this order, and what they are called there.
SHOWN = {
    "energy": "energy",
    "residual": "residual",
    "inverted": "inverted",
    "newton_iterations": "newton",
    "active_nodes": "nodes",
    "krylov_iterations": "krylov",
    "iterations": "iterations",
}
# Solver iterations are told no more often than this [s]: only long steps show that they are alive.
PATIENCE = 5.0
# A run of more steps than this is told no more often than so many seconds apart.
MANY_STEPS, SPACING = 200, 2.0


def on_terminal() -> bool:
    """Whether a person watches; mpirun gives its ranks a terminal even where its own output goes to a file."""
    if not sys.stdout.isatty():
        return False
    if "OMPI_COMM_WORLD_SIZE" not in os.environ and "PMI_SIZE" not in os.environ:
        return True
    try:
        with open(f"/proc/{os.getppid()}/fd/1", "ab", buffering=0) as output:
            return output.isatty()
    except OSError:
        return True


class Progress:
    """Progress of one run; make it on rank 0 only.

    Parameters
    ----------
    title : str
    start, end : float
        Times the run goes from and to [s].
    quiet : bool
        Say nothing but notes.
    step : float, optional
        Length of a step [s], to judge how many there will be.
    """

    def __init__(self, title: str, start: float, end: float, quiet: bool = False, step: float = math.inf) -> None:
        self.quiet = quiet
        self.last_told = clock.monotonic()
        self.end = end
        self.spacing = SPACING if (end - start) / step > MANY_STEPS else 0.0
        self.bar: Bar | None = None
        if quiet or not on_terminal():
            return
        from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn
        from rich.table import Column

        self.bar = Progress(
            TextColumn("{task.description}", table_column=Column(no_wrap=True, max_width=24)),
            BarColumn(bar_width=8),
            TextColumn("{task.percentage:>3.0f}%"),
            TimeRemainingColumn(),
            # the facts have what the others leave of the line, however narrow the terminal
            TextColumn("{task.fields[facts]}", markup=False, table_column=Column(no_wrap=True, ratio=1)),
            expand=True,
        )
        self.task = self.bar.add_task(title.replace("[", "\\["), total=end - start, facts="")
        self.begin = start
        self.bar.start()

    def step(self, step: int, time: float, dt: float, figures: Mapping[str, float], wall: float) -> None:
        """Tell about a finished step, if the last one told is not too near."""
        now = clock.monotonic()
        if step > 1 and time < self.end and now - self.last_told < self.spacing:
            return
        self.last_told = now
        if self.bar is not None:
            self.bar.update(self.task, completed=time - self.begin, facts=f"step {step}  {_facts(figures)}")
        elif not self.quiet:
            facts = _facts(figures)
            print(f"step {step}  time {time:.6g}  dt {dt:.3g}  {facts}  wall {wall:.1f} s", flush=True)

    def iteration(self, figures: Mapping[str, float]) -> None:
        """Tell about a solver iteration, if nothing has been said for a while."""
        now = clock.monotonic()
        if self.quiet or now - self.last_told < (0.2 if self.bar else PATIENCE):
            return
        self.last_told = now
        words = f"iteration {figures.get('iteration', math.nan):.0f} {_facts(figures)}"
        if self.bar is not None:
            self.bar.update(self.task, facts=words)
        else:
            print(f"  {words}", flush=True)

    def note(self, text: str) -> None:
        """Say a line that must not be missed."""
        if self.bar is not None:
            self.bar.console.print(text, markup=False, highlight=False)
        else:
            print(text, flush=True)

    def close(self) -> None:
        """Leave the terminal as it was."""
        if self.bar is not None:
            self.bar.stop()
            self.bar = None


def _facts(figures: Mapping[str, float]) -> str:
    return "  ".join(f"{word} {figures[name]:.4g}" for name, word in SHOWN.items() if name in figures)
