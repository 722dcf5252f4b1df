"""Boxes and their relatives: box, bar, mattress."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from .data import MeshData, MeshError
from .gmsh_model import limit_cells, mesh_model, session
from .grid import structured as grid
from .parameters import among, cell_size_within, point, sides

Size = float | Sequence[float]
ORIGIN = (0.0, 0.0, 0.0)
NAMES = {
    2: ("left", "right", "bottom", "top"),
    3: ("left", "right", "front", "back", "bottom", "top"),
}


def box(
    size: Size = 1.0,
    cell_size: float = 0.2,
    dimension: int = 3,
    order: int = 1,
    corner: Sequence[float] = ORIGIN,
    structured: bool = False,
) -> MeshData:
    """Box (rectangle in 2D).

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
        The corner with the smallest coordinates [m].
    structured : bool
        A regular grid, cut in triangles or tetrahedra, in place of gmsh's mesh.

    Raises
    ------
    MeshError
        For parameters out of range.
    """
    return _box("box", size, cell_size, dimension, order, corner, structured)


def bar(
    size: Size | None = None,
    cell_size: float = 0.25,
    dimension: int = 3,
    order: int = 1,
    corner: Sequence[float] = ORIGIN,
    structured: bool = False,
) -> MeshData:
    """Long box along x, 4 m x 1 m x 1 m unless a size is given; parameters and boundaries as for `box`."""
    d = among("bar", "dimension", dimension, (2, 3))
    return _box("bar", (4.0, 1.0, 1.0)[:d] if size is None else size, cell_size, d, order, corner, structured)


def mattress(
    size: Size | None = None,
    cell_size: float = 0.1,
    dimension: int = 2,
    order: int = 1,
    corner: Sequence[float] = ORIGIN,
    structured: bool = True,
) -> MeshData:
    """Flat box, 2 m x 0.4 m in 2D and 2 m x 1 m x 0.2 m in 3D unless a size is given.

    A regular grid unless `structured` is false; parameters and boundaries as for `box`.
    """
    d = among("mattress", "dimension", dimension, (2, 3))
    usual = (2.0, 0.4) if d == 2 else (2.0, 1.0, 0.2)
    return _box("mattress", usual if size is None else size, cell_size, d, order, corner, structured)


def _box(
    shape: str,
    size: Size,
    cell_size: float,
    dimension: int,
    order: int,
    corner: Sequence[float],
    structured: bool,
) -> MeshData:
    d = among(shape, "dimension", dimension, (2, 3))
    order = among(shape, "order", order, (1, 2))
    if not isinstance(structured, bool):
        raise MeshError(f"{shape}: structured must be true or false, got {structured!r}")
    lengths = sides(shape, "size", size, d)
    x = point(shape, "corner", corner, d)
    h = cell_size_within(shape, cell_size, min(lengths), "smallest side")
    limit_cells(shape, math.prod(lengths), h, d)
    if structured:
        return grid(NAMES[d], x, lengths, h, order)
    with session() as gmsh:
        if d == 3:
            gmsh.model.occ.addBox(*x, *lengths)
        else:
            gmsh.model.occ.addRectangle(*x, 0, *lengths)
        gmsh.model.occ.synchronize()
        return mesh_model(gmsh, shape, h, order, d, _sides_of(gmsh, d, x, lengths))


def _sides_of(gmsh: Any, d: int, corner: Sequence[float], lengths: Sequence[float]) -> dict[str, list[int]]:
    """The entities of a box by the plane they lie in."""
    found: dict[str, list[int]] = {name: [] for name in NAMES[d]}
    for _, tag in gmsh.model.getEntities(d - 1):
        middle = gmsh.model.occ.getCenterOfMass(d - 1, tag)
        places = [(middle[axis] - corner[axis]) / lengths[axis] for axis in range(d)]
        axis = max(range(d), key=lambda a: abs(places[a] - 0.5))
        found[NAMES[d][2 * axis + (places[axis] > 0.5)]].append(tag)
    return found
