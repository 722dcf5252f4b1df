"""Frames of a results folder, read back: particles, and surfaces of deformed meshes."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any
from xml.etree import ElementTree

import numpy as np

from .errors import InputError
from .results import SERIES

if TYPE_CHECKING:
    import meshio
    from numpy.typing import NDArray

# corners of the facets of a tetrahedron, from outside counterclockwise; of one of second degree also the nodes on their
# edges, and the four triangles that all six make
FACES = np.array([[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]])
EDGES = np.array([[5, 9, 8], [7, 9, 6], [4, 8, 7], [6, 5, 4]])
QUARTERS = np.array([[0, 3, 5], [3, 1, 4], [5, 4, 2], [3, 4, 5]])


@dataclass(frozen=True)
class Shape:
    """What is seen of a mesh: deformed facets (f, corners, 3) [m], value and inversion of their cells."""

    facets: NDArray[Any]
    values: NDArray[Any]
    inverted: NDArray[Any]
    quantity: str
    planar: bool

    @property
    def corners(self) -> NDArray[Any]:
        """Smallest and largest coordinates, shape (2, 3)."""
        points = self.facets.reshape(-1, 3)
        return np.array([points.min(axis=0), points.max(axis=0)])


def frame_list(folder: Path) -> list[tuple[float, str]]:
    """Return times [s] and files of the frames that exist.

    Raises
    ------
    InputError
        If the list of them is damaged.
    """
    path = folder / SERIES
    if not path.exists():
        return []
    try:
        index = ElementTree.parse(path)
        return [(float(entry.get("timestep", 0)), entry.get("file", "")) for entry in index.iter("DataSet")]
    except (ElementTree.ParseError, ValueError, OSError) as error:
        raise InputError(f"{path}: cannot be read: {error}; --restart writes it anew") from None


def read_frame(path: Path) -> meshio.Mesh:
    """Read a frame.

    Raises
    ------
    InputError
        If it is missing or damaged.
    """
    from meshio import vtu

    try:
        return vtu.read(str(path))
    except Exception as error:  # of a damaged file the reader says whatever it stumbled on
        words = (str(error).splitlines() or [""])[0][:120] or type(error).__name__
        raise InputError(f"{path}: is no frame that can be read: {words}") from None


def read_points(path: Path) -> NDArray[Any]:
    """Return the particles' positions (n, 3) [m] in a frame."""
    return np.asarray(read_frame(path).points, dtype=float)


def read_nodes(path: Path) -> NDArray[Any]:
    """Return the nodes (n, 3) [m] of the deformed mesh in a frame."""
    mesh = read_frame(path)
    return np.asarray(mesh.points + mesh.point_data.get("displacement", np.zeros_like(mesh.points)), dtype=float)


def read_shape(path: Path, quantity: str | None = None, curved: bool = False) -> Shape:
    """Return the surface of the deformed mesh in a frame.

    Parameters
    ----------
    quantity : str, optional
        Field of the cells that gives the values; by default their smallest stretch, or J where that was not written.
    curved : bool
        Facets of second degree come as four triangles each.

    Raises
    ------
    InputError
        If the frame cannot be read or has no such field.
    """
    mesh = read_frame(path)
    block = mesh.cells[0]
    data = {name: np.asarray(values[0]) for name, values in mesh.cell_data.items()}
    deformed = mesh.points + mesh.point_data.get("displacement", np.zeros_like(mesh.points))
    cells = np.asarray(block.data)
    planar = block.type.startswith("triangle")
    if block.type.startswith("tetra"):
        nodes, owner = boundary_facets(cells, curved)
    elif planar:
        nodes, owner = _triangles(cells, curved)
    else:  # particles and the like: a point is its own facet
        nodes, owner = cells[:, :1], np.arange(len(cells))
    if quantity is not None and (quantity not in data or data[quantity].ndim > 1):
        known = ", ".join(name for name, values in data.items() if values.ndim == 1) or "none"
        raise InputError(f"{path}: has no field {quantity} with a number in each element; there are: {known}")
    if quantity is None:
        quantity = next((name for name in ("smallest_stretch", "J") if name in data), "")
    values = data[quantity][owner] if quantity else np.ones(len(owner))
    inverted = data["inverted"][owner] > 0 if "inverted" in data else np.zeros(len(owner), dtype=bool)
    if "inverted" not in data and quantity in ("smallest_stretch", "J"):
        inverted = values < 0
    return Shape(deformed[nodes], values, inverted, quantity.replace("_", " "), planar)


def boundary_facets(cells: NDArray[Any], curved: bool = False) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return the facets (f, 3) that belong to one tetrahedron only, and that tetrahedron of each (f,).

    Parameters
    ----------
    cells : (m, 4) or (m, 10)
    curved : bool
        Facets of tetrahedra with 10 nodes come as four triangles each.
    """
    facets = cells[:, FACES].reshape(-1, 3)
    _, first, count = np.unique(np.sort(facets, axis=1), axis=0, return_index=True, return_counts=True)
    outside = np.sort(first[count == 1])
    owner = outside // 4
    if not curved or cells.shape[1] < 10:
        return facets[outside], owner
    nodes = cells[:, np.hstack([FACES, EDGES])].reshape(-1, 6)[outside]
    return nodes[:, QUARTERS].reshape(-1, 3), np.repeat(owner, 4)


def _triangles(cells: NDArray[Any], curved: bool) -> tuple[NDArray[Any], NDArray[Any]]:
    if not curved or cells.shape[1] < 6:
        return cells[:, :3], np.arange(len(cells))
    return cells[:, QUARTERS].reshape(-1, 3), np.repeat(np.arange(len(cells)), 4)
