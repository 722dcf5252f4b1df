"""`summary.png` of a run on a network: who took part when, the network, how good and how sure the answer is."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib import ticker
from matplotlib.figure import Figure

from extremal.hawkes.scores import wilson

from .csv_columns import Columns, read_columns
from .hawkes_picture import draw_network, draw_timelines
from .results import CALIBRATION, EVENTS, HISTORY, ITERATIONS, PARAMETERS, PREDICTIONS, SCORES, SUMMARY
from .summary_page import columns, page, say_nothing, worth

if TYPE_CHECKING:
    from numpy.typing import NDArray

SHADES = ("#08519c", "#6baed6", "#c6dbef")  # first, second, third place
ANSWERS = {
    "weights": "weights of (3.5)",
    "probabilities": "probabilities",
    "guessing": "guessing",
    "frequent": "most frequent pair",
    "linear": "complete events alone",
}
SYMBOLS = {"background": "μ", "branching": "θ", "decay": "ω"}
COLORS = {"background": "#1b9e77", "branching": "#d95f02", "decay": "#7570b3"}


def draw(folder: Path) -> Path:
    """Draw the summary of a results folder and return its path.

    Raises
    ------
    OutputError
        If the picture cannot be written.
    """
    parameters = _table(folder / PARAMETERS)
    with page(folder, height=8.0, dpi=95) as (figure, record):
        if parameters is None:  # a run that failed has no result
            _draw_iterations(figure.add_axes((0.09, 0.465, 0.87, 0.42)), columns(folder / ITERATIONS))
        else:
            predictions, events = _table(folder / PREDICTIONS), _table(folder / EVENTS)
            assert events is not None
            draw_timelines(figure.add_axes((0.09, 0.465, 0.545, 0.42)), events, predictions, parameters, _unit(record))
            draw_network(figure.add_axes((0.66, 0.42, 0.335, 0.50)), parameters)
        _draw_row(figure, folder, record, parameters)
    return folder / SUMMARY


def _table(path: Path) -> Columns | None:
    if not path.exists():
        return None
    with open(path, encoding="utf-8") as file:
        names = file.readline().rstrip("\n").split(",")
        if not file.readline():
            return None
    return read_columns(path, names, (), [])


def _unit(record: Mapping[str, Any]) -> str:
    events = record["scene"].get("events")
    return f" [{events['unit']}]" if events else ""


def _draw_iterations(axes: Any, iterations: Mapping[str, NDArray[Any]]) -> None:
    """How near TAO came."""
    names = {"gap": "proven gap, over the energy", "residual": "residual"}
    shown = [name for name in names if worth(iterations, name)]
    for name in shown:
        axes.plot(iterations["total"], iterations[name], label=names[name])
    if shown:
        axes.set_yscale("log")
        axes.legend(fontsize=9, frameon=False)
        axes.set_xlabel("iteration", fontsize=9)
    else:
        say_nothing(axes, "no result")


def _draw_row(figure: Figure, folder: Path, record: Mapping[str, Any], parameters: Columns | None) -> None:
    """The row of small panels: what there is of scores, calibration, convergence, certainty, and the figures."""
    scores, calibration, history = _table(folder / SCORES), _table(folder / CALIBRATION), columns(folder / HISTORY)
    predictions = _table(folder / PREDICTIONS)
    panels: list[Callable[[Any], None]] = []
    if scores is not None:
        panels.append(lambda axes: _draw_scores(axes, scores))
    if calibration is not None:
        panels.append(lambda axes: _draw_calibration(axes, calibration))
    if record["scene"].get("estimation"):
        panels.append(lambda axes: _draw_convergence(axes, history))
    if scores is None and predictions is not None:
        panels.append(lambda axes: _draw_certainty(axes, predictions))
    left = 0.135 if scores is not None else 0.06
    width = (0.72 - left) / max(len(panels), 1)
    for i, panel in enumerate(panels):
        axes = figure.add_axes((left + i * width, 0.15, min(width - 0.06, 0.26), 0.21))
        axes.tick_params(labelsize=8)
        axes.spines[["top", "right"]].set_visible(False)
        panel(axes)
    for k, line in enumerate(_figures(record, parameters)):
        figure.text(0.745, 0.362 - 0.0235 * k, line, fontsize=9.5, va="center", family="DejaVu Sans Mono")


def _draw_scores(axes: Any, scores: Columns) -> None:
    answers = scores["answer"]
    rows = np.arange(len(answers))[::-1]
    for k in (3, 2, 1):
        share = 100 * scores.numbers(f"top{k}", "", np.nan)
        axes.barh(rows, share, color=SHADES[k - 1], height=0.62, label=f"in the first {k}" if k > 1 else "first")
    low, high = (100 * scores.numbers(f"top1_{end}", "", np.nan) for end in ("low", "high"))
    axes.hlines(rows, low, high, color="black", lw=1.2)
    axes.set_yticks(rows, [ANSWERS[answer] for answer in answers])
    axes.set_xlim(0, 100)
    axes.xaxis.set_major_formatter(ticker.PercentFormatter(decimals=0))
    axes.set_title("truth in the first 1, 2, 3 places", fontsize=10, loc="left")


def _draw_calibration(axes: Any, calibration: Columns) -> None:
    predicted, observed, count = (calibration.numbers(name, "") for name in ("predicted", "observed", "count"))
    low, high = np.transpose([wilson(share, number) for share, number in zip(observed, count)])
    axes.plot([0, 1], [0, 1], color="0.7", lw=1)
    axes.errorbar(predicted, observed, (observed - low, high - observed), fmt="o", ms=4, lw=1, color=SHADES[0])
    axes.set_xlim(-0.02, 1.02)
    axes.set_ylim(-0.02, 1.02)
    axes.set_xlabel("predicted probability", fontsize=9)
    axes.set_title("came true", fontsize=10, loc="left")


def _draw_convergence(axes: Any, history: Mapping[str, NDArray[Any]]) -> None:
    for name, symbol in SYMBOLS.items():
        values = history[name]
        axes.plot(history["time"], values / values[-1], label=symbol, color=COLORS[name], lw=1.3)
    axes.legend(fontsize=9, frameon=False, ncols=3, loc="best", handlelength=1.2)
    axes.set_xlabel("round", fontsize=9)
    axes.set_title("estimate over its last value", fontsize=10, loc="left")
    axes.grid(alpha=0.25)


def _draw_certainty(axes: Any, predictions: Columns) -> None:
    what = "probability" if "probability" in predictions else "weight"
    first = np.array(predictions["rank"]) == "1"
    axes.hist(predictions.numbers(what, "")[first], bins=np.linspace(0, 1, 21), color=SHADES[1], edgecolor="white")
    axes.set_xlim(0, 1)
    axes.yaxis.set_major_locator(ticker.MaxNLocator(4, integer=True))
    axes.set_xlabel(f"{what} of the first candidate", fontsize=9)
    axes.set_title("incomplete events", fontsize=10, loc="left")


def _figures(record: Mapping[str, Any], parameters: Columns | None) -> list[str]:
    """What is best said in numbers."""
    found = record["diagnostics"]
    lines = [f"{found['events']:,.0f} events, {found['incomplete']:,.0f} incomplete"]
    if found["unresolvable"]:
        lines.append(f"{found['unresolvable']:,.0f} on no active pair")
    lines.append(f"{found['slots']:,.0f} candidates in all")
    if "gap" in found:
        lines.append(f"proven gap {found['gap']:.1e}, {found['tao_iterations']:.0f} TAO iterations")
    if "log_loss" in found:
        lines.append(f"log-loss {found['log_loss']:.3f} (guessing {found['log_loss_guessing']:.3f})")
    if parameters is not None:
        unit = (record["scene"].get("events") or {}).get("unit", "").rstrip("s")
        lines += ["", *(_parameter(parameters, name, unit) for name in SYMBOLS)]
    return lines


def _parameter(table: Columns, name: str, unit: str) -> str:
    values = table.numbers(name, "")
    per = f" /{unit}" if unit and name != "branching" else ""
    text = f"{SYMBOLS[name]} {np.mean(values):.4g}"
    if f"{name}_error" in table and np.ptp(values) == 0:
        text += f" ± {table.numbers(f'{name}_error', '')[0]:.1g}"
    elif np.ptp(values) > 1e-12 * np.mean(values):
        text += f", from {values.min():.3g} to {values.max():.3g}"
    return text + per
