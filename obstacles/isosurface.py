"""The surface of a level set as triangles, to be looked at: marching tetrahedra."""

from __future__ import annotations

from itertools import permutations

import numpy as np
from numpy.typing import NDArray

# six tetrahedra around the diagonal of a cube, from corner 000 to 111 by one axis after the other; corners as bits xyz
_PATHS = np.array([np.cumsum([0, *(1 << axis for axis in order)]) for order in permutations(range(3))])
# for a tetrahedron with the first corner alone inside, or the first two: triangles of cut edges
_ONE = np.array([[[0, 1], [0, 2], [0, 3]]])
_TWO = np.array([[[0, 2], [0, 3], [1, 3]], [[0, 2], [1, 3], [1, 2]]])


def isosurface(phi: NDArray, low: NDArray, spacing: NDArray) -> tuple[NDArray, NDArray]:
    """Triangles between what is inside (φ <= 0) and outside; open where the surface leaves the grid.

    Parameters
    ----------
    phi : (n1, n2, n3)
        Values at the nodes.
    low : (3,) [m]
        Place of phi[0, 0, 0].
    spacing : (3,) [m]
        Distances of nodes along each axis.

    Returns
    -------
    points : (n, 3) [m]
    triangles : (m, 3)
        Counterclockwise seen from outside.
    """
    shape = np.array(phi.shape)
    corner = np.array([[(k >> axis) & 1 for axis in range(3)] for k in range(8)])
    inside = phi <= 0
    first = np.array(np.meshgrid(*(np.arange(n - 1) for n in shape), indexing="ij")).reshape(3, -1).T
    number = sum(inside[tuple((first + step).T)].astype(np.int64) for step in corner)
    first = first[(number > 0) & (number < 8)]
    nodes = np.stack([np.ravel_multi_index(tuple((first + step).T), phi.shape) for step in corner], axis=1)
    tetrahedra = nodes[:, _PATHS].reshape(-1, 4)

    flat = inside.ravel()
    # those inside first, in each tetrahedron
    tetrahedra = np.take_along_axis(tetrahedra, np.argsort(~flat[tetrahedra], axis=1, kind="stable"), axis=1)
    count = flat[tetrahedra].sum(axis=1)
    # three inside: as one inside, seen from the corner outside
    cut = [
        _edges(tetrahedra[count == 1], _ONE),
        _edges(tetrahedra[count == 2], _TWO),
        _edges(tetrahedra[count == 3][:, ::-1], _ONE),
    ]
    edges = np.sort(np.concatenate(cut).reshape(-1, 2), axis=1)
    ends, triangles = np.unique(edges, axis=0, return_inverse=True)
    triangles = triangles.reshape(-1, 3)

    a, b = (phi.ravel()[ends[:, k]] for k in (0, 1))
    part = (a / np.where(a == b, 1.0, a - b))[:, None]
    places = [np.stack(np.unravel_index(ends[:, k], phi.shape), axis=1) for k in (0, 1)]
    points = low + spacing * (places[0] + part * (places[1] - places[0]))
    return points, _outwards(points, triangles, edges.reshape(-1, 3, 2), flat, phi.shape, spacing)


def _edges(tetrahedra: NDArray, triangles: NDArray) -> NDArray:
    """Ends (m, 3, 2) of the edges that corners of triangles stand on."""
    return tetrahedra[:, triangles].reshape(-1, 3, 2)


def _outwards(
    points: NDArray, triangles: NDArray, edges: NDArray, inside: NDArray, shape: tuple[int, ...], spacing: NDArray
) -> NDArray:
    """Turn triangles round that are clockwise seen from outside."""
    a, b, c = (points[triangles[:, k]] for k in range(3))
    places = np.stack(np.unravel_index(edges, shape), axis=-1) * spacing  # (m, 3, 2, 3)
    sign = np.where(inside[edges[..., 0]], 1.0, -1.0)
    out = (sign[..., None] * (places[..., 1, :] - places[..., 0, :])).sum(axis=1)
    wrong = np.einsum("ij,ij->i", np.cross(b - a, c - a), out) < 0
    turned = triangles.copy()
    turned[wrong] = triangles[wrong][:, [0, 2, 1]]
    return turned
