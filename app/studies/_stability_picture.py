"""The stability map as a picture, a table and in words."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from statistics import median

from ..results import atomic
from ._stability_cases import CASES
from ._table import Row, aligned
from .stability import BY_NAME, MODELS, NAIVE

# the colours of Okabe and Ito, which people who do not tell red from green can tell
COLOURS = {
    "recovered": "#8fd0b5",
    "moving": "#a9d4f0",
    "untangled": "#f3e26b",
    "tangled": "#e89a6a",
    "failed": "#bdbdbd",
    "broken": "#000000",
}
WORDS = {
    "recovered": "recovered: at rest, nothing inverted",
    "moving": "moving: stable, no time yet to come to rest",
    "untangled": "untangled, but not at rest",
    "tangled": "tangled: inverted elements remain",
    "failed": "failed before an iterate could be judged",
    "broken": "broken: NaN, energy from nothing, state changed",
}
LETTERS = {"moving": "M", "untangled": "U", "tangled": "T", "failed": "F", "broken": "B"}


def _cells(rows: Sequence[Row]) -> dict[tuple[str, str], list[Row]]:
    cells: dict[tuple[str, str], list[Row]] = {}
    for row in rows:
        cells.setdefault((row["case"], row["model"]), []).append(row)
    return cells


def _newton(runs: Sequence[Row]) -> str:
    """Median Newton iterations of the runs that recover or move, nothing if there is none."""
    good = [int(row["newton"]) for row in runs if row["outcome"] in ("recovered", "moving")]
    return f"{median(good):.0f}" if good else ""


def _false(runs: Sequence[Row]) -> int:
    """Runs of which the solver says that they are in equilibrium, though they are not at rest."""
    still = [row for row in runs if BY_NAME[row["case"]].dt is None]
    return sum(row["end"] == "converged" and row["outcome"] in ("tangled", "untangled") for row in still)


def sentences(rows: Sequence[Row]) -> list[str]:
    """One sentence a model: how its runs end."""
    out = []
    for name, model in MODELS.items():
        runs = [row for row in rows if row["model"] == name]
        if runs:
            counts = {key: sum(row["outcome"] == key for row in runs) for key in COLOURS}
            words = ", ".join(f"{count} {key}" for key, count in counts.items() if count)
            lies = f"; {_false(runs)} of them in a false equilibrium" if _false(runs) else ""
            out.append(f"{model.label}: {len(runs)} runs, {words}{lies}.")
    return out


def table(rows: Sequence[Row]) -> str:
    """A Markdown table: a row for each case, a column for each model."""
    cells, models = _cells(rows), [name for name in MODELS if any(row["model"] == name for row in rows)]
    lines = []
    for case in CASES:
        if any((case.name, model) in cells for model in models):
            lines.append([case.name, *(_words(cells.get((case.name, model), [])) for model in models)])
    return aligned(["case", *models], lines)


def _words(runs: Sequence[Row]) -> str:
    counts = {letter: sum(row["outcome"] == key for row in runs) for key, letter in LETTERS.items()}
    bad = " ".join(f"{count}{letter}" for letter, count in counts.items() if count)
    good = sum(row["outcome"] == "recovered" for row in runs)
    newton = _newton(runs)
    return " ".join(part for part in (f"{good}/{len(runs)}", bad, newton and f"({newton})") if part)


def draw(path: Path, rows: Sequence[Row]) -> None:
    """Draw a row for each case and a column for each model, coloured by the share of each outcome.

    Raises
    ------
    OutputError
        If the picture cannot be written.
    """
    from matplotlib.figure import Figure
    from matplotlib.patches import Patch, Rectangle

    cells = _cells(rows)
    models = [name for name in MODELS if any(model == name for _, model in cells)]
    cases = [case for case in CASES if any((case.name, model) in cells for model in models)]
    if not cases:
        return
    places: dict[str, float] = {}
    groups: dict[str, float] = {}
    y = 0.0
    for case in cases:
        if case.group not in groups:
            y += 0.35 if groups else 0.0
            groups[case.group] = y
        places[case.name] = y
        y += 1
    columns = {name: k + 0.25 * (name in NAIVE) for k, name in enumerate(models)}
    size = (3.3 + 0.98 * len(models), 1.9 + 0.245 * y)
    figure = Figure(figsize=size, dpi=110, facecolor="white", layout="constrained")
    axes = figure.add_subplot()
    for case in cases:
        axes.text(-0.1, places[case.name] + 0.52, case.label, fontsize=7.5, ha="right", va="center")
        for model, x in columns.items():
            runs, top = cells.get((case.name, model), []), places[case.name]
            left, false = x, _false(runs)
            for outcome, colour in COLOURS.items():
                share = sum(row["outcome"] == outcome for row in runs) / max(1, len(runs))
                axes.add_patch(Rectangle((left, top + 0.04), 0.96 * share, 0.92, color=colour, lw=0))
                left += 0.96 * share
            good = sum(row["outcome"] == "recovered" for row in runs)
            text = _newton(runs) + (f"  {good}/{len(runs)}" if 0 < good < len(runs) else "")
            text += ("  " if text else "") + (f"false {false}" if false and len(runs) > 1 else "false" * bool(false))
            axes.text(x + 0.48, top + 0.52, text, ha="center", va="center", fontsize=7)
    axes.set_yticks([])
    for group, top in groups.items():
        axes.text(-1.98, top + 0.5, group, fontsize=8, fontweight="bold", va="center", clip_on=False)
    labels = [MODELS[name].label.replace(", ", ",\n") for name in models]
    labels = [label.replace(" Neo-", "\nNeo-").replace(" never", "\nnever") for label in labels]
    axes.set_xticks([x + 0.48 for x in columns.values()], labels, fontsize=7.5)
    axes.xaxis.tick_top()
    axes.tick_params(length=0)
    axes.set_xlim(-2.0, max(columns.values()) + 1)
    axes.set_ylim(y, 0)
    for edge in axes.spines.values():
        edge.set_visible(False)
    there = {row["outcome"] for row in rows}
    patches = [Patch(color=colour, label=WORDS[name]) for name, colour in COLOURS.items() if name in there]
    axes.legend(handles=patches, loc="upper center", bbox_to_anchor=(0.4, 0), ncols=3, fontsize=7.5, frameon=False)
    count = ", ".join(sorted({row["cells"] for row in rows}, key=int))
    figure.suptitle(
        f"Unit cube of {count} tetrahedra, one face held: how {len(rows)} runs end. Numbers: median Newton iterations "
        "and recovered / run.\nfalse: the solver reports an equilibrium that is not at rest.",
        fontsize=8,
    )
    with atomic(path) as partial:
        figure.savefig(partial, format="png")
