"""The elastic body of a finished run of snow, as a level set that pictures can draw."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from extremal.obstacles.colliders import FREE
from extremal.obstacles.facets import Facets, boundary
from extremal.obstacles.geometry import central_gradient
from extremal.obstacles.samples import Samples, grid_nodes

from .frames import frame_list, read_frame

if TYPE_CHECKING:
    from numpy.typing import NDArray

NODES = 60_000  # of the grid on which distances are kept; an exact one takes some 20 µs
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
        """φ (n,) [m] at points (n, d) [m], linear between the nodes of a grid."""
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
            surface = Facets(rest + moved, boundary(rest, np.asarray(mesh.cells[0].data)))
            low, high = surface.bounds()
            h = float(np.prod(high - low) / NODES) ** (1 / self._d)
            shape, nodes = grid_nodes(low - MARGIN * h, high + MARGIN * h, h)
            phi = surface.nearest(nodes).phi.reshape(shape)
            self._kept = index, surface, Samples(phi, low - MARGIN * h, h)
        return self._kept[1:]
