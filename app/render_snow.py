"""Pictures of a run of snow, quick ones or path-traced ones, and its density as OpenVDB."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from . import path_tracing
from .frames import read_frame as read_mesh
from .frames import read_shape
from .particles_output import grid_density, openvdb, write_volume
from .results import SOLID
from .scenery import Scenery, Surface
from .snow_summary import overall_bounds, picture, read_frame, stage
from .solid_frames import RecordedSolid
from .view import View, choose_view

if TYPE_CHECKING:
    from numpy.typing import NDArray

RUBBER = (0.45, 0.16, 0.05)  # the colour of an elastic body
FAR = 4.0  # how far obstacles are drawn, over the radius of what is looked at


class SnowPictures:
    """Draws any frame of a run, all of them alike.

    Parameters
    ----------
    record : mapping
        The run's `run.json`.
    frames : sequence of (float, pathlib.Path)
        Times [s] and files of all frames.
    size : (int, int)
        Width and height in pixels.
    samples : int
        Paths of light for each pixel; 0: the quick picture, also that of snow in the plane.
    extinction : float
        Of snow at its first density [1/m].
    cell_size : float, optional
        Of the grid that density is put on [m]; by default that of the run.
    direction : (float, float), optional
        Azimuth and elevation of the eye [degrees].

    Raises
    ------
    InputError
        If a frame cannot be read or a library is missing.
    """

    def __init__(
        self,
        record: Mapping[str, Any],
        folder: Path,
        frames: Sequence[tuple[float, Path]],
        size: tuple[int, int],
        samples: int,
        extinction: float = path_tracing.EXTINCTION,
        cell_size: float | None = None,
        direction: tuple[float, float] | None = None,
    ) -> None:
        self.folder = folder
        self.seen = stage(record, folder)
        self.obstacles = record["scene"].get("collider")
        self.size, self.samples = size, samples
        if samples:
            path_tracing.mitsuba()
        h, reference = cell_and_density(record)
        self.h = cell_size or h
        self.optics = path_tracing.Optics(reference, extinction)
        self.mass = reference * self.seen.spacing**self.seen.dimension  # where frames have none
        self.bounds = overall_bounds(folder)
        self.view: View | None = None
        if self.seen.dimension == 3:
            times, aspect = [time for time, _ in frames], size[0] / size[1]
            self.view = choose_view(self.bounds, self.seen.colliders, times, self.seen.up, aspect, direction)

    @property
    def settings(self) -> dict[str, Any]:
        """What pictures depend on besides the frame."""
        return {
            "drawn": repr(self.optics) if self.samples else "quickly",
            "samples": self.samples,
            "cell_size": self.h,
            "size": self.size,
            "view": self.view and [self.view.eye.tolist(), self.view.axes.tolist()],
            "bounds": self.bounds.tolist(),
            "obstacles": self.obstacles,
        }

    def draw(self, time: float, path: Path, tell: Callable[[float], None]) -> NDArray[Any]:
        """Draw a frame; colours (height, width, 3)."""
        file = path.relative_to(self.folder)
        if not self.samples or self.view is None:
            frame = read_frame(self.folder, (time, str(file)))
            return picture(frame, self.seen, self.bounds, self.size, self.view)
        cloud = path_tracing.Cloud(*grid_density(*particles_of(path, self.mass), self.h), self.h)
        reach = FAR * self.view.reach
        # an elastic body is drawn by its own triangles
        obstacles = [each for each in self.seen.colliders if not isinstance(each, RecordedSolid)]
        scenery = Scenery(obstacles, np.array([self.view.middle - reach, self.view.middle + reach]))
        surfaces, solid = scenery.at(time), self.folder / SOLID / file
        if solid.exists():
            facets = read_shape(solid, curved=True).facets
            triangles = np.arange(3 * len(facets)).reshape(-1, 3)
            surfaces.append(Surface(facets.reshape(-1, 3), triangles, colour=RUBBER))
        return path_tracing.trace(cloud, self.optics, surfaces, self.view, self.size, self.samples, tell)


def write_volumes(
    record: Mapping[str, Any],
    frames: Mapping[int, tuple[float, Path]],
    folder: Path,
    cell_size: float | None = None,
) -> int:
    """Write the density [kg/m3] of frames as OpenVDB, on the run's grid or one with cells [m] of another size.

    Returns
    -------
    int
        How many files.

    Raises
    ------
    InputError
        If OpenVDB is not installed, or a frame cannot be read.
    """
    openvdb("--vdb")
    folder.mkdir(parents=True, exist_ok=True)
    h, reference = cell_and_density(record)
    per_cell = max(body["per_cell"] for body in record["scene"]["body"])
    for index, (time, path) in frames.items():
        points, mass = particles_of(path, reference * h**3 / per_cell)
        write_volume(folder / f"density_{index:05d}.vdb", time, points, mass, cell_size or h)
    return len(frames)


def particles_of(path: Path, usual: float) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return positions (n, 3) [m] and masses (n,) [kg] of the particles in a frame, `usual` where it has none."""
    frame = read_mesh(path)
    points = np.asarray(frame.points, dtype=float)
    mass = frame.point_data.get("mass")
    return points, np.full(len(points), usual) if mass is None else np.asarray(mass, dtype=float)


def cell_and_density(record: Mapping[str, Any]) -> tuple[float, float]:
    """Return the edge of a cell [m] and the density of snow as it was given [kg/m3]."""
    scene = record["scene"]
    return scene["grid"]["cell_size"] / scene["scale"], float(scene["material"]["density"])
