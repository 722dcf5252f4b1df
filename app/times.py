"""Times of events: numbers, or ISO 8601 timestamps; always as numbers in one unit."""

from __future__ import annotations

import json
from datetime import datetime
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from .csv_columns import Columns, is_number
from .errors import InputError

SECONDS = {"seconds": 1.0, "minutes": 60.0, "hours": 3600.0, "days": 86400.0, "weeks": 604800.0}
ACCEPTED = "a number, or a timestamp as 2024-05-31 or 2024-05-31T22:15"


def times_of(columns: Columns, unit: str) -> tuple[NDArray, datetime | None, float]:
    """Times (N,) of a table.

    Returns
    -------
    tuple
        Times in the unit: as they stand where they are numbers, since the first row where they are timestamps; that
        first timestamp, None of numbers; seconds in a unit.

    Raises
    ------
    InputError
        Naming the line of a time that is neither, or not like the others.
    """
    texts = columns["time"]
    columns.refuse("time", [not text for text in texts], f"must be {ACCEPTED}")
    seconds = SECONDS[unit]
    if is_number(texts[0]):
        columns.refuse("time", [not is_number(t) and _timestamp(t) is not None for t in texts], _unlike("a number"))
        return columns.numbers("time", ""), None, seconds
    try:
        stamps = list(map(datetime.fromisoformat, texts))
    except ValueError:
        columns.refuse("time", [is_number(text) for text in texts], _unlike("a timestamp"))
        columns.refuse("time", [_timestamp(text) is None for text in texts], f"must be {ACCEPTED}")
        raise
    columns.refuse("time", [is_number(text) for text in texts], _unlike("a timestamp"))
    first = stamps[0]
    zone = "with" if first.utcoffset() is not None else "without"
    differs = [(stamp.tzinfo is None) != (first.tzinfo is None) for stamp in stamps]
    columns.refuse("time", differs, f"must be {zone} a time zone, as the first is")
    return np.array([(stamp - first).total_seconds() for stamp in stamps]) / seconds, first, seconds


def bound(path: Path, key: str, value: float | str | None, first: datetime | None, seconds: float) -> float | None:
    """The beginning or end of the observation on the scale of `times_of`; None where the scene is silent."""
    if value is None:
        return None
    place = f"{path}: [events] {key} = {json.dumps(value) if isinstance(value, str) else f'{value:g}'}"
    if first is None:
        if isinstance(value, str):
            raise InputError(f"{place}: must be a number, as times in the file are")
        return value
    stamp = _timestamp(value) if isinstance(value, str) else None
    if stamp is None or (stamp.tzinfo is None) != (first.tzinfo is None):
        zone = "with" if first.tzinfo is not None else "without"
        raise InputError(f"{place}: must be a timestamp in quotes {zone} a time zone, as in the file")
    return (stamp - first).total_seconds() / seconds


def _timestamp(text: str) -> datetime | None:
    try:
        return datetime.fromisoformat(text)
    except ValueError:
        return None


def _unlike(kind: str) -> str:
    return f"must be {kind}, as the first time is"
