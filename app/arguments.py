"""Numbers on the command line: readers for argparse that say what is accepted."""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable


def whole(low: int = 1, high: int | None = None, what: str = "number") -> Callable[[str], int]:
    """A reader of whole numbers from `low`, at most `high`."""
    accepted = f", {low} or more" if high is None else f" from {low} to {high}"

    def read(text: str) -> int:
        number = int(text) if text.isascii() and text.isdigit() and len(text) <= 18 else low - 1
        if number < low or (high is not None and number > high):
            raise argparse.ArgumentTypeError(f"{text}: must be a whole {what}{accepted}")
        return number

    return read


def positive(high: float = math.inf) -> Callable[[str], float]:
    """A reader of numbers above 0, at most `high`."""

    def read(text: str) -> float:
        try:
            number = float(text)
        except ValueError:
            number = math.nan
        if not 0 < number <= high or math.isinf(number):
            limit = "" if math.isinf(high) else f" and at most {high:g}"
            raise argparse.ArgumentTypeError(f"{text}: must be a number above 0{limit}")
        return number

    return read
