"""`extremal study recommend SCENE`: settings from the points that sweeps have measured, and why."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from ..errors import InputError, suggestion
from ..scene import read_scene
from ..scene_errors import literal
from ..studies._table import machine
from .model import cases
from .report import digest
from .sentences import cost, halving, percent, where

SHIPPED = Path(__file__).resolve().parent.parent / "studies" / "fronts"
OWN = Path("results/studies")
NEAR = 10.0  # points whose error is within this factor speak for a recommendation
FINER = 15.0  # a reference that is not so many times as large, in size or steps, has a noticeable error of its own

YEAR = 3.2e7  # [s]

Study = Mapping[str, Any]


def recommend(scene: str, error: float | None, seconds: float | None) -> str:
    """What to set so that the error is below `error`, or as small as can be in `seconds` [s].

    Raises
    ------
    InputError
        If there is no such scene, no sweep of it, or none of its points is good enough.
    """
    name, content = _subject(scene)
    known = list(stored())
    mine = [study for study in known if subject(study) == name]
    if not mine:
        raise InputError(f"recommend {scene}: no sweep of it has been run; {suggestion(name, map(subject, known))}")
    found, reasons = [], []
    for study in mine:
        try:
            found.append(_recommended(study, content, error, seconds))
        except LookupError as reason:
            reasons.append(f"{study['name']}: {reason}")
    if not found:
        raise InputError(*(f"recommend {scene}: {reason}" for reason in reasons))
    return "\n\n".join([*found, *reasons])


def subject(study: Study) -> str:
    """Name of the scene or case of a sweep."""
    return str(study.get("scene") or study.get("case"))


def _subject(scene: str) -> tuple[str, str]:
    """Name and content of what is asked for: a scene file, a case, or the bare name of either."""
    path = Path(scene)
    if path.suffix == ".toml":
        read_scene(path)
        return path.stem, digest(path)
    if scene in cases():
        return scene, ""
    shipped = Path(__file__).resolve().parent.parent / "scenes" / f"{scene}.toml"
    return scene, digest(shipped) if shipped.is_file() else ""


def stored() -> Iterator[Study]:
    """The stored sweeps, one for each name: whole ones before short ones, the user's own before those shipped."""
    chosen: dict[str, Study] = {}
    for path in [*sorted(OWN.glob("*/study.json")), *sorted(SHIPPED.glob("*.json"))]:
        try:
            study = json.loads(path.read_text(encoding="utf-8"))
            name, short = study["name"], study["quick"]
        except (OSError, ValueError, KeyError, TypeError):
            continue
        if name not in chosen or (chosen[name]["quick"] and not short):
            chosen[name] = study
    yield from chosen.values()


def _recommended(study: Study, content: str, error: float | None, seconds: float | None) -> str:
    done = sorted((row for row in study["points"] if "error" in row), key=lambda row: (row["seconds"], row["error"]))
    row = _cheapest(study, done, error) if error is not None else _best(study, done, float(seconds or 0.0))
    lines = [f"{study['name']}: {study['title']}", f"    {where(study, row)}: {cost(row)}", ""]
    lines += [f"    {key} = {literal(value)}" for key, value in row["settings"].items()]
    if study["common"]:
        lines.append("  in this sweep all points had:")
        lines += [f"    {key} = {literal(value)}" for key, value in study["common"].items()]
    lines += ["", *(f"  {line}" for line in _why(study, row, done, error, seconds)), *_caveats(study, row, content)]
    return "\n".join(lines)


def _cheapest(study: Study, done: Sequence[Mapping[str, Any]], error: float) -> Mapping[str, Any]:
    good = [row for row in done if row["error"] <= error]
    if good:
        return good[0]
    if not done:
        raise LookupError("none of its points has an error")
    best = min(done, key=lambda row: row["error"])
    words = f"no point has an error of {percent(error)} or less; "
    words += f"the most accurate is {where(study, best)}: {cost(best)}"
    fit = study["fits"][best["method"]].get("seconds_of_error")
    if _understated(study, best):
        words += f"; {_understated(study, best)}"
    elif fit is not None and fit["slope"] < 0:
        more = fit["level"] * error ** fit["slope"]
        if fit["high"] is not None and fit["high"] >= 0:
            words += "; its time and error have no clear relation: nothing promises less"
        elif more > YEAR:
            words += f"; by its slope {percent(error)} would take years"
        else:
            words += f"; by its slope {percent(error)} would take about {more:.2g} s"
    raise LookupError(f"{words}; accepted is --error {_above(best['error'])} or more")


def _best(study: Study, done: Sequence[Mapping[str, Any]], seconds: float) -> Mapping[str, Any]:
    quick = [row for row in done if row["seconds"] <= seconds]
    if quick:
        return min(quick, key=lambda row: row["error"])
    if not done:
        raise LookupError("none of its points has an error")
    least = _above(done[0]["seconds"])
    raise LookupError(f"no point took {seconds:g} s or less; accepted is --seconds {least} or more")


def _above(number: float) -> str:
    """A number in two digits, not below it."""
    digit = 10.0 ** (math.floor(math.log10(number)) - 1)
    return f"{math.ceil(number / digit) * digit:.2g}"


def _why(
    study: Study, row: Mapping[str, Any], done: Sequence[Mapping[str, Any]], error: float | None, seconds: float | None
) -> Iterator[str]:
    if error is not None:
        yield f"why: the cheapest of {len(done)} points with {study['error']} at most {percent(error)}"
        yield f"margin: {error / row['error']:.2g}x in the error"
    else:
        yield f"why: the smallest {study['error']} of {len(done)} points, in at most {seconds:g} s"
        yield f"margin: {float(seconds or 0) / row['seconds']:.2g}x in time"
    near = [one for one in done if 1 / NEAR <= one["error"] / row["error"] <= NEAR]
    mine = sum(one["method"] == row["method"] for one in near)
    yield f"how sure: {len(near)} points within a factor of {NEAR:g} of its error, {mine} of them of {row['method']};"
    yield f"  with {row['method']} {halving(study['fits'][row['method']].get('seconds_of_error'))}"


def _understated(study: Study, row: Mapping[str, Any]) -> str:
    """What is to be said where the reference is hardly finer than a point; "" where it is, or nothing is known."""
    reference = study["reference"]
    if reference is None:
        return ""
    finer = max(reference["size"] / row["size"], reference["steps"] / row["steps"])
    if not 1 < finer < FINER:
        return ""
    return f"the reference is only {finer:.2g} times as large, so that the true error may be larger"


def _caveats(study: Study, row: Mapping[str, Any], content: str) -> Iterator[str]:
    if _understated(study, row):
        yield f"  {_understated(study, row)}"
    if processor(study["machine"]) != processor(machine()):
        yield f"  seconds are of another machine: {study['machine']}"
    if study["quick"]:
        yield "  from the short form of the sweep: run it without --quick"
    if study["digest"] != content:
        yield "  the scene was different when this was measured: run the sweep again to be sure"
    elif content:
        yield "  measured on this very scene"


def processor(machine_: str) -> str:
    """The processor of a machine as `machine` tells it."""
    return machine_.partition(",")[0]
