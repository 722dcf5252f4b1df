"""Particles frame by frame: points for ParaView, their density on the grid as OpenVDB where asked for."""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from .errors import InputError
from .results import Frames, atomic, volume_name

if TYPE_CHECKING:
    from numpy.typing import NDArray

# Cells around the particles' own ones that their mass reaches.
MARGIN = 2


class ParticleFrames(Frames):
    """Frames of particles, played in order by ParaView through `fields.pvd`.

    Parameters
    ----------
    folder : pathlib.Path
        The results folder.
    times : list of float
        Times of the frames which stand there already.
    cell_size : float, optional
        h [m]; given where the density on the grid is wanted too.

    Raises
    ------
    InputError
        If that is wanted and OpenVDB is not installed.
    """

    def __init__(self, folder: Path, times: list[float], cell_size: float | None = None) -> None:
        if cell_size is not None:
            openvdb()
        self.cell_size = cell_size
        super().__init__(folder, times)

    def write(
        self, time: float, particles: Mapping[str, NDArray[Any]], mass: NDArray[Any] | None = None
    ) -> None:
        """Write the next frame.

        Parameters
        ----------
        particles : mapping
            "points", shape (n, 3) [m], and fields of shape (n,) or (n, 3).
        mass : (n,), optional
            Masses of the particles [kg], where volumes are wanted.
        """
        import meshio

        fields = {name: _compact(values) for name, values in particles.items() if name != "points"}
        points = np.ascontiguousarray(particles["points"])
        cells = [("vertex", np.arange(len(points))[:, None])]
        self.write_mesh(time, meshio.Mesh(points, cells, point_data=fields))
        if self.cell_size is not None and mass is not None:
            index = len(self.times) - 1
            write_volume(self.folder / volume_name(index), self.times[index], points, mass, self.cell_size)


def write_volume(path: Path, time: float, points: NDArray[Any], mass: NDArray[Any], h: float) -> None:
    """Write density on the grid as OpenVDB: grid "density" [kg/m3], its transform in m, the time [s] in its metadata.

    Parameters
    ----------
    points : (n, 3) [m]
    mass : (n,) [kg]
    h : float
        Edge of a cell [m].
    """
    vdb = openvdb()
    density, first = grid_density(points, mass, h)
    grid = vdb.FloatGrid()
    grid.copyFromArray(density.astype(np.float32), ijk=tuple(int(i) for i in first), tolerance=0.0)
    grid.transform = vdb.createLinearTransform(voxelSize=h)
    grid.gridClass = vdb.GridClass.FOG_VOLUME
    grid.name = "density"
    grid["time"] = float(time)
    with atomic(path) as partial:
        vdb.write(str(partial), grids=[grid])


def _compact(values: NDArray[Any]) -> NDArray[Any]:
    """Return a field in single precision: seven digits are enough to look at."""
    return np.ascontiguousarray(values, dtype=np.float32 if values.dtype.kind == "f" else values.dtype)


def grid_density(points: NDArray[Any], mass: NDArray[Any], h: float) -> tuple[NDArray[Any], NDArray[Any]]:
    """Density at the nodes of a grid, by the cubic B-splines of 7.3, as 7.8 has it.

    Parameters
    ----------
    points : (n, 3) [m]
    mass : (n,) [kg]
    h : float
        Distance of the nodes [m]; node (i, j, k) is at (i, j, k) h.

    Returns
    -------
    density : (n1, n2, n3) [kg/m3]
    first : (3,)
        Indices i, j, k of density[0, 0, 0].
    """
    if not len(points):
        return np.zeros((1, 1, 1)), np.zeros(3, dtype=np.int64)
    place = points / h
    below = np.floor(place).astype(np.int64)
    q = place - below
    weights = np.stack([(1 - q) ** 3, 3 * q**3 - 6 * q**2 + 4, -3 * q**3 + 3 * q**2 + 3 * q + 1, q**3]) / 6
    first = below.min(axis=0) - MARGIN
    shape = below.max(axis=0) + MARGIN + 2 - first
    density = np.zeros(int(np.prod(shape)))
    for steps in product(range(4), repeat=3):
        weight = np.prod([weights[step][:, k] for k, step in enumerate(steps)], axis=0)
        node = np.ravel_multi_index(tuple((below + np.array(steps) - 1 - first).T), shape)
        density += np.bincount(node, weight * mass, minlength=len(density))
    return density.reshape(shape) / h**3, first


def openvdb(asked_by: str = "[output] vdb = true") -> Any:
    """Return the OpenVDB module, which has had two names.

    Parameters
    ----------
    asked_by : str
        What needs it, for the message.

    Raises
    ------
    InputError
        Naming the package that provides it.
    """
    for name in ("openvdb", "pyopenvdb"):
        try:
            return importlib.import_module(name)
        except ImportError:
            continue
    raise InputError(f"{asked_by}: OpenVDB is not installed; apt install python3-openvdb")
