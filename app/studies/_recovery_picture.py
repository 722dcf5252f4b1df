"""The recovery map as a picture and in words."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from statistics import median
from typing import Any

from ..results import atomic
from ._table import Row
from .recovery import MODELS, STARTS

OUTCOMES = ("recovered", "untangled", "tangled", "failed")


def sentences(rows: Sequence[Row]) -> list[str]:
    """One sentence a model: how often it recovers, at what cost, and how the rest ended."""
    out = []
    for model in _present(MODELS, rows, "model"):
        runs = [row for row in rows if row["model"] == model]
        good = [row for row in runs if row["outcome"] == "recovered"]
        words = f"{MODELS[model].label}: recovers in {len(good)} of {len(runs)} runs"
        if good:
            newton = [int(row["newton"]) for row in good]
            seconds = [float(row["seconds"]) for row in good]
            words += f", with {median(newton):g} Newton iterations in {median(seconds):.1f} s (median), "
            words += f"at most {max(newton)} and {max(seconds):.1f} s"
        rest = {name: sum(row["outcome"] == name for row in runs) for name in OUTCOMES[1:]}
        if any(rest.values()):
            words += "; " + ", ".join(f"{count} {_WORDS[name]}" for name, count in rest.items() if count)
        search = sum("LINE_SEARCH" in row["end"] for row in runs if row["outcome"] != "recovered")
        if search:
            words += f" ({search} stopped in the line search)"
        out.append(words + ".")
    return out


_WORDS = {"untangled": "end untangled but not at rest", "tangled": "stay tangled", "failed": "fail at once"}


def _present(names: dict, rows: Sequence[Row], column: str) -> list[str]:
    there = {row[column] for row in rows}
    return [name for name in names if name in there]


def draw(path: Path, rows: Sequence[Row]) -> None:
    """Draw a panel a start: model against ν, coloured by the share recovered, with Newton iterations.

    Raises
    ------
    OutputError
        If the picture cannot be written.
    """
    from matplotlib import colormaps
    from matplotlib.cm import ScalarMappable
    from matplotlib.figure import Figure

    if not rows:
        return
    models, starts = _present(MODELS, rows, "model"), _present(STARTS, rows, "start")
    ratios = sorted({float(row["poisson_ratio"]) for row in rows})
    colours = colormaps["RdYlGn"]
    columns = min(3, len(starts) + 1)
    lines = -(-(len(starts) + 1) // columns)
    size = (2.4 + columns * (0.8 + 0.52 * len(ratios)), lines * (1.0 + 0.46 * len(models)))
    figure = Figure(figsize=size, dpi=120, facecolor="white", layout="constrained")
    axes = figure.subplots(lines, columns, squeeze=False).ravel()
    for panel, start in zip(axes, starts):
        first = panel.get_subplotspec().is_first_col()
        panel.set_title(STARTS[start].label, fontsize=10)
        panel.set_xticks(range(len(ratios)), [f"{ν:g}" for ν in ratios], fontsize=8)
        panel.set_yticks(range(len(models)), [MODELS[m].label if first else "" for m in models], fontsize=9)
        panel.set_xlabel("ν", fontsize=9)
        panel.set_xlim(-0.5, len(ratios) - 0.5)
        panel.set_ylim(len(models) - 0.5, -0.5)
        panel.tick_params(length=0)
        for edge in panel.spines.values():
            edge.set_visible(False)
        for j, model in enumerate(models):
            for i, ν in enumerate(ratios):
                runs = [
                    row
                    for row in rows
                    if (row["model"], row["start"], float(row["poisson_ratio"])) == (model, start, ν)
                ]
                if runs:
                    _cell(panel, i, j, runs, colours)
    for spare in axes[len(starts) :]:
        spare.axis("off")
    legend = axes[len(starts)]
    bar = figure.colorbar(
        ScalarMappable(cmap=colours), cax=legend.inset_axes((0.1, 0.72, 0.8, 0.06)), orientation="horizontal"
    )
    bar.set_label("share of the runs that recover", fontsize=9)
    bar.ax.tick_params(labelsize=8)
    cells = ", ".join(sorted({row["cells"] for row in rows}, key=int))
    text = (
        f"Cube of {cells} tetrahedra, one face held, equilibrium.\n"
        "Large: median Newton iterations of the\nruns that recover (– if none does).\n"
        "Small: recovered / run, where not all do."
    )
    legend.text(0.5, 0.45, text, fontsize=9, ha="center", va="top", transform=legend.transAxes)
    with atomic(path) as partial:
        figure.savefig(partial, format="png")


def _cell(panel: Any, i: int, j: int, runs: Sequence[Row], colours: Any) -> None:
    good = [int(row["newton"]) for row in runs if row["outcome"] == "recovered"]
    share = len(good) / len(runs)
    from matplotlib.patches import Rectangle

    panel.add_patch(Rectangle((i - 0.48, j - 0.47), 0.96, 0.94, color=colours(share), alpha=0.85, lw=0))
    number = f"{median(good):.0f}" if good else "–"
    whole = len(good) == len(runs)
    panel.text(i, j if whole else j - 0.13, number, ha="center", va="center", fontsize=9)
    if not whole:
        panel.text(i, j + 0.27, f"{len(good)}/{len(runs)}", ha="center", va="center", fontsize=6.5)
