"""Generators by name."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import Any

from .boxes import box
from .data import MeshData, MeshError, choose

SHAPES: dict[str, Callable[..., MeshData]] = {"box": box}


def generate(shape: str, **parameters: Any) -> MeshData:
    """Mesh of a shape given by name (not collective: runs on the calling rank).

    Parameters
    ----------
    shape : str
        One of `SHAPES`.
    **parameters
        Those of the shape's generator.

    Raises
    ------
    MeshError
        For an unknown shape or parameter, naming the nearest, or for a value out of range.
    """
    if shape not in SHAPES:
        raise MeshError(f"unknown shape '{shape}': {choose(shape, SHAPES)}")
    accepted = inspect.signature(SHAPES[shape]).parameters
    for name in parameters:
        if name not in accepted:
            raise MeshError(f"{shape}: unknown parameter '{name}': {choose(name, accepted)}")
    return SHAPES[shape](**parameters)
