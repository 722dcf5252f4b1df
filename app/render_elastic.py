"""Pictures of a run of an elastic body: what is seen of it from where, in which colours."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from . import shaded
from .frames import Shape, read_shape
from .scenery import Scenery, recorded_colliders
from .view import View, choose_view, view_from

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from extremal.obstacles.colliders import Collider

LOOKED_AT = 9  # frames by which view and colours of all are chosen
STRETCH_AT_REST = 1.25  # a scale of stretches goes at least so far
LARGEST = 1.25  # size of a body, over that at the start or the end, up to which it is seen whole
AROUND = 0.6  # of the body's size, how far obstacles are drawn around it
HIDDEN = 0.15  # part of the body behind an obstacle from which on that becomes glass


class ElasticPictures:
    """Draws any frame of a run, all of them alike.

    Parameters
    ----------
    record : mapping
        The run's `run.json`.
    frames : sequence of (float, pathlib.Path)
        Times [s] and files of all frames.
    size : (int, int)
        Width and height in pixels.
    field : str, optional
        Field of the cells that colours them; by default the smallest stretch, or J.
    direction : (float, float), optional
        Azimuth and elevation of the eye [degrees].

    Raises
    ------
    InputError
        If a frame cannot be read, has no such field, or a library is missing.
    """

    def __init__(
        self,
        record: Mapping[str, Any],
        folder: Path,
        frames: Sequence[tuple[float, Path]],
        size: tuple[int, int],
        field: str | None = None,
        direction: tuple[float, float] | None = None,
    ) -> None:
        shaded.pyvista()
        self.obstacles = record["scene"].get("collider")
        self.counted = bool(record["scene"]["output"].get("iterations"))
        self.size, self.field = size, field
        indices = sorted({round(index) for index in np.linspace(0, len(frames) - 1, LOOKED_AT)})
        times = [frames[index][0] for index in indices]
        shapes = [read_shape(frames[index][1], field) for index in indices]
        planar = shapes[0].planar
        self.bounds = _bounds(np.array([shape.corners for shape in shapes]))
        self.range = _colour_range(shapes)
        colliders: list[Collider] = []
        if self.obstacles:
            colliders = recorded_colliders(record, folder, 2 if planar else 3)
        self.view = self._choose_view(record, planar, colliders, times, direction)
        margin = AROUND * np.ptp(self.bounds, axis=0).max()
        window = np.array([self.bounds[0] - margin, self.bounds[1] + margin])
        self.scenery = Scenery(colliders, window[:, :2] if planar else window)
        self.see_through = not planar and any(
            _hides(colliders, self.view.eye, shape, time) > HIDDEN for shape, time in zip(shapes, times)
        )

    @property
    def settings(self) -> dict[str, Any]:
        """What pictures depend on besides the frame."""
        return {
            "drawn": "shaded",
            "size": self.size,
            "field": self.field,
            "range": self.range,
            "eye": self.view.eye.tolist(),
            "axes": self.view.axes.tolist(),
            "obstacles": self.obstacles,
            "window": self.scenery.window.tolist(),
        }

    def draw(self, time: float, path: Path, tell: Callable[[float], None]) -> NDArray[Any]:
        """Draw a frame; colours (height, width, 3)."""
        shape = read_shape(path, self.field, curved=True)
        surfaces = self.scenery.at(time)
        # among frames of solver iterations, their count stands for the time
        title = f"iteration {time:.0f}" if self.counted else f"t = {time:.3g} s"
        return shaded.draw(shape, self.range, surfaces, self.see_through, self.view, self.size, title)

    def _choose_view(
        self,
        record: Mapping[str, Any],
        planar: bool,
        colliders: Sequence[Collider],
        times: Sequence[float],
        direction: tuple[float, float] | None,
    ) -> View:
        aspect = self.size[0] / self.size[1]
        bounds = self.bounds + 0.04 * np.ptp(self.bounds, axis=0).max() * np.array([[-1.0], [1.0]])
        bounds[0, 2 if not planar else 1] -= 0.06 * np.ptp(bounds, axis=0).max()  # room for the colour bar
        if planar:
            return view_from(-90.0, 90.0 - 1e-6, bounds, np.eye(3)[2], aspect)
        return choose_view(bounds, colliders, times, _up(record), aspect, direction)


def _bounds(corners: NDArray[Any]) -> NDArray[Any]:
    """Corners (2, 3) [m] of what is seen of bodies with `corners` (n, 2, 3) [m].

    Where iterations of the solver, say, throw a body far out, it leaves the picture rather than being a speck in it.
    """
    sizes = np.ptp(corners, axis=1).max(axis=1)
    usual = corners[sizes <= LARGEST * max(sizes[0], sizes[-1])]
    return np.array([usual[:, 0].min(axis=0), usual[:, 1].max(axis=0)])


def _up(record: Mapping[str, Any]) -> NDArray[Any]:
    """Against gravity; along z where there is none."""
    acceleration = np.array((record["scene"].get("gravity") or {}).get("acceleration", (0.0, 0.0, -1.0)), dtype=float)
    weight = float(np.linalg.norm(acceleration))
    return -acceleration / weight if weight and len(acceleration) == 3 else np.eye(3)[2]


def _colour_range(shapes: Sequence[Shape]) -> tuple[float, float]:
    """Ends of the colours: of a stretch from 0 to beyond rest, of another field what nearly all elements have."""
    values = np.concatenate([shape.values[np.isfinite(shape.values)] for shape in shapes])
    if shapes[0].quantity in ("smallest stretch", "J"):
        # scattered elements of the start, beyond the end of the scale, are no news
        return 0.0, max(STRETCH_AT_REST, float(np.percentile(shapes[-1].values, 98)))
    low, high = (float(end) for end in np.percentile(values, (1, 99))) if len(values) else (0.0, 1.0)
    return (low, high) if high > low else (low, low + 1.0)


def _hides(colliders: Sequence[Collider], eye: NDArray[Any], shape: Shape, time: float) -> float:
    """Part of the body that is behind an obstacle."""
    points = shape.facets[:: max(1, len(shape.facets) // 300), 0]
    if not colliders:
        return 0.0
    along = np.linspace(0.05, 0.97, 60)[:, None, None]
    lines = (eye + along * (points - eye)).reshape(-1, 3)
    behind = np.zeros((60, len(points)), dtype=bool)
    for collider in colliders:
        behind |= (collider.distance(lines, time) < 0).reshape(behind.shape)
    return float(behind.any(axis=0).mean())
