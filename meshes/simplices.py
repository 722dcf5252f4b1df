"""Meshes of one element: the smallest bodies there are."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from .data import MeshData, MeshError
from .gmsh_model import FLIP
from .parameters import among, point, positive
from .quality import EDGES, cell_volumes

# Named facets by their corners.
SIDES: dict[int, dict[str, tuple[int, ...]]] = {
    2: {"base": (0, 1), "right": (1, 2), "left": (2, 0)},
    3: {"base": (0, 1, 2), "front": (0, 1, 3), "right": (1, 2, 3), "left": (2, 0, 3)},
}
Corners = Sequence[Sequence[float]]


def triangle(size: float = 1.0, corners: Corners | None = None, order: int = 1) -> MeshData:
    """One triangle, equilateral unless its corners are given; the first two corners are its base.

    Boundaries: base (corners 1, 2), right (2, 3), left (3, 1).

    Parameters
    ----------
    size : float
        Edge length [m].
    corners : sequence of 3 positions, optional
        Instead of `size` [m].
    order : int
        1 or 2.

    Raises
    ------
    MeshError
        For parameters out of range, or corners on one line.
    """
    return _single("triangle", 2, size, corners, order)


def tetrahedron(size: float = 1.0, corners: Corners | None = None, order: int = 1) -> MeshData:
    """One tetrahedron, regular unless its corners are given; the first three corners are its base.

    Boundaries: base (corners 1, 2, 3), front (1, 2, 4), right (2, 3, 4), left (3, 1, 4).

    Parameters
    ----------
    size : float
        Edge length [m].
    corners : sequence of 4 positions, optional
        Instead of `size` [m].
    order : int
        1 or 2.

    Raises
    ------
    MeshError
        For parameters out of range, or corners in one plane.
    """
    return _single("tetrahedron", 3, size, corners, order)


def simplex(
    size: float = 1.0, corners: Corners | None = None, dimension: int = 3, order: int = 1
) -> MeshData:
    """`triangle` or `tetrahedron`, by dimension."""
    d = among("simplex", "dimension", dimension, (2, 3))
    return _single("simplex", d, size, corners, order)


def _single(shape: str, d: int, size: float, corners: Corners | None, order: int) -> MeshData:
    order = among(shape, "order", order, (1, 2))
    points = regular(d) * positive(shape, "size", size) if corners is None else _corners(shape, d, corners)
    cells = np.arange(d + 1, dtype=np.int64)[None]
    extent = float(np.ptp(points, axis=0).max())
    volume = cell_volumes(points, cells, 1)[0]
    if abs(volume) <= 1e-12 * extent**d:
        raise MeshError(f"{shape}: corners must not lie {'on one line' if d == 2 else 'in one plane'}")
    if order == 2:
        middles = [(points[i] + points[j]) / 2 for i, j in EDGES[d]]
        cells = np.arange(d + 1 + len(middles), dtype=np.int64)[None]
        points = np.vstack([points, middles])
    if volume < 0:
        cells = cells[:, FLIP[d, order]]
    return MeshData(
        points=points,
        cells=cells,
        order=order,
        regions=np.ones(1, dtype=np.int32),
        facets=np.array(list(SIDES[d].values()), dtype=np.int64),
        facet_tags=np.arange(1, d + 2, dtype=np.int32),
        region_names={"body": 1},
        boundary_names={name: i + 1 for i, name in enumerate(SIDES[d])},
    )


def regular(d: int) -> NDArray[np.float64]:
    """Corners of the regular simplex with edges of 1 m, its base on y = 0 (2D) or z = 0 (3D)."""
    height = math.sqrt(3) / 2
    if d == 2:
        return np.array([[0, 0], [1, 0], [0.5, height]])
    return np.array([[0, 0, 0], [1, 0, 0], [0.5, height, 0], [0.5, height / 3, math.sqrt(2 / 3)]])


def _corners(shape: str, d: int, corners: object) -> NDArray[np.float64]:
    if not isinstance(corners, Sequence) or isinstance(corners, str) or len(corners) != d + 1:
        raise MeshError(f"{shape}: corners must be {d + 1} positions of {d} coordinates [m], got {corners!r}")
    return np.array([point(shape, f"corner {i + 1}", corner, d) for i, corner in enumerate(corners)])
