"""The page of every `summary.png`: title, verdict, and the tables it is drawn from."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import matplotlib

matplotlib.use("Agg")

import numpy as np
from matplotlib.figure import Figure

from .results import RECORD, SUMMARY, atomic, read_table

if TYPE_CHECKING:
    from numpy.typing import NDArray

GOOD, DOUBTFUL, BAD = "#2e7d32", "#b26a00", "#b71c1c"
WIDTH, HEIGHT = 13.5, 6.4  # [inches]


@contextmanager
def page(folder: Path, height: float = HEIGHT, dpi: int = 110) -> Iterator[tuple[Figure, dict[str, Any]]]:
    """Yield a figure with title and verdict, and the run's record; save it as the summary when the context ends well.

    Parameters
    ----------
    folder : pathlib.Path
        A results folder.
    height : float
        [inches]

    Raises
    ------
    OutputError
        If the picture cannot be written.
    """
    record = json.loads((folder / RECORD).read_text(encoding="utf-8"))
    figure = Figure(figsize=(WIDTH, height), dpi=dpi, facecolor="white")
    figure.text(0.02, 1 - 0.28 / height, record["title"] or record["part"], fontsize=15, weight="bold", va="center")
    _write_verdict(figure, record)
    yield figure, record
    with atomic(folder / SUMMARY) as partial:
        figure.savefig(partial, format="png")


def columns(path: Path) -> dict[str, NDArray[Any]]:
    """Return the columns of a table, empty entries as not-a-number; none where there is no file."""
    if not path.exists():
        return {}
    names, rows = read_table(path)
    return {name: np.array([row.get(name, math.nan) for row in rows]) for name in names}


def worth(table: Mapping[str, NDArray[Any]], name: str, zero: bool = False) -> bool:
    """Tell whether a column has anything to show: a number, and (unless `zero`) not only zeros."""
    values = table.get(name, np.zeros(0))
    finite = values[np.isfinite(values)]
    return len(finite) > 0 and (zero or bool(np.any(finite != 0)))


def say_nothing(axes: Any, words: str) -> None:
    """Write `words` where there is nothing to plot."""
    axes.text(0.5, 0.5, words, transform=axes.transAxes, ha="center", va="center", color="0.5", fontsize=9)


def verdict(record: Mapping[str, Any]) -> tuple[str, str, str]:
    """Return a headline, what stands below it, and their colour."""
    found = record["diagnostics"]
    inverted, crossed = found.get("inverted"), found.get("intersections")
    missed = [entry for entry in record.get("expect", ()) if not entry["met"]]
    words = [record["status"].upper()]
    if inverted is not None:
        words.append("no inverted element" if inverted == 0 else f"{inverted:,.0f} INVERTED")
    if "particles" in found:
        words.append(_count(found["particles"], "particle"))
    if "smallest_stretch" in found:
        words.append(f"smallest stretch {float(found['smallest_stretch']):.3g}")
    if crossed is not None:
        words.append("no intersection" if crossed == 0 else "INTERSECTED")
    if "smallest_gap" in found:
        words.append(f"smallest gap {float(found['smallest_gap']):.2g} m")
    if record["solver_iterations"]["total"]:
        words.append(_count(record["solver_iterations"]["total"], "solver iteration"))
    words.append(_count(record["steps"], "step"))
    words.append(f"{record['wall_seconds']:.3g} s")
    words.append(_count(record["ranks"], "rank"))
    second = record["reason"]
    if record.get("expect"):
        kept = len(record["expect"]) - len(missed)
        text = f"{kept} of {_count(len(record['expect']), 'expectation')} met"
        named = "; ".join(f"{e['name']} {e['wanted']}, found {_short(e['found'])}" for e in missed[:3])
        second = "; ".join(part for part in (second, text + (f". Missed: {named}" if named else "")) if part)
    if record["status"] != "finished":
        color = BAD
    else:
        color = DOUBTFUL if missed or inverted or crossed else GOOD
    return "  ·  ".join(words), second, color


def _count(number: float, noun: str) -> str:
    return f"{number:,.0f} {noun}" + ("" if number == 1 else "s")


def _short(found: Any) -> str:
    return f"{found:.4g}" if isinstance(found, float) else str(found)


def _write_verdict(figure: Figure, record: Mapping[str, Any]) -> None:
    """Write the verdict at the bottom of the figure."""
    headline, second, color = verdict(record)
    fits = 1550 / len(headline)
    figure.text(0.02, 0.055, headline, fontsize=min(11.5, fits), weight="bold", color=color, va="center")
    if second:
        figure.text(0.02, 0.02, second[:190], fontsize=9, color=color, va="center")
