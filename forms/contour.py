"""Primary contours and energy surfaces in the space of stretches (6.2.1, 6.2.2).

The set v·g = 0 has several pieces. The one through rest is what section 6.2.2 is about: the basin a stretched body
follows. Others lie among strongly compressed or inverted states, which a body that starts at rest does not reach
by stretching. Where two stretches are equal and v is their difference, v·g = 0 says nothing and is left out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from .kernel import Kernel

ALIGNED = 0.5  # |cos| of the angle up to which two eigenvectors are taken for one that turned


@dataclass(frozen=True)
class Plane:
    """A law on a grid of two stretches.

    Attributes
    ----------
    first, second : (m,), (n,)
        σ1 and σ2 in 2D; σ2 and σ3 in 3D, where σ1 = `fixed`.
    energy : (m, n) [Pa]
    gradient : (m, n, 2) [Pa]
        ∂Ψ/∂σ in the plane; downhill is its opposite.
    attraction : (m, n) [Pa]
        v·g with the sign of v such that Σ vi >= 0.
    valid : (m, n) bool
        Whether the sign convention lets these stretches occur.
    segments : (k, 2, 2)
        Start and end of short pieces of v·g = 0.
    primary : (k,) bool
        Whether a segment belongs to the piece of the contour that comes nearest to rest.
    """

    first: NDArray
    second: NDArray
    energy: NDArray
    gradient: NDArray
    attraction: NDArray
    valid: NDArray
    segments: NDArray
    primary: NDArray
    fixed: float | None = None


@dataclass(frozen=True)
class Crossing:
    """Where a primary contour leaves the uninverted region.

    Attributes
    ----------
    inversion, kink : (d,) or None
        Stretches of smallest σ1 where the contour through rest passes σd = 0, and where it meets
        σ(d-1) + σd = 0.
    elsewhere : bool
        Whether pieces of v·g = 0 that are not connected to rest lie among inverted states.
    limit : float
        Largest stretch looked at.
    """

    inversion: NDArray | None
    kink: NDArray | None
    elsewhere: bool
    limit: float

    def sentence(self) -> str:
        """Return the finding in words."""
        parts = []
        if self.inversion is not None:
            d = len(self.inversion)
            parts.append(f"enters the inverted region (σ{d} < 0) at σ = {_list(self.inversion)}")
        if self.kink is not None:
            d = len(self.kink)
            parts.append(f"meets the kink σ{d - 1} + σ{d} = 0 where σ1 = {self.kink[0]:.4g}")
        if not parts:
            parts.append(f"never enters the inverted region (stretches up to {self.limit:g})")
        return "the primary contour " + " and ".join(parts)


def _list(values: NDArray) -> str:
    return "(" + ", ".join(f"{x + 0.0:.4g}" for x in np.round(values, 10)) + ")"


def is_valid(stretches: NDArray) -> NDArray:
    """Whether stretches (..., d), in any order, can occur: no two of them may have a negative sum (6.2.1)."""
    d = stretches.shape[-1]
    i, j = np.triu_indices(d, 1)
    return (stretches[..., i] + stretches[..., j]).min(axis=-1) >= 0


def evaluate(
    kernel: Kernel, parameters: Sequence[float], stretches: NDArray, mirror: bool = True
) -> tuple[NDArray, NDArray, NDArray]:
    """Ψ, ∂Ψ/∂σ and ∂²Ψ/∂σ² at stretches in any order and of any signs.

    Stretches that the sign convention excludes have the energy of the valid ones with the same F: Ψ does not
    change when two signs or two places are exchanged.

    Parameters
    ----------
    kernel : Kernel
    parameters : sequence of float
        Law parameters, ε, k.
    stretches : (..., d)
    mirror : bool
        False: take the signs as they are, which continues the law's formula past the kink.

    Returns
    -------
    (...), (..., d), (..., d, d) [Pa]
    """
    d = stretches.shape[-1]
    σ = stretches.reshape(-1, d)
    sign = np.ones_like(σ)
    if mirror:
        order = np.argsort(-np.abs(σ), axis=1, kind="stable")
        sign[σ < 0] = -1
        last = order[:, -1]
        rows = np.arange(len(σ))
        # as many pairs of signs as there are; the one left over goes to the smallest
        sign[rows, last] *= np.prod(np.where(σ < 0, -1.0, 1.0), axis=1)
    else:
        order = np.argsort(-σ, axis=1, kind="stable")
    canonical = np.take_along_axis(σ * sign, order, axis=1)
    with np.errstate(all="ignore"):
        Ψ, g, H = kernel.response(canonical, parameters)
    back = np.argsort(order, axis=1)
    g = np.take_along_axis(g, back, axis=1) * sign
    H = np.take_along_axis(np.take_along_axis(H, back[:, :, None], axis=1), back[:, None, :], axis=2)
    H = H * sign[:, :, None] * sign[:, None, :]
    shape = stretches.shape[:-1]
    return Ψ.reshape(shape), g.reshape(*shape, d), H.reshape(*shape, d, d)


def attraction(
    kernel: Kernel, parameters: Sequence[float], stretches: NDArray, mirror: bool = True
) -> tuple[NDArray, NDArray]:
    """The direction v of the strongest change of g = ∂Ψ/∂σ, and v·g, whose zeros are the primary contour (6.2.2).

    v is the eigenvector of ∂²Ψ/∂σ² whose eigenvalue is largest in magnitude, Σ vi >= 0.

    Returns
    -------
    (..., d), (...) [Pa]
        nan where the law has no value.
    """
    _, g, H = evaluate(kernel, parameters, stretches, mirror)
    known = np.isfinite(H).all(axis=(-2, -1)) & np.isfinite(g).all(axis=-1)
    values, vectors = np.linalg.eigh(np.where(known[..., None, None], H, 0.0))
    largest = np.abs(values).argmax(axis=-1)
    v = np.take_along_axis(vectors, largest[..., None, None], axis=-1)[..., 0]
    v = np.where(v.sum(axis=-1, keepdims=True) < 0, -v, v)
    return v, np.where(known, (v * np.where(known[..., None], g, 0.0)).sum(axis=-1), np.nan)


def plane(
    kernel: Kernel,
    parameters: Sequence[float],
    first: NDArray,
    second: NDArray,
    fixed: float | None = None,
    mirror: bool = True,
) -> Plane:
    """Energy, gradient and primary contour over (σ1, σ2) in 2D, or over (σ2, σ3) for σ1 = `fixed` in 3D.

    Parameters
    ----------
    first, second : (m,), (n,)
        Increasing stretches.
    mirror : bool
        See `evaluate`.
    """
    a, b = np.meshgrid(first, second, indexing="ij")
    σ = _place(np.stack([a, b], axis=-1), fixed)
    Ψ, g, _ = evaluate(kernel, parameters, σ, mirror)
    v, f = attraction(kernel, parameters, σ, mirror)

    def at(points: NDArray) -> tuple[NDArray, NDArray]:
        return attraction(kernel, parameters, _place(points, fixed), mirror)

    segments, primary = _segments(at, np.stack([a, b], axis=-1), v, f)
    return Plane(first, second, Ψ, g[..., -2:], f, is_valid(σ), segments, primary, fixed)


def _place(points: NDArray, fixed: float | None) -> NDArray:
    if fixed is None:
        return points
    return np.concatenate([np.full((*points.shape[:-1], 1), fixed), points], axis=-1)


def _segments(at, grid: NDArray, v: NDArray, f: NDArray) -> tuple[NDArray, NDArray]:
    """Marching squares with eigenvectors instead of signs: an edge is crossed where v·g changes its sign while v,
    up to its sign, stays the same."""
    m, n = f.shape
    number = np.arange(m * n).reshape(m, n)
    corners = [(slice(0, m - 1), slice(0, n - 1)), (slice(1, m), slice(0, n - 1))]
    corners += [(slice(1, m), slice(1, n)), (slice(0, m - 1), slice(1, n))]
    pairs = list(zip(corners, corners[1:] + corners[:1], strict=True))
    crossing = np.stack([_changes_sign(v[a], f[a], v[b], f[b]) for a, b in pairs], axis=-1)
    ends = np.stack([np.sort(np.stack([number[a], number[b]], axis=-1), axis=-1) for a, b in pairs], axis=-2)
    count = crossing.sum(axis=-1)
    edges = np.concatenate([ends[count == c][crossing[count == c]].reshape(-1, 2, 2) for c in (2, 4)])
    if not len(edges):
        return np.zeros((0, 2, 2)), np.zeros(0, dtype=bool)
    unique, index = np.unique(edges.reshape(-1, 2), axis=0, return_inverse=True)
    places = grid.reshape(-1, 2)
    points, found = zeros(at, places[unique[:, 0]], places[unique[:, 1]])
    direction, _ = at(points)
    found &= ~_by_symmetry(points, direction[:, -2:])
    index = index.reshape(-1, 2)
    index = index[found[index].all(axis=1)]
    label = _pieces(index, len(unique))
    distance = np.where(found, np.abs(points - 1).sum(axis=1), np.inf)
    return points[index], label[index[:, 0]] == label[distance.argmin()]


def _by_symmetry(points: NDArray, v: NDArray) -> NDArray:
    """Where σa = ±σb and v has nothing but their difference (or sum), so that v·g = 0 for every law."""
    a, b = points[:, 0], points[:, 1]
    sum_, difference = np.abs(v[:, 0] + v[:, 1]), np.abs(v[:, 0] - v[:, 1])
    return ((np.abs(a - b) < 1e-9) & (sum_ < 1e-6)) | ((np.abs(a + b) < 1e-9) & (difference < 1e-6))


def _pieces(links: NDArray, count: int) -> NDArray:
    """Number of the connected piece of each of `count` things, linked two by two."""
    graph = coo_matrix((np.ones(len(links)), (links[:, 0], links[:, 1])), shape=(count, count))
    return connected_components(graph, directed=False)[1]


def _changes_sign(v: NDArray, f: NDArray, w: NDArray, h: NDArray) -> NDArray:
    cosine = (v * w).sum(axis=-1)
    with np.errstate(invalid="ignore"):
        return (np.abs(cosine) > ALIGNED) & (f * h * np.sign(cosine) < 0)


def zeros(at, start: NDArray, end: NDArray) -> tuple[NDArray, NDArray]:
    """Bisect for v·g = 0 between the points `start` and `end` (k, n), `at` giving v and v·g.

    Returns
    -------
    (k, n) and (k,) bool
        The points, and whether v·g vanishes there instead of jumping.
    """
    v0, f0 = at(start)
    size = np.maximum(np.abs(f0), np.abs(at(end)[1]))
    for _ in range(52):
        middle = 0.5 * (start + end)
        v, f = at(middle)
        f = f * np.sign((v * v0).sum(axis=-1))
        same = (f * f0 > 0)[:, None]
        start, end = np.where(same, middle, start), np.where(same, end, middle)
    points = 0.5 * (start + end)
    return points, np.abs(at(points)[1]) <= 1e-9 * size


def crosses_into_inversion(
    kernel: Kernel, parameters: Sequence[float], limit: float = 10.0, steps: int = 200
) -> Crossing:
    """Find where the primary contour enters the inverted region (σd < 0) or meets the kink σ(d-1) + σd = 0.

    The valid stretches are a box in σ1, σ2/σ1 and σ3/σ2: the contour is followed from rest through the boxes of a
    grid, and found exactly where it passes the levels σd = 0 and σd = -σ(d-1).

    Parameters
    ----------
    limit : float
        Largest σ1.
    steps : int
        Values of σ1 tried.
    """
    d = kernel.dimension
    # just off the planes of equal stretches, where v·g = 0 may say nothing, and on the valid side of the kink
    up, down = np.linspace(0, 1, 25)[1:], np.linspace(-1, 0, 25)
    up[-1], down[0] = 1 - 1e-7, -1 + 1e-12
    axes = [np.geomspace(0.1, limit, steps), *([up] if d == 3 else []), np.concatenate([down, up])]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    σ = np.cumprod(grid, axis=-1)
    v, f = attraction(kernel, parameters, σ)

    number = np.arange(f.size).reshape(f.shape)
    starts, ends = [], []
    for axis in range(d):
        one, other = _shifted(d, axis)
        crossed = _changes_sign(v[one], f[one], v[other], f[other])
        starts.append(number[one][crossed])
        ends.append(number[other][crossed])
    start, end = np.concatenate(starts), np.concatenate(ends)
    if not len(start):
        return Crossing(None, None, False, limit)

    def at(points: NDArray) -> tuple[NDArray, NDArray]:
        return attraction(kernel, parameters, points)

    flat = σ.reshape(-1, d)
    points, found = zeros(at, flat[start], flat[end])
    start, end, points = start[found], end[found], points[found]
    label = _pieces(_same_face(start, end, f.shape), len(start))
    primary = label == label[np.abs(points - 1).sum(axis=1).argmin()]
    level = np.stack(np.unravel_index(np.stack([start, end]), f.shape), axis=-1)[..., -1]

    def first(position: int) -> NDArray | None:
        here = points[primary & (level == position).all(axis=0)]
        return here[np.lexsort((-here[:, -2], np.round(here[:, 0], 9)))[0]] if len(here) else None

    elsewhere = bool((points[~primary, -1] < 0).any())
    return Crossing(first(len(down) - 1), first(0), elsewhere, limit)


def _shifted(d: int, axis: int) -> tuple[tuple[slice, ...], tuple[slice, ...]]:
    """The starts and the ends of a grid's edges along an axis."""
    every = [slice(None)] * d
    return (
        tuple(every[:axis] + [slice(0, -1)] + every[axis + 1 :]),
        tuple(every[:axis] + [slice(1, None)] + every[axis + 1 :]),
    )


def _same_face(start: NDArray, end: NDArray, shape: tuple[int, ...]) -> NDArray:
    """Pairs of crossed edges that bound one face of the grid, shape (k, 2)."""
    place = np.stack(np.unravel_index(start, shape), axis=-1)
    along = (np.stack(np.unravel_index(end, shape), axis=-1) - place).argmax(axis=1)
    d = len(shape)
    faces, owner = [], []
    for axis in range(d):
        others = along != axis
        for step in (0, -1):
            corner = place[others].copy()
            corner[:, axis] += step
            inside = corner[:, axis] >= 0
            # a face is named by its lowest corner and the axis it is normal to
            normal = (3 - along[others] - axis) if d == 3 else np.zeros(others.sum(), dtype=int)
            name = np.column_stack([corner, normal])[inside]
            faces.append(name)
            owner.append(np.flatnonzero(others)[inside])
    names, edges = np.concatenate(faces), np.concatenate(owner)
    _, face = np.unique(names, axis=0, return_inverse=True)
    order = np.argsort(face.ravel(), kind="stable")
    face, edges = face.ravel()[order], edges[order]
    together = face[1:] == face[:-1]
    return np.column_stack([edges[:-1][together], edges[1:][together]])
