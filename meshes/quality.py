"""Volumes and Jacobian determinants of first- and second-order simplices, all cells at once."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

# Ends of the mid-edge nodes in gmsh's order (gmsh reference manual, "Node ordering").
EDGES = {2: ((0, 1), (1, 2), (2, 0)), 3: ((0, 1), (1, 2), (2, 0), (3, 0), (2, 3), (1, 3))}


def shape_gradients(dimension: int, order: int, points: NDArray[np.float64]) -> NDArray[np.float64]:
    """∂N_a/∂ξ_j of the Lagrange simplex at reference points, shape (points, nodes, dimension).

    With barycentric coordinates L: N = L (order 1); N = L(2L - 1) at corners, 4 L_i L_j on edges (order 2).
    """
    d = dimension
    barycentric = np.column_stack([1 - points.sum(axis=1), points])
    slope = np.vstack([-np.ones(d), np.eye(d)])
    if order == 1:
        return np.broadcast_to(slope, (len(points), d + 1, d)).copy()
    corner = (4 * barycentric - 1)[:, :, None] * slope
    edge = [
        4 * (barycentric[:, i, None] * slope[j] + barycentric[:, j, None] * slope[i]) for i, j in EDGES[d]
    ]
    return np.concatenate([corner, np.stack(edge, axis=1)], axis=1)


def jacobians(
    points: NDArray[np.float64], cells: NDArray[np.int64], order: int, at: NDArray[np.float64]
) -> NDArray[np.float64]:
    """det(∂x/∂ξ) of every cell at reference points `at`, shape (cells, points)."""
    gradients = shape_gradients(points.shape[1], order, at)
    if order == 1:
        edges = points[cells[:, 1 : points.shape[1] + 1]] - points[cells[:, :1]]
        return np.repeat(np.linalg.det(edges)[:, None], len(at), axis=1)
    determinants = np.empty((len(cells), len(at)))
    for q, gradient in enumerate(gradients):
        determinants[:, q] = np.linalg.det(np.einsum("caj,ai->cij", points[cells], gradient))
    return determinants


def cell_volumes(points: NDArray[np.float64], cells: NDArray[np.int64], order: int) -> NDArray[np.float64]:
    """Signed volume of every cell, ∫ det(∂x/∂ξ) dξ, shape (cells,) [m³ or m²]."""
    d = points.shape[1]
    if order == 1:
        at, weights = np.full((1, d), 1 / (d + 1)), np.ones(1)
    else:
        at, weights = _quadrature(d)
    return jacobians(points, cells, order, at) @ weights / math.factorial(d)


def _quadrature(d: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Points and weights (sum 1) on the reference simplex, exact for det(∂x/∂ξ) of order 2 (degree d)."""
    if d == 2:
        return np.array([[1 / 6, 1 / 6], [2 / 3, 1 / 6], [1 / 6, 2 / 3]]), np.full(3, 1 / 3)
    # Degree 3 (Keast): the centroid with a negative weight and four points on the medians.
    at = np.vstack([np.full((1, 3), 0.25), np.full((4, 3), 1 / 6)])
    at[2:, :] += np.eye(3) / 3
    return at, np.array([-0.8, 0.45, 0.45, 0.45, 0.45])


def facet_measures(points: NDArray[np.float64], facets: NDArray[np.int64]) -> NDArray[np.float64]:
    """Length (2D) or area (3D) of straight facets given by their corner nodes, shape (facets,) [m or m²]."""
    if points.shape[1] == 2:
        return np.linalg.norm(points[facets[:, 1]] - points[facets[:, 0]], axis=1)
    a, b, c = (points[facets[:, i]] for i in range(3))
    return np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2
