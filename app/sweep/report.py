"""What a sweep found: study.json, study.csv, the table."""

from __future__ import annotations

import csv
import datetime
import hashlib
import json
import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from ..errors import InputError
from ..results import atomic, write_text
from ..studies._table import aligned, machine
from .fits import Fit, front, power_law
from .model import Sweep
from .norms import comparison
from .points import REFERENCE, flat, plain
from .running import RUN, Facts
from .sentences import sentences

SMALLEST = 1e-16  # the error of a point that agrees with the reference to the last digit
CSV = (
    "method", "value", "status", "reason", "error", "seconds", "wall_seconds", "total_cpu_seconds", "memory", "size",
    "steps", "iterations", "ranks", "front", "folder",
)  # fmt: skip


def assemble(sweep: Sweep, facts: Sequence[Facts], points: Path, quick: bool) -> dict[str, Any]:
    """Errors, front, fits and sentences of a sweep whose points have been run, as study.json has them.

    Raises
    ------
    ArithmeticError
        If the reference failed.
    """
    reference = next((one for one in facts if one["method"] == REFERENCE), None)
    if reference is not None and reference["status"] != "finished":
        raise ArithmeticError(f"the reference failed: {reference['reason']}")
    rows = [{**one} for one in facts if one is not reference]
    if sweep.error is not None and sweep.reference is not None:
        value = sweep.reference.value
        there = points / reference["folder"] / RUN if reference is not None else float(value or 0.0)
        try:
            error_of = comparison(sweep.error, there)
        except (ValueError, OSError) as failure:
            raise ArithmeticError(f"the reference cannot be compared with: {failure}") from None
        for row in rows:
            if row["status"] == "finished":
                _compare(row, points, error_of)
    done = [row for row in rows if "error" in row]
    for k in front([row["seconds"] for row in done], [row["error"] for row in done]):
        done[k]["front"] = True
    study = {
        "name": sweep.name,
        "title": sweep.title,
        "scene" if sweep.case is None else "case": sweep.subject,
        "digest": "" if sweep.case is not None else digest(sweep.scene_path),
        "error": sweep.measure,
        "knob": list(sweep.knob.key),
        "common": flat(sweep.set),
        "quick": quick,
        "machine": machine(),
        "versions": next((row["versions"] for row in rows if "versions" in row), {}),
        "made": datetime.date.today().isoformat(),
        "reference": reference,
        "points": rows,
        "fits": {method: _fits(mine) for method, mine in lines_of(rows).items()},
    }
    study["sentences"] = sentences(study)
    return study


def _compare(row: Facts, points: Path, error_of: Callable[[Path], float]) -> None:
    try:
        error = error_of(points / row["folder"] / RUN)
    except (ValueError, OSError, InputError) as failure:
        row["status"], row["reason"] = "failed", f"no error: {str(failure).splitlines()[0]}"
        return
    if math.isfinite(error):
        row["error"] = max(error, SMALLEST)
    else:
        row["status"], row["reason"] = "failed", f"its error is {error}"


def digest(scene: Path) -> str:
    """What tells a scene from another, or from what it was."""
    return hashlib.sha256(scene.read_bytes()).hexdigest()[:16]


def lines_of(rows: Sequence[Facts]) -> dict[str, list[Facts]]:
    """Points by method, in their order."""
    out: dict[str, list[Facts]] = {}
    for row in rows:
        out.setdefault(row["method"], []).append(row)
    return out


def _fits(rows: Sequence[Facts]) -> dict[str, Any]:
    """Power laws of a line: seconds against error, error against size, error against the knob, seconds against size."""
    done = [row for row in rows if "error" in row]
    errors, seconds, sizes = ([row[key] for row in done] for key in ("error", "seconds", "size"))
    knob = [row["value"] for row in done]
    numbers = all(isinstance(v, int | float) and not isinstance(v, bool) for v in knob)
    found = {
        "seconds_of_error": power_law(errors, seconds),
        "error_of_size": power_law(sizes, errors),
        "error_of_knob": power_law(knob, errors) if numbers else None,
        "seconds_of_size": power_law(sizes, seconds),
    }
    return {name: _told(fit) for name, fit in found.items() if fit is not None}


def _told(fit: Fit) -> dict[str, Any]:
    """A fit as JSON has it: no confidence where there is none."""
    known = math.isfinite(fit.low)
    return {
        "slope": fit.slope,
        "low": fit.low if known else None,
        "high": fit.high if known else None,
        "level": fit.level,
        "count": fit.count,
    }


def write(study: Mapping[str, Any], folder: Path) -> None:
    """Write study.json, study.csv and study.png."""
    from .picture import draw

    write_text(folder / "study.json", json.dumps(study, indent=1, ensure_ascii=False) + "\n")
    with atomic(folder / "study.csv") as partial, open(partial, "w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, CSV, restval="", extrasaction="ignore", lineterminator="\n")
        writer.writeheader()
        for row in study["points"]:
            writer.writerow({**row, "iterations": _iterations(row)})
    draw(study, folder / "study.png")


def _iterations(row: Facts) -> str:
    counts = row["iterations"]
    return " / ".join(str(counts[key]) for key in sorted(counts, key=_order))


def _order(name: str) -> tuple[bool, str]:
    return (not name.startswith("newton"), name)


def table(study: Mapping[str, Any]) -> str:
    """All points as Markdown; those of the front have a star."""
    names = {key.removesuffix("_iterations") for row in study["points"] for key in row["iterations"]}
    said = " / ".join(sorted(names, key=_order)) or "iterations"
    columns = ("method", study["knob"][0], "size", "steps", said, "seconds", "wall [s]", "MiB", "error", "note")
    out = []
    for row in study["points"]:
        good = "error" in row
        out.append(
            (
                row["method"],
                plain(row["value"]),
                row["size"] or "",
                row["steps"] or "",
                _iterations(row),
                f"{row['seconds']:.3g}" if row["seconds"] else "",
                f"{row['wall_seconds']:.3g}" if row["seconds"] else "",
                f"{row['memory'] / 2**20:.0f}" if row["memory"] else "",
                f"{row['error']:.2e}" if good else "",
                "*" if row.get("front") else "" if good else f"{row['status']}: {row['reason']}",
            )
        )
    return aligned(columns, out)


def slopes(study: Mapping[str, Any]) -> str:
    """The fitted slopes as Markdown, with their 95% confidence."""
    columns = ("method", f"error ~ {study['knob'][0]}^p", "error ~ size^p", "seconds ~ size^p", "seconds ~ error^p")
    keys = ("error_of_knob", "error_of_size", "seconds_of_size", "seconds_of_error")
    lines = [(method, *(_slope(fits.get(key)) for key in keys)) for method, fits in study["fits"].items()]
    shown = [k for k in range(len(columns)) if k == 0 or any(line[k] for line in lines)]
    return aligned([columns[k] for k in shown], [[line[k] for k in shown] for line in lines])


def _slope(fit: Mapping[str, Any] | None) -> str:
    if fit is None:
        return ""
    if fit["low"] is None:
        return f"{fit['slope']:.2f} (two points)"
    return f"{fit['slope']:.2f} ({fit['low']:.2f} to {fit['high']:.2f})"
