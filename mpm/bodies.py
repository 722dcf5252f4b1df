"""Filling regions with particles."""

from __future__ import annotations

from itertools import product

import numpy as np
from numpy.typing import NDArray

from extremal.obstacles.geometry import BodyError, positive
from extremal.obstacles.height_field import HeightField
from extremal.obstacles.shapes import Box, Cylinder, Region, Sphere, Wedge
from extremal.obstacles.surfaces import SurfaceMesh
from extremal.obstacles.text import Text

from .hashing import hash_bits, hash_uniform
from .noise import noise, shell_profile

__all__ = [
    "BodyError",
    "Box",
    "Cylinder",
    "HeightField",
    "Region",
    "Sphere",
    "SurfaceMesh",
    "Text",
    "Wedge",
    "noise",
    "seed",
    "shell_profile",
]

LARGEST = 2_000_000_000  # cells of the box round a body: more take days to look through
AT_ONCE = 1 << 16  # cells per pass: what a pass needs stays below about 100 MB


def seed(region: Region, cell_size: float, per_cell: int, seed: int = 0, part: tuple[int, int] = (0, 1)) -> NDArray:
    """Stratified random points in a region: `per_cell` in each grid cell, those outside the region dropped (7.9).

    Each cell [i h, (i+1) h) is cut into k^D equal parts, k^D >= per_cell; `per_cell` parts, chosen at random when
    there are more, get one point each, anywhere in the part. Random numbers depend only on (seed, cell), so that a
    point is where it is however the work is divided. A particle's mass is then ρ h^D / per_cell.

    Parameters
    ----------
    region : Region
    cell_size : float [m]
        h; cell boundaries are multiples of it.
    per_cell : int
        Points per whole cell; 4 to 10 are usual.
    seed : int
        Another number gives other points.
    part : (int, int)
        Number of this share and count of shares: parts (0, n) ... (n-1, n), one after the other, are the whole.

    Returns
    -------
    NDArray, shape (n, D) [m]
        Ordered by cell, last axis fastest.

    Raises
    ------
    BodyError
        If the region is unbounded, or a number is not positive.
    """
    h = positive("body", "cell_size", cell_size)
    if int(per_cell) != per_cell or per_cell < 1:
        raise BodyError(f"body: per_cell must be a whole number, 1 or above, got {per_cell}")
    low, high = (np.asarray(corner, dtype=float) for corner in region.bounds())
    if not (np.isfinite(low).all() and np.isfinite(high).all()):
        raise BodyError("body: an unbounded region (half_space) cannot be filled; take a box")
    expected = float(np.prod((high - low) / h + 1))
    if not expected < LARGEST or not (np.maximum(np.abs(low), np.abs(high)) / h < 2.0**52).all():
        raise BodyError(f"body: would be cut into {expected:.1e} cells of {h:g} m; accepted are at most {LARGEST:.0e}")
    first = np.floor(low / h).astype(np.int64)
    counts = np.maximum(np.floor(high / h).astype(np.int64) + 1 - first, 0)
    total, (share, shares) = int(np.prod(counts)), part
    begin, end = total * share // shares, total * (share + 1) // shares
    found = [np.empty((0, len(low)))]
    for start in range(begin, end, AT_ONCE):
        numbers = np.arange(start, min(start + AT_ONCE, end))
        cells = first + np.stack(np.unravel_index(numbers, tuple(counts)), axis=1)
        points = _points(cells, h, int(per_cell), seed)
        found.append(points[region.inside(points)])
    return np.concatenate(found)


def _points(cells: NDArray, h: float, per_cell: int, seed: int) -> NDArray:
    """Points (len(cells) per_cell, D) in the cells (m, D)."""
    m, dim = cells.shape
    k = 1
    while k**dim < per_cell:
        k += 1
    parts = np.array(list(product(range(k), repeat=dim)), dtype=float)
    keys = hash_bits(seed % 2**63, *cells.T)[:, None]
    if len(parts) > per_cell:
        order = hash_uniform(keys, np.arange(len(parts)), 0).argsort(axis=1, kind="stable")
        corners = parts[np.sort(order[:, :per_cell], axis=1)]
    else:
        corners = np.broadcast_to(parts, (m, *parts.shape))
    jitter = np.stack([hash_uniform(keys, np.arange(per_cell), 1 + axis) for axis in range(dim)], axis=2)
    return (h * (cells[:, None, :] + (corners + jitter) / k)).reshape(-1, dim)
