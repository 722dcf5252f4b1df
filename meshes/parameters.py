"""Checks of what a user gives to a generator; every message is one line that names shape and parameter."""

from __future__ import annotations

import math
from collections.abc import Sequence

from .data import MeshError


def positive(shape: str, name: str, value: object, unit: str = "m") -> float:
    """A finite positive number, or MeshError."""
    if isinstance(value, bool) or not isinstance(value, int | float) or not (0 < value < math.inf):
        raise MeshError(f"{shape}: {name} must be a positive number [{unit}], got {value!r}")
    return float(value)


def sides(shape: str, name: str, value: object, dimension: int) -> tuple[float, ...]:
    """`dimension` positive lengths; one number stands for equal sides."""
    if isinstance(value, int | float) and not isinstance(value, bool):
        value = (value,) * dimension
    if not isinstance(value, Sequence) or isinstance(value, str) or len(value) != dimension:
        raise MeshError(f"{shape}: {name} must be {dimension} positive lengths [m], got {value!r}")
    return tuple(positive(shape, name, side) for side in value)


def point(shape: str, name: str, value: object, dimension: int) -> tuple[float, ...]:
    """A position: `dimension` finite numbers; a third coordinate of 0 is dropped in 2D."""
    if isinstance(value, Sequence) and not isinstance(value, str):
        if dimension == 2 and len(value) == 3 and value[2] == 0:
            value = value[:2]
        numbers = [x for x in value if type(x) in (int, float) and math.isfinite(x)]
        if len(numbers) == len(value) == dimension:
            return tuple(float(x) for x in numbers)
    raise MeshError(f"{shape}: {name} must be {dimension} coordinates [m], got {value!r}")


def among(shape: str, name: str, value: object, accepted: Sequence[int]) -> int:
    """One of a few integers."""
    if isinstance(value, bool) or value not in accepted:
        listing = " or ".join(str(x) for x in accepted)
        raise MeshError(f"{shape}: {name} must be {listing}, got {value!r}")
    return int(value)  # type: ignore[call-overload]


def cell_size_within(shape: str, value: object, smallest: float, what: str) -> float:
    """A cell size no larger than the body's smallest measure [m], which `what` names."""
    size = positive(shape, "cell_size", value)
    if size > smallest * (1 + 1e-12):
        raise MeshError(f"{shape}: cell_size must be at most the {what}, {smallest:g} m, got {size:g}")
    return size
