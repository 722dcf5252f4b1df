"""Shares of events whose truth is among the first few, beside the source's: CSV, Markdown, picture."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from ..arguments import whole
from ..results import atomic, write_text
from ._table import aligned, make_folder, write_rows

if TYPE_CHECKING:
    from extremal.hawkes.scores import Share

COLUMNS = ("case", "method", "top", "percent", "low", "high", "source", "within", "events", "runs", "seed")


@dataclass(frozen=True)
class Cell:
    """One number of a table: `source` in per cent, nan if there is none, known to ± `digit`."""

    case: str
    method: str
    top: int
    found: Share
    source: float
    digit: float

    @property
    def within(self) -> bool:
        """Whether the source's number, as rounded, can lie in our confidence interval."""
        return 100 * self.found.low - self.digit <= self.source <= 100 * self.found.high + self.digit


def add_arguments(parser: argparse.ArgumentParser, name: str, runs: int) -> None:
    """Declare what all these studies have: the folder of results, number of runs, seed, --quick."""
    parser.add_argument("-o", "--output", metavar="DIR", type=Path, default=Path("results") / name)
    parser.add_argument("--runs", metavar="N", type=whole(), default=runs, help=f"simulations a case ({runs:,})")
    parser.add_argument("--seed", metavar="N", type=whole(0), default=1, help="of all random numbers (1)")
    parser.add_argument("--quick", action="store_true", help="a few runs only")


def publish(args: argparse.Namespace, name: str, cells: Sequence[Cell], note: str) -> None:
    """Write `name`.csv, .md and .png and print the table."""
    make_folder(args.output)
    rows = [
        {
            "case": cell.case,
            "method": cell.method,
            "top": cell.top,
            "percent": f"{100 * cell.found.share:.3f}",
            "low": f"{100 * cell.found.low:.3f}",
            "high": f"{100 * cell.found.high:.3f}",
            "source": f"{cell.source:g}" if cell.source == cell.source else "",
            "within": ("yes" if cell.within else "no") if cell.source == cell.source else "",
            "events": cell.found.events,
            "runs": args.runs,
            "seed": args.seed,
        }
        for cell in cells
    ]
    write_rows(args.output / f"{name}.csv", COLUMNS, rows)
    words = f"{markdown(cells)}\n\n{note}\n"
    write_text(args.output / f"{name}.md", words)
    draw(args.output / f"{name}.png", cells)
    print(words)
    print(*(args.output / f"{name}.{kind}" for kind in ("csv", "md", "png")), flush=True)


def markdown(cells: Sequence[Cell]) -> str:
    """One row a case and method: ours ± half the confidence interval, the source's number in brackets."""
    tops = sorted({cell.top for cell in cells})
    rows = []
    for case, method in dict.fromkeys((cell.case, cell.method) for cell in cells):
        mine = {cell.top: cell for cell in cells if (cell.case, cell.method) == (case, method)}
        rows.append((case, method, *(_words(mine[top]) for top in tops)))
    columns = ("case", "method", *(f"top {top} [%]" for top in tops))
    if not any(row[0] for row in rows):
        columns, rows = columns[1:], [row[1:] for row in rows]
    return aligned(columns, rows)


def _words(cell: Cell) -> str:
    found = cell.found
    text = f"{100 * found.share:.1f} ± {50 * (found.high - found.low):.1f}"
    if cell.source != cell.source:
        return text
    return f"{text} ({cell.source:g}{'' if cell.within else ', outside'})"


def draw(path: Path, cells: Sequence[Cell]) -> None:
    """Ours less the source's, with confidence intervals, over a band as wide as the source's rounding.

    Raises
    ------
    OutputError
        If the picture cannot be written.
    """
    from matplotlib.figure import Figure

    known = [cell for cell in cells if cell.source == cell.source]
    cases, methods = (list(dict.fromkeys(words)) for words in zip(*((c.case, c.method) for c in known)))
    tops = sorted({cell.top for cell in known})
    places = cases if len(cases) > 1 else [f"top {top}" for top in tops]
    panels = tops if len(cases) > 1 else [0]  # a panel for each number of first places, unless there is one case only
    figure = Figure(figsize=(1.4 + max(3.6, 0.3 * len(places)) * len(panels), 4.4), dpi=110, layout="constrained")
    axes = figure.subplots(1, len(panels), sharey=True, squeeze=False)[0]
    for panel, ax in zip(panels, axes):
        ax.axhspan(-known[0].digit, known[0].digit, color="0.88", label="rounding of the source")
        for k, method in enumerate(methods):
            mine = [c for c in known if c.method == method and panel in (0, c.top)]
            shift = 0.18 * (k - (len(methods) - 1) / 2)
            at = [shift + places.index(c.case if panel else f"top {c.top}") for c in mine]
            middle = [100 * c.found.share - c.source for c in mine]
            low = [100 * (c.found.share - c.found.low) for c in mine]
            high = [100 * (c.found.high - c.found.share) for c in mine]
            ax.errorbar(at, middle, (low, high), fmt="o", ms=4, capsize=2, lw=1, label=method)
        ax.axhline(0, color="0.5", lw=0.8)
        ax.set_xticks(range(len(places)), places)
        if panel:
            ax.tick_params(axis="x", rotation=90)
            ax.set_title(f"top {panel}", fontsize=10)
    axes[0].set_ylabel("ours less the source's [points]")
    axes[0].legend(fontsize=8, frameon=False)
    with atomic(path) as partial:
        figure.savefig(partial, format="png")
