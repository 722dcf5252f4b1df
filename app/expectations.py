"""`[expect]`: what a scene promises about its end, and whether it kept it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Protocol

from .errors import suggestion

# Accepted difference from an expected value that comes without a tolerance, relative to the value.
RELATIVE = 1e-6


class Wanted(Protocol):
    """An entry of `[expect]`; the keys that are not None must all hold."""

    value: Any
    tolerance: float | None
    below: float | None
    above: float | None


@dataclass(frozen=True)
class Expectation:
    """One entry of `[expect]` and what became of it."""

    name: str
    wanted: str
    found: float | str | None
    met: bool
    hint: str = ""

    def __str__(self) -> str:
        found = f"{self.found:.6g}" if isinstance(self.found, float) else self.found
        return f"expect {self.name} {self.wanted}: {self.hint or found}, {'met' if self.met else 'MISSED'}"


def check_expectations(
    expected: Mapping[str, Wanted], results: Mapping[str, float | str]
) -> list[Expectation]:
    """Compare the scene's `[expect]` with the final diagnostics, "status" and "steps"."""
    return [
        Expectation(name, _words(wanted), results[name], _met(wanted, results[name]))
        if name in results
        else Expectation(
            name, _words(wanted), None, False, f"no such diagnostic; {suggestion(name, results)}"
        )
        for name, wanted in expected.items()
    ]


def _met(wanted: Wanted, found: float | str) -> bool:
    if isinstance(wanted.value, str) or isinstance(found, str):
        return wanted.value == found
    # every comparison is written so that not-a-number never passes
    conditions = []
    if wanted.value is not None:
        tolerance = RELATIVE * abs(wanted.value) if wanted.tolerance is None else wanted.tolerance
        conditions.append(abs(found - wanted.value) <= tolerance)
    if wanted.below is not None:
        conditions.append(found < wanted.below)
    if wanted.above is not None:
        conditions.append(found > wanted.above)
    return bool(conditions) and all(conditions)


def _words(wanted: Wanted) -> str:
    words = []
    if wanted.value is not None:
        value = wanted.value if isinstance(wanted.value, str) else f"{wanted.value:g}"
        words.append(f"= {value}" + ("" if wanted.tolerance is None else f" ± {wanted.tolerance:g}"))
    if wanted.below is not None:
        words.append(f"< {wanted.below:g}")
    if wanted.above is not None:
        words.append(f"> {wanted.above:g}")
    return " and ".join(words)
