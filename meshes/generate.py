"""Generators by name."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import Any

from .boxes import NAMES, bar, box, mattress
from .creature import creature
from .curved import cylinder, sphere, torus, tube
from .data import MeshData, MeshError, choose
from .fish import fish
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
    "fish": fish,
    "triangle": triangle,
    "tetrahedron": tetrahedron,
    "simplex": simplex,
}

_SIMPLEX: dict[int, tuple[str, ...]] = {2: ("base", "left", "right"), 3: ("base", "left", "right", "front")}
BOUNDARIES: dict[str, dict[int, tuple[str, ...]]] = {
    "box": NAMES,
    "bar": NAMES,
    "mattress": NAMES,
    "sphere": dict.fromkeys((2, 3), ("bottom", "top")),
    "cylinder": {3: ("bottom", "top", "side")},
    "tube": {2: ("inner", "outer"), 3: ("bottom", "top", "inner", "outer")},
    "torus": {3: ("left", "right")},
    "creature": dict.fromkeys((2, 3), ("feet", "legs", "head", "ears", "tail", "trunk")),
    "fish": dict.fromkeys((2, 3), ("tail", "fin", "body")),
    "triangle": {3: _SIMPLEX[2]},
    "tetrahedron": {3: _SIMPLEX[3]},
    "simplex": _SIMPLEX,
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


def boundary_names(shape: str, **parameters: Any) -> tuple[str, ...]:
    """Names of a shape's boundaries, without building it; "surface", all of them together, is the last.

    Parameters
    ----------
    shape : str
        One of `SHAPES`.
    **parameters
        Those of its generator; only the dimension counts.
    """
    default = inspect.signature(SHAPES[shape]).parameters.get("dimension")
    dimension = parameters.get("dimension", default.default if default else 0)
    return (*BOUNDARIES[shape].get(dimension, BOUNDARIES[shape][3]), "surface")
