"""From first to second order and back."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from .data import MeshData
from .quality import EDGES
from .rows import number_rows


def with_order(data: MeshData, order: int | None) -> MeshData:
    """The mesh with mid-edge nodes dropped or added in the middle of straight edges."""
    if order is None or order == data.order:
        return data
    d = data.dimension
    if order == 1:
        used, corners = np.unique(data.corners, return_inverse=True)
        number = np.zeros(len(data.points), dtype=np.int64)
        number[used] = np.arange(len(used))
        cells = corners.reshape(-1, d + 1).astype(np.int64)
        return replace(data, points=data.points[used], cells=cells, order=1, facets=number[data.facets])
    cells, points = second_order(data.points, data.corners)
    return replace(data, points=points, cells=cells, order=2)


def second_order(
    points: NDArray[np.float64], corners: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Cells with a node in the middle of each straight edge, numbered after the corners, and all points."""
    edges = np.sort(np.concatenate([corners[:, pair] for pair in EDGES[points.shape[1]]]), axis=1)
    number = number_rows(edges)
    _, where = np.unique(number, return_index=True)
    added = len(points) + number.reshape(-1, len(corners)).T
    return np.hstack([corners, added]), np.vstack([points, points[edges[where]].mean(axis=1)])
