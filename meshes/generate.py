"""Generators by name."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import Any

from .boxes import bar, box, mattress
from .creature import creature
from .curved import cylinder, sphere, torus, tube
from .data import MeshData, MeshError, choose
from .simplices import simplex, tetrahedron, triangle

SHAPES: dict[str, Callable[..., MeshData]] = {
    "box": box,
    "bar": bar,
    "mattress": mattress,
    "sphere": sphere,
    "cylinder": cylinder,
    "tube": tube,
    "torus": torus,
    "creature": creature,
    "triangle": triangle,
    "tetrahedron": tetrahedron,
    "simplex": simplex,
}


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
