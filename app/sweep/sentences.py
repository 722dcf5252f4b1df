"""What a sweep says, in plain words."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from .points import plain

TARGETS = (0.1, 0.01, 0.001)  # errors of interest


def sentences(study: Mapping[str, Any]) -> list[str]:
    """Cost of half the error, the cheapest way to some errors, what failed."""
    return [*_halving(study), *_cheapest(study), *_failed(study)]


def _halving(study: Mapping[str, Any]) -> Iterator[str]:
    for method, fits in study["fits"].items():
        yield f"With {method}, {halving(fits.get('seconds_of_error'))}."


def halving(fit: Mapping[str, Any] | None) -> str:
    """What half the error costs by a fit of seconds against error."""
    if fit is None:
        return "there are too few points to say what half the error costs"
    factor = 2 ** -fit["slope"]
    if fit["low"] is None:
        if fit["slope"] >= 0:
            return "time and error have no clear relation (two points)"
        return f"halving the error costs {_times(factor)} the time (two points: nothing is known of its confidence)"
    if fit["high"] >= 0:
        return f"time and error have no clear relation ({fit['count']} points)"
    low, high = 2 ** -fit["high"], 2 ** -fit["low"]
    return (
        f"halving the error costs {_times(factor)} the time (95% confidence: {_times(low)} to {_times(high)}, "
        f"{fit['count']} points)"
    )


def _times(factor: float) -> str:
    return f"{factor:.2g}x" if factor >= 1.95 else f"{factor:.3g}x"


def _cheapest(study: Mapping[str, Any]) -> Iterator[str]:
    done = sorted((row for row in study["points"] if "error" in row), key=lambda row: (row["seconds"], row["error"]))
    if not done:
        return
    best = min((row for row in done if row.get("front")), key=lambda row: row["error"])
    said: dict[int, tuple[float, Mapping[str, Any]]] = {}
    for target in TARGETS:
        found = next((row for row in done if row["error"] <= target), None)
        if found is not None:
            said[id(found)] = (target, found)  # of several targets that one point meets, the hardest
    for target, row in said.values():
        yield f"The cheapest way to an error of {percent(target)} is {where(study, row)}: {cost(row)}."
    if id(best) not in said:
        yield f"The most accurate is {where(study, best)}: {cost(best)}."


def where(study: Mapping[str, Any], row: Mapping[str, Any]) -> str:
    """Method and knob of a point."""
    if row["value"] is None:
        return str(row["method"])
    return f"{row['method']} at {study['knob'][0]} = {plain(row['value'])}"


def cost(row: Mapping[str, Any]) -> str:
    """Seconds and error of a point."""
    return f"{row['seconds']:.2g} s (its error: {percent(row['error'])})"


def percent(error: float) -> str:
    """An error as people say it."""
    return f"{100 * error:.2g}%" if error >= 9.5e-5 else f"{error:.1e}"


def _failed(study: Mapping[str, Any]) -> Iterator[str]:
    failed = [row for row in study["points"] if "error" not in row]
    if failed:
        words = "; ".join(f"{where(study, row)} ({row['reason']})" for row in failed)
        verb = "has" if len(failed) == 1 else "have"
        yield f"{len(failed)} of {len(study['points'])} points {verb} failed: {words}."
