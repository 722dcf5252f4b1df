"""Work-precision picture of a sweep, and the time-accuracy-size spectrum.

The spectrum is that of Chang, Fabien, Knepley and Mills, "Comparative study of finite element methods using the
time-accuracy-size (TAS) spectrum analysis", SIAM Journal on Scientific Computing 40 (2018): digits of accuracy
DoA = -log10(error), of size DoS = log10(size), and of efficacy DoE = -log10(error x time).
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ..results import atomic
from .points import plain

Line = tuple[list[float], list[float]]


def draw(study: Mapping[str, Any], path: Path) -> None:
    """Draw the four panels.

    Raises
    ------
    OutputError
        If the picture cannot be written.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10.5, 8.0), layout="constrained")
    (work, convergence), (rate, efficacy) = figure.subplots(2, 2)
    names = list(study["fits"])
    for k, name in enumerate(names):
        rows = [row for row in study["points"] if row["method"] == name and "error" in row]
        style = {"color": f"C{k % 10}", "marker": "os^vDP*Xp<"[k % 10], "ms": 5, "lw": 1.2, "label": name}
        errors, seconds = [row["error"] for row in rows], [row["seconds"] for row in rows]
        work.loglog(seconds, errors, **style)
        _converge(convergence, study, name, rows, style)
        rate.loglog(seconds, [row["size"] * row["steps"] / s for row, s in zip(rows, seconds)], **style)
        efficacy.plot(np.log10(seconds), -np.log10(errors), **style)
    _front(work, study)
    _failures(work, study, names)
    work.set(xlabel="processor seconds", ylabel=study["error"], title="work and precision")
    rate.set(xlabel="processor seconds", ylabel="size x steps per second", title="rate")
    efficacy.set(xlabel="digits of time, log10(s)", ylabel="digits of accuracy, -log10(error)", title="efficacy")
    _efficacy_lines(efficacy)
    for axes in (work, convergence, rate, efficacy):
        axes.grid(alpha=0.3)
        axes.yaxis.label.set_fontsize(9)
    handles, labels = work.get_legend_handles_labels()
    figure.legend(handles, labels, loc="lower center", ncol=4, frameon=False, fontsize=9)
    below = 0.03 * (1 + -(-len(labels) // 4))
    figure.get_layout_engine().set(rect=(0, below, 1, 1 - below))
    figure.suptitle(study["title"] or study["name"])
    with atomic(path) as partial:
        figure.savefig(partial, format="png", dpi=90)


def _converge(axes: Any, study: Mapping[str, Any], name: str, rows: list[Any], style: dict[str, Any]) -> None:
    """Error against size; against the knob where all have the same size."""
    key, fitted, label = "size", "error_of_size", "size (degrees of freedom, particles or slots)"
    if len({row["size"] for row in study["points"] if row["size"]}) < 2:
        key, fitted, label = "value", "error_of_knob", study["knob"][0]
    fit = study["fits"][name].get(fitted)
    if key == "value" and any(row["value"] is None for row in rows):
        axes.axhline(rows[0]["error"], **{**style, "marker": ""})
        return
    if key == "value" and not any(fitted in fits for fits in study["fits"].values()):
        x = [str(row["value"]) for row in rows]
        axes.semilogy(x, [row["error"] for row in rows], **style)
    else:
        x = [row[key] for row in rows]
        axes.loglog(x, [row["error"] for row in rows], **style)
    if fit is not None:
        ends = np.array([min(x), max(x)], dtype=float)
        axes.loglog(ends, fit["level"] * ends ** fit["slope"], "--", color=style["color"], lw=0.8)
        end = (ends[1], fit["level"] * ends[1] ** fit["slope"])
        axes.annotate(
            f"{fit['slope']:.2f}", end, xytext=(-12, 7), textcoords="offset points", fontsize=8, color=style["color"]
        )
    axes.set(xlabel=label, ylabel="error", title="convergence, with fitted slopes")


def _front(axes: Any, study: Mapping[str, Any]) -> None:
    best = sorted((row["seconds"], row["error"]) for row in study["points"] if row.get("front"))
    if best:
        x, y = zip(*best)
        axes.loglog(x, y, "-", color="black", lw=4, alpha=0.15, zorder=0)
        axes.loglog(x, y, "o", mfc="none", mec="black", ms=11, label="Pareto front")


def _failures(axes: Any, study: Mapping[str, Any], names: list[str]) -> None:
    """Points without an error are crosses at the upper edge, or at its corner where their time is unknown."""
    failed = [row for row in study["points"] if "error" not in row]
    least = min((row["seconds"] for row in study["points"] if row["seconds"] > 0), default=1.0)
    for row in failed:
        x = row["seconds"] or least
        axes.plot(
            x, 1.0, "x", ms=9, mew=2, color=f"C{names.index(row['method']) % 10}", clip_on=False,
            transform=axes.get_xaxis_transform(),
        )  # fmt: skip
        axes.annotate(
            f"{plain(row['value'])}: {row['status']}", (x, 0.97), xycoords=axes.get_xaxis_transform(),
            fontsize=7, rotation=90, va="top", ha="right",
        )  # fmt: skip
    if failed:
        axes.plot([], [], "x", ms=9, mew=2, color="grey", label="failed")


def _efficacy_lines(axes: Any) -> None:
    """Lines of equal efficacy DoE = DoA - log10(s)."""
    (left, right), (low, high) = axes.get_xlim(), axes.get_ylim()
    for level in np.arange(np.floor(low - right), np.ceil(high - left) + 1):
        axes.plot([left, right], [left + level, right + level], ":", color="grey", lw=0.7, zorder=0)
    axes.set(xlim=(left, right), ylim=(low, high))
    axes.text(0.02, 0.02, "dotted: equal efficacy", transform=axes.transAxes, fontsize=7, color="grey")
