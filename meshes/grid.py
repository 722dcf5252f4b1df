"""Structured boxes: a grid of rectangles or bricks, each cut in 2 triangles or 6 tetrahedra."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from .data import MeshData
from .gmsh_model import orient
from .order import second_order


def structured(
    names: Sequence[str], corner: Sequence[float], lengths: Sequence[float], cell_size: float, order: int
) -> MeshData:
    """Structured mesh of a box; edges along the axes are at most `cell_size` long.

    Parameters
    ----------
    names : sequence of 2d str
        Names of the sides x-, x+, y-, y+ (z-, z+).
    corner, lengths : sequence of d floats
        Smallest coordinates and sides [m].
    cell_size : float
        [m]
    order : int
        1 or 2.
    """
    d = len(lengths)
    counts = [max(1, math.ceil(length / cell_size - 1e-9)) for length in lengths]
    axes = [np.linspace(x, x + length, n + 1) for x, length, n in zip(corner, lengths, counts, strict=True)]
    points = np.stack([a.ravel() for a in np.meshgrid(*axes, indexing="ij")], axis=1)
    strides = np.array([math.prod(n + 1 for n in counts[axis + 1 :]) for axis in range(d)])
    indices = np.stack([a.ravel() for a in np.meshgrid(*map(np.arange, counts), indexing="ij")], axis=1)
    first = indices @ strides

    # Kuhn's triangulation: one simplex for each order in which to walk along the axes from corner to corner.
    # In the plane every other rectangle is mirrored, so that the diagonals have no common direction.
    cells = []
    mirrored = (indices.sum(axis=1) % 2 == 1) if d == 2 else np.zeros(len(first), dtype=bool)
    for walk in itertools.permutations(range(d)):
        steps = np.concatenate([[0], np.cumsum(strides[list(walk)])])
        cells.append(first[~mirrored, None] + steps)
        if d == 2:
            turned = strides[0] + np.concatenate([[0], np.cumsum([(-1, 1)[a] * strides[a] for a in walk])])
            cells.append(first[mirrored, None] + turned)
    corners = np.concatenate(cells)
    facets, tags = _sides(points, corners, axes)
    nodes, points = (corners, points) if order == 1 else second_order(points, corners)
    return orient(
        MeshData(
            points=np.ascontiguousarray(points),
            cells=np.ascontiguousarray(nodes),
            order=order,
            regions=np.ones(len(nodes), dtype=np.int32),
            facets=facets,
            facet_tags=tags,
            region_names={"body": 1},
            boundary_names={name: i + 1 for i, name in enumerate(names)},
        )
    )


def _sides(
    points: NDArray[np.float64], corners: NDArray[np.int64], axes: Sequence[NDArray[np.float64]]
) -> tuple[NDArray[np.int64], NDArray[np.int32]]:
    """Facets of the simplices which lie on a side of the box, and the number of that side from 1."""
    d = len(axes)
    facets, tags = [], []
    for opposite in range(d + 1):
        candidates = np.delete(corners, opposite, axis=1)
        for axis, side in itertools.product(range(d), (0, 1)):
            there = (points[candidates, axis] == axes[axis][-side]).all(axis=1)
            facets.append(candidates[there])
            tags.append(np.full(int(there.sum()), 2 * axis + side + 1, dtype=np.int32))
    return np.concatenate(facets), np.concatenate(tags)
