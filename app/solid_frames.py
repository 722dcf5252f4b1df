"""The elastic body of a finished run of snow, as a level set that pictures can draw."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from scipy.ndimage import distance_transform_edt

from extremal.obstacles.colliders import FREE
from extremal.obstacles.facets import Facets, boundary
from extremal.obstacles.geometry import central_gradient
from extremal.obstacles.samples import Samples, grid_nodes

from .frames import frame_list, read_frame

if TYPE_CHECKING:
    from numpy.typing import NDArray

# Nodes of the grid on which distances are kept: inside of the body, where each takes some 20 µs, and in all.
INSIDE, NODES = 12_000, 1_000_000
MARGIN = 2  # cells around the body


class RecordedSolid:
    """The body at the frame nearest to a time; a Collider, but for its motion, which pictures have no need of.

    Parameters
    ----------
    folder : pathlib.Path
        With the frames of the body, in a results folder.
    dimension : int
    """

    contact = FREE
    color = np.array([0.42, 0.16, 0.10])

    def __init__(self, folder: Path, dimension: int) -> None:
        self._folder, self._d = folder, dimension
        self._frames = frame_list(folder)
        self._kept: tuple[int, Facets, Samples] | None = None

    def bounds(self, t: float) -> tuple[NDArray, NDArray]:
        """Corners (d,) [m] of the box around the body."""
        return self._at(t)[0].bounds()

    def distance(self, x: NDArray, t: float) -> NDArray:
        """φ (n,) [m] at points (n, d) [m], linear between the nodes of a grid; far away less than that."""
        return self._at(t)[1].distance(x)

    def normal(self, x: NDArray, t: float) -> NDArray:
        """∇φ (n, d), of unit length."""
        samples = self._at(t)[1]
        return central_gradient(samples.distance, x, 0.5 * float(samples.spacing))

    def velocity(self, x: NDArray, t: float) -> NDArray:
        """Zero: pictures show places only."""
        return np.zeros_like(x)

    def carry(self, x: NDArray, start: float, end: float) -> NDArray:
        """Where points are: as for `velocity`."""
        return x

    def _at(self, t: float) -> tuple[Facets, Samples]:
        index = min(range(len(self._frames)), key=lambda i: abs(self._frames[i][0] - t))
        if self._kept is None or self._kept[0] != index:
            mesh = read_frame(self._folder / self._frames[index][1])
            rest, moved = mesh.points[:, : self._d], mesh.point_data["displacement"][:, : self._d]
            cells = np.asarray(mesh.cells[0].data)
            surface = Facets(rest + moved, boundary(rest, cells), cells)
            self._kept = index, surface, self._sampled(surface, _volume(rest[cells]))
        return self._kept[1:]

    def _sampled(self, surface: Facets, volume: float) -> Samples:
        """φ on a grid: exact where the body may be, at least a cell elsewhere, and no more than it is."""
        low, high = surface.bounds()
        h = max(volume / INSIDE, float(np.prod(high - low)) / NODES) ** (1 / self._d)
        shape, nodes = grid_nodes(low - MARGIN * h, high + MARGIN * h, h)
        near = surface.near(nodes, MARGIN * h)
        phi = np.full(len(nodes), np.inf)
        phi[near] = surface.nearest(nodes[near]).phi
        known = np.isfinite(phi).reshape(shape)
        away = distance_transform_edt(~known, sampling=h).ravel()
        phi = np.where(known.ravel(), phi, np.maximum(away, h))
        return Samples(phi.reshape(shape), low - MARGIN * h, h)


def _volume(corners: NDArray) -> float:
    """Of simplices (n, d + 1, d)."""
    d = corners.shape[2]
    return float(np.abs(np.linalg.det(corners[:, 1:] - corners[:, :1])).sum()) / math.factorial(d)
