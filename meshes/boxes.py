"""Boxes and their relatives: box, bar, mattress."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from .data import MeshData
from .gmsh_model import limit_cells, mesh_model, session
from .parameters import among, cell_size_within, point, sides

Size = float | Sequence[float]


def box(
    size: Size = 1.0,
    cell_size: float = 0.2,
    dimension: int = 3,
    order: int = 1,
    corner: Sequence[float] = (0.0, 0.0, 0.0),
) -> MeshData:
    """Box (rectangle in 2D) with its lower left corner at `corner`.

    Boundaries: left, right (x), front, back (y), bottom, top (z); in 2D left, right (x), bottom, top (y).

    Parameters
    ----------
    size : float or sequence of d floats
        Side lengths [m].
    cell_size : float
        Target edge length [m].
    dimension, order : int
        2 or 3; 1 or 2.
    corner : sequence of d floats
        Position of the corner with the smallest coordinates [m].

    Raises
    ------
    MeshError
        For parameters out of range.
    """
    return _box("box", size, cell_size, dimension, order, corner)


def _box(
    shape: str, size: Size, cell_size: float, dimension: int, order: int, corner: Sequence[float]
) -> MeshData:
    d = among(shape, "dimension", dimension, (2, 3))
    order = among(shape, "order", order, (1, 2))
    lengths = sides(shape, "size", size, d)
    x = point(shape, "corner", corner, d)
    h = cell_size_within(shape, cell_size, min(lengths), "smallest side")
    limit_cells(shape, math.prod(lengths), h, d)
    with session() as gmsh:
        if d == 3:
            gmsh.model.occ.addBox(*x, *lengths)
        else:
            gmsh.model.occ.addRectangle(*x, 0, *lengths)
        gmsh.model.occ.synchronize()
        return mesh_model(gmsh, shape, h, order, d, _sides_of(gmsh, d, x, lengths))


def _sides_of(gmsh: Any, d: int, corner: Sequence[float], lengths: Sequence[float]) -> dict[str, list[int]]:
    """The entities of a box by the plane they lie in."""
    names = ["left", "right", "front", "back", "bottom", "top"]
    if d == 2:
        names = ["left", "right", "bottom", "top"]
    found: dict[str, list[int]] = {name: [] for name in names}
    for _, tag in gmsh.model.getEntities(d - 1):
        middle = gmsh.model.occ.getCenterOfMass(d - 1, tag)
        places = [(middle[axis] - corner[axis]) / lengths[axis] for axis in range(d)]
        axis = max(range(d), key=lambda a: abs(places[a] - 0.5))
        found[names[2 * axis + (places[axis] > 0.5)]].append(tag)
    return found
