"""What `meshes` knows of its shapes without building one: their parameters, dimensions and boundary names."""

from __future__ import annotations

import inspect
from collections.abc import Iterator, Mapping
from typing import Any

from .errors import suggestion
from .scene_fields import Problem


def shape_problems(shape: str, parameters: Mapping[str, Any]) -> Iterator[Problem]:
    """Yield an unknown shape and unknown or missing parameters, naming the nearest."""
    from extremal.meshes import SHAPES

    if shape not in SHAPES:
        yield ("shape",), "unknown shape; " + suggestion(shape, SHAPES)
        return
    accepted = shape_parameters(shape)
    for key in parameters:
        if key not in accepted:
            yield (key,), f'unknown parameter of shape "{shape}"; ' + suggestion(key, accepted)
    for key, parameter in accepted.items():
        if parameter.default is parameter.empty and key not in parameters:
            yield (key,), f'is missing; shape "{shape}" needs it'
    for key in ("dimension", "order"):
        if key in accepted and key in parameters and not isinstance(parameters[key], int):
            yield (key,), "must be a whole number"


def shape_dimension(shape: str, parameters: Mapping[str, Any]) -> int | None:
    """Return 2 or 3 where the shape has a `dimension`, None where only the mesh will tell."""
    from extremal.meshes import SHAPES

    if "dimension" in parameters:
        value = parameters["dimension"]
        return value if value in (2, 3) else None
    if shape not in SHAPES or "dimension" not in shape_parameters(shape):
        return None
    default = shape_parameters(shape)["dimension"].default
    return default if default in (2, 3) else None


def shape_boundaries(shape: str, parameters: Mapping[str, Any]) -> tuple[str, ...] | None:
    """Return the names of the shape's boundaries, None where only the mesh will tell."""
    from extremal.meshes import SHAPES, boundary_names

    return boundary_names(shape, **parameters) if shape in SHAPES else None


def shapes() -> list[str]:
    """Return the names of the shapes."""
    from extremal.meshes import SHAPES

    return list(SHAPES)


def shape_parameters(shape: str) -> Mapping[str, inspect.Parameter]:
    """Return the parameters of a shape's generator."""
    from extremal.meshes import SHAPES

    return {
        key: parameter
        for key, parameter in inspect.signature(SHAPES[shape]).parameters.items()
        if parameter.kind in (parameter.POSITIONAL_OR_KEYWORD, parameter.KEYWORD_ONLY)
    }
