"""The obstacles of a finished run, and their surfaces as triangles."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from extremal.obstacles.colliders import Rigid
from extremal.obstacles.isosurface import isosurface
from extremal.obstacles.shapes import HalfSpace

from .colliders import colliders
from .errors import InputError
from .frames import frame_list
from .results import SCENE, SOLID
from .scene import read_toml, validate

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from extremal.obstacles.colliders import Collider

CELLS = 72  # along the longest side of what is seen of an obstacle, where a picture may take its time
LARGEST = 4.0  # size of a shape over the window's from which on only what is in the window is made
THICKNESS = 0.05  # that obstacles of the plane are given, over the width of the window


@dataclass(frozen=True)
class Surface:
    """Triangles of an obstacle, whether it is a plane that goes on beyond them, and its colour if it has one."""

    points: NDArray[Any]  # (n, 3) [m]
    triangles: NDArray[Any]  # (m, 3)
    endless: bool = False
    colour: tuple[float, float, float] | None = None


def recorded_colliders(record: Mapping[str, Any], folder: Path, dimension: int) -> list[Collider]:
    """Return the obstacles of a run by its record and the copy of its scene; none where they cannot be made again."""
    try:
        scene = validate(read_toml(folder / SCENE))
        # files are beside the scene, not beside the results
        scene._path = Path(record["scene_file"])
        found = colliders(scene, scene.collider, dimension)
    except (InputError, KeyError, TypeError):
        found = []  # a picture without obstacles is better than none
    if frame_list(folder / SOLID):
        from .solid_frames import RecordedSolid

        found.append(RecordedSolid(folder / SOLID, dimension))
    return found


@dataclass
class Scenery:
    """Surfaces of obstacles, as far as a window shows them.

    Attributes
    ----------
    window : (2, D) [m]
        Corners of a box; what lies outside of it is left out.
    cells : int
        Along the longest side of what is seen of an obstacle.
    """

    colliders: Sequence[Collider]
    window: NDArray[Any]
    cells: int = CELLS
    kept: dict[int, Surface] = field(default_factory=dict)

    def at(self, time: float) -> list[Surface]:
        """The surfaces at a time [s]; those outside of the window are left out."""
        found = [self._surface(i, collider, time) for i, collider in enumerate(self.colliders)]
        return [surface for surface in found if len(surface.triangles)]

    def _surface(self, i: int, collider: Collider, time: float) -> Surface:
        if not isinstance(collider, Rigid) or not self._is_whole(collider):
            at_rest = isinstance(collider, Rigid) and collider.motion is None
            if i in self.kept:
                return self.kept[i]
            endless = isinstance(collider, Rigid) and isinstance(collider.shape, HalfSpace)
            surface = self._sampled(lambda x: collider.distance(x, time), *self._cut(*collider.bounds(time)), endless)
            if at_rest:
                self.kept[i] = surface
            return surface
        if i not in self.kept:
            self.kept[i] = self._sampled(collider.shape.distance, *collider.shape.bounds())
        surface = self.kept[i]
        if collider.motion is None:
            return surface
        d = self.window.shape[1]
        points = surface.points.copy()
        points[:, :d] = collider.motion.at(time).to_world(points[:, :d])
        return Surface(points, surface.triangles)

    def _is_whole(self, collider: Rigid) -> bool:
        """Whether a shape is small enough to be sampled as a whole, once, in its own frame."""
        low, high = collider.shape.bounds()
        return bool(np.ptp([low, high], axis=0).max() <= LARGEST * np.ptp(self.window, axis=0).max())

    def _cut(self, low: NDArray[Any], high: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any]]:
        return np.maximum(low, self.window[0]), np.minimum(high, self.window[1])

    def _sampled(self, distance: Any, low: NDArray[Any], high: NDArray[Any], endless: bool = False) -> Surface:
        """Triangles of a level set between two corners (D,)."""
        if not (high > low).all():
            return Surface(np.zeros((0, 3)), np.zeros((0, 3), dtype=np.int64))
        h = float((high - low).max()) / self.cells
        counts = np.maximum(np.ceil((high - low) / h).astype(int), 2) + 3  # a margin: a surface should be closed
        if endless:  # a plane needs few nodes
            counts[:] = 12
        axes = [np.linspace(a - 1.5 * h, b + 1.5 * h, n + 1) for a, b, n in zip(low, high, counts)]
        nodes = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
        phi = np.asarray(distance(nodes.reshape(-1, len(low)))).reshape(nodes.shape[:-1])
        if len(low) == 2:  # a slab that lies behind the body
            thickness = THICKNESS * float(np.ptp(self.window, axis=0).max())
            layers = np.linspace(-1.0, 1.0, 4)
            axes.append((layers - 0.6) * thickness)
            phi = np.maximum(phi[:, :, None], (np.abs(layers) - 0.5) * thickness)
        start = np.array([axis[0] for axis in axes])
        spacing = np.array([axis[1] - axis[0] for axis in axes])
        return Surface(*isosurface(phi, start, spacing), endless)
