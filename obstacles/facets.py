"""Distances to a closed surface of triangles in space, of segments in the plane: exact, and with the nearest place."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .geometry import directed, length

FIRST = 12  # facets looked at for each point; more where those cannot be all that may be nearest
ON = 1e-9  # of a facet: what is nearer is on it
AT_ONCE = 1 << 18  # points times facets in a pass: what it needs stays below 100 MB


class Nearest(NamedTuple):
    """The places of a surface nearest to n points.

    Attributes
    ----------
    phi : (n,) [m]
        Signed distance, negative inside.
    normal : (n, d)
        ∇φ, of unit length.
    nodes : (n, d) int
        Corners of the facet each place is on.
    weights : (n, d)
        Of those corners; they add up to 1 and give the place.
    """

    phi: NDArray
    normal: NDArray
    nodes: NDArray
    weights: NDArray


class Facets:
    """A closed surface that does not cross itself.

    Inside and outside are told by the normal of the facet, edge or corner that is nearest: those of edges are the sum
    of the normals of their facets, those of corners are weighted by angles (Bærentzen and Aanæs, 2005).

    Parameters
    ----------
    points : (m, d) [m]
        Corners.
    facets : (f, d) int
        Triangles seen counterclockwise from outside; segments with the inside to their left.
    cells : (n, d + 1) int, optional
        Simplices that fill it: `near` leaves out what is far from all of them.
    """

    def __init__(self, points: NDArray, facets: NDArray, cells: NDArray | None = None) -> None:
        self.points, self.facets = points, facets
        from scipy.spatial import cKDTree  # what has no such surface does without

        self._corners = corners = points[facets]
        d = points.shape[1]
        middle = corners.mean(axis=1)
        self._radius = length(corners - middle[:, None]).max(axis=1)
        self._largest = float(self._radius.max())
        self._tree = cKDTree(middle)
        self._normals = directed(_normals(corners), np.eye(d)[-1])
        ends = ((0, 1), (1, 2), (2, 0))[: 1 if d == 2 else 3]
        self._along = np.stack([corners[:, j] - corners[:, i] for i, j in ends], axis=1)  # (f, edges, d)
        size = np.einsum("fed,fed->fe", self._along, self._along)
        self._slope = self._along / np.where(size > 0, size, 1.0)[:, :, None]
        self._at_corners = np.zeros_like(points)
        for k, angle in enumerate(_angles(corners).T):
            np.add.at(self._at_corners, facets[:, k], angle[:, None] * self._normals)
        self._at_edges = self._edge_normals() if d == 3 else None
        self._cells: cKDTree | None = None
        if cells is not None:
            middle = points[cells].mean(axis=1)
            self._reach = float(length(points[cells] - middle[:, None]).max())
            self._cells = cKDTree(middle)

    def bounds(self) -> tuple[NDArray, NDArray]:
        """Corners (d,) [m] of the box around the surface."""
        corners = self._corners.reshape(-1, self.points.shape[1])
        return corners.min(axis=0), corners.max(axis=0)

    def near(self, x: NDArray, margin: float) -> NDArray:
        """Numbers of those of the points x (n, d) [m] that may be inside, or outside by at most `margin` [m]."""
        low, high = self.bounds()
        found = np.flatnonzero(((x >= low - margin) & (x <= high + margin)).all(axis=1))
        if self._cells is None or not len(found):
            return found
        reach = self._reach + margin
        away, _ = self._cells.query(x[found], distance_upper_bound=reach * (1 + 1e-9))
        return found[np.isfinite(away)]

    def nearest(self, x: NDArray) -> Nearest:
        """The places nearest to points x (n, d) [m]."""
        facet = np.zeros(len(x), dtype=np.int64)
        count, todo = min(FIRST, len(self.facets)), np.arange(len(x))
        while len(todo):
            unsure = []
            for part in np.array_split(todo, max(1, len(todo) * count // AT_ONCE)):
                facet[part], sure = self._among(x[part], count)
                unsure.append(part[~sure])
            todo, count = np.concatenate(unsure), min(4 * count, len(self.facets))
        return self._signed(x, facet)

    def _among(self, x: NDArray, count: int) -> tuple[NDArray, NDArray]:
        """Nearest of the `count` facets with the nearest middles, and whether no other can be nearer."""
        away, which = self._tree.query(x, k=[*range(1, count + 1)])
        point, column = np.nonzero(away - self._radius[which] <= away[:, :1])
        facet = which[point, column]
        size = np.full(away.shape, np.inf)
        size[point, column] = self._places(x[point], facet)[1]
        best, rows = size.argmin(axis=1), np.arange(len(x))
        sure = away[:, -1] >= size[rows, best] + self._largest
        return which[rows, best], sure | (count == len(self.facets))

    def _places(self, x: NDArray, facet: NDArray) -> tuple[NDArray, NDArray]:
        """Weights (n, d) of the place on facet number `facet` (n,) nearest to x (n, d), and its distance (n,) [m]."""
        d, along = x.shape[1], self._along[facet]
        arms = x[:, None, :] - self._corners[facet][:, : along.shape[1]]
        part = np.clip(np.einsum("ned,ned->ne", arms, self._slope[facet]), 0.0, 1.0)
        apart = length(arms - part[:, :, None] * along)
        edge, rows = apart.argmin(axis=1), np.arange(len(x))
        weights, best = np.zeros((len(x), d)), apart[rows, edge]
        weights[rows, edge] = 1 - part[rows, edge]
        weights[rows, (edge + 1) % d] = part[rows, edge]
        if d == 3:
            n, a, b, arm = self._normals[facet], along[:, 0], -along[:, 2], arms[:, 0]
            volume = np.einsum("nd,nd->n", np.cross(a, b), n)
            s, t = (np.einsum("nd,nd->n", np.cross(*pair), n) for pair in ((arm, b), (a, arm)))
            within = (s > 0) & (t > 0) & (s + t < volume)
            inner = np.stack([volume - s - t, s, t], axis=1)[within] / volume[within, None]
            weights[within], best[within] = inner, np.abs(np.einsum("nd,nd->n", arm, n))[within]
        return weights, best

    def _signed(self, x: NDArray, facet: NDArray) -> Nearest:
        nodes, (weights, _) = self.facets[facet], self._places(x, facet)
        place = np.einsum("nk,nkd->nd", weights, self.points[nodes])
        normal, zeros = self._normals[facet], weights == 0
        on_corner = zeros.sum(axis=1) == x.shape[1] - 1
        normal[on_corner] = self._at_corners[nodes[on_corner, weights[on_corner].argmax(axis=1)]]
        if self._at_edges is not None:
            on_edge = zeros.sum(axis=1) == 1
            normal[on_edge] = self._at_edges[facet[on_edge], zeros[on_edge].argmax(axis=1)]
        apart = x - place
        outside = np.einsum("nd,nd->n", apart, normal) >= 0
        phi = np.where(outside, 1.0, -1.0) * length(apart)
        clear = np.abs(phi) > ON * self._largest  # nearer, rounding would choose the direction
        away = np.where(clear[:, None], np.where(outside[:, None], apart, -apart), normal)
        return Nearest(phi, directed(away, np.eye(x.shape[1])[-1]), nodes, weights)

    def _edge_normals(self) -> NDArray:
        """Sum of the normals (f, 3, 3) of both facets at the edge opposite each corner."""
        ends = np.stack([self.facets[:, [1, 2]], self.facets[:, [2, 0]], self.facets[:, [0, 1]]], axis=1)
        pairs = np.sort(ends.reshape(-1, 2), axis=1)
        _, edge = np.unique(pairs, axis=0, return_inverse=True)
        edge = edge.reshape(-1)
        total = np.zeros((edge.max() + 1, 3))
        np.add.at(total, edge, np.repeat(self._normals, 3, axis=0))
        return total[edge].reshape(-1, 3, 3)


def boundary(points: NDArray, cells: NDArray) -> NDArray:
    """Facets (f, d) of simplices (n, d + 1) that belong to one of them only, turned outwards as `Facets` wants them.

    Parameters
    ----------
    points : (m, d)
        Where no simplex is turned inside out.
    cells : (n, d + 1) int
    """
    corners = points[cells]
    mirrored = np.linalg.det(corners[:, 1:] - corners[:, :1]) < 0
    cells = np.where(mirrored[:, None], cells[:, [1, 0, *range(2, cells.shape[1])]], cells)
    if cells.shape[1] == 3:
        opposite = np.array([[1, 2], [2, 0], [0, 1]])
    else:
        opposite = np.array([[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]])
    every = cells[:, opposite].reshape(-1, cells.shape[1] - 1)
    _, first, count = np.unique(np.sort(every, axis=1), axis=0, return_index=True, return_counts=True)
    return every[first[count == 1]]


def _normals(corners: NDArray) -> NDArray:
    """Outward normals (f, d) of facets with `corners` (f, d, d), not of unit length."""
    if corners.shape[1] == 2:
        along = corners[:, 1] - corners[:, 0]
        return np.stack([along[:, 1], -along[:, 0]], axis=1)
    return np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])


def _angles(corners: NDArray) -> NDArray:
    """Angles (f, d) of facets at their corners; 1 in the plane."""
    if corners.shape[1] == 2:
        return np.ones(corners.shape[:2])
    out = np.empty(corners.shape[:2])
    for k in range(3):
        a, b = (corners[:, (k + j) % 3] - corners[:, k] for j in (1, 2))
        out[:, k] = np.arctan2(length(np.cross(a, b)), np.einsum("ni,ni->n", a, b))
    return out
