"""Distances to a closed surface of triangles in space, of segments in the plane: exact, and with the nearest place."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from .geometry import directed, length

FIRST = 12  # facets looked at for each point; more where those cannot be all that may be nearest
AT_ONCE = 1 << 18  # pairs of points and facets in a pass: what it needs stays below 100 MB


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
    """

    def __init__(self, points: NDArray, facets: NDArray) -> None:
        self.points, self.facets = points, facets
        self._corners = corners = points[facets]
        middle = corners.mean(axis=1)
        self._radius = float(length(corners - middle[:, None]).max())
        self._tree = cKDTree(middle)
        self._normals = directed(_normals(corners), np.eye(points.shape[1])[-1])
        self._at_corners = np.zeros_like(points)
        for k, angle in enumerate(_angles(corners).T):
            np.add.at(self._at_corners, facets[:, k], angle[:, None] * self._normals)
        self._at_edges = self._edge_normals() if points.shape[1] == 3 else None

    def bounds(self) -> tuple[NDArray, NDArray]:
        """Corners (d,) [m] of the box around the surface."""
        return self.points.min(axis=0), self.points.max(axis=0)

    def nearest(self, x: NDArray) -> Nearest:
        """The places nearest to points x (n, d) [m]."""
        facet = np.zeros(len(x), dtype=np.int64)
        weights = np.zeros((len(x), x.shape[1]))
        count, todo = min(FIRST, len(self.facets)), np.arange(len(x))
        while len(todo):
            unsure = []
            for part in np.array_split(todo, max(1, len(todo) * count // AT_ONCE)):
                found, weights[part], sure = self._among(x[part], count)
                facet[part] = found
                unsure.append(part[~sure])
            todo, count = np.concatenate(unsure), min(4 * count, len(self.facets))
        return self._signed(x, facet, weights)

    def _among(self, x: NDArray, count: int) -> tuple[NDArray, NDArray, NDArray]:
        """Nearest of the `count` facets with the nearest middles, weights, and whether no other can be nearer."""
        away, which = self._tree.query(x, k=[*range(1, count + 1)])
        weights, size = _closest(x[:, None, :], self._corners[which])
        best, rows = size.argmin(axis=1), np.arange(len(x))
        sure = away[:, -1] >= size[rows, best] + self._radius
        return which[rows, best], weights[rows, best], sure | (count == len(self.facets))

    def _signed(self, x: NDArray, facet: NDArray, weights: NDArray) -> Nearest:
        nodes = self.facets[facet]
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
        away = np.where((phi != 0)[:, None], np.where(outside[:, None], apart, -apart), normal)
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


def boundary(cells: NDArray) -> NDArray:
    """Facets (f, d) of simplices (n, d + 1) that belong to one of them only, turned outwards as `Facets` wants them.

    The simplices have positive volume; numbers of their corners are kept.
    """
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


def _closest(x: NDArray, corners: NDArray) -> tuple[NDArray, NDArray]:
    """Weights (n, m, d) of the place nearest to x (n, 1, d) on each facet (n, m, d, d), and its distance (n, m)."""
    d = corners.shape[-1]
    best = np.full(corners.shape[:2], np.inf)
    weights = np.zeros(corners.shape[:3])
    for i, j in ((0, 1), (1, 2), (2, 0))[: 1 if d == 2 else 3]:
        along, arm = corners[:, :, j] - corners[:, :, i], x - corners[:, :, i]
        size = np.einsum("nmi,nmi->nm", along, along)
        part = np.clip(np.einsum("nmi,nmi->nm", arm, along) / np.where(size > 0, size, 1.0), 0.0, 1.0)
        apart = length(arm - part[..., None] * along)
        nearer = apart < best
        best = np.where(nearer, apart, best)
        here = np.zeros_like(weights)
        here[..., i], here[..., j] = 1 - part, part
        weights = np.where(nearer[..., None], here, weights)
    if d == 2:
        return weights, best
    a, b, arm = corners[:, :, 1] - corners[:, :, 0], corners[:, :, 2] - corners[:, :, 0], x - corners[:, :, 0]
    aa, ab, bb, ax, bx = (np.einsum("nmi,nmi->nm", *pair) for pair in ((a, a), (a, b), (b, b), (a, arm), (b, arm)))
    area = aa * bb - ab * ab
    s, t = ((p / np.where(area > 0, area, 1.0)) for p in (bb * ax - ab * bx, aa * bx - ab * ax))
    within = (area > 0) & (s > 0) & (t > 0) & (s + t < 1)
    apart = length(arm - s[..., None] * a - t[..., None] * b)
    inner = np.stack([1 - s - t, s, t], axis=-1)
    return np.where(within[..., None], inner, weights), np.where(within, apart, best)
