"""Closed surfaces of triangles from files, as solid shapes."""

from __future__ import annotations

import contextlib
import io
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .facets import Facets
from .geometry import BodyError, central_gradient, length, positive, vector
from .samples import Samples, grid_nodes
from .shapes import Solid

WELD = 1e-6  # corners closer than this part of the extent are one: STL repeats them in single precision
BAND = 3  # cells on either side of the surface in which sampled distances are the library's


class ClosedSurface(Solid):
    """What a closed surface of triangles encloses, from STL, OBJ, PLY or another file that meshio reads.

    φ is the exact distance: for the few points of an elastic body's surface, whose Newton iterations stop at the kinks
    of samples.

    Parameters
    ----------
    path : str or Path
    scale : float
        Multiplies the file's coordinates, to make them [m].
    translation : (3,) [m]
        Added after that.

    Raises
    ------
    BodyError
        If the file cannot be read, the surface is open or its triangles do not agree on the outside.
    """

    def __init__(self, path: str | Path, scale: float = 1.0, translation: ArrayLike = (0, 0, 0)) -> None:
        self._facets = Facets(*_closed_surface(path, scale, translation))

    def bounds(self) -> tuple[NDArray, NDArray]:
        """Corners (3,) [m] of the smallest box that encloses the surface."""
        return self._facets.bounds()

    def distance(self, x: NDArray) -> NDArray:
        return self._facets.nearest(x).phi

    def normal(self, x: NDArray) -> NDArray:
        """∇φ (n, 3) at points (n, 3) [m]."""
        return self._facets.nearest(x).normal


class SurfaceMesh:
    """The same for the many points of snow.

    Inside or outside is exact, by libigl's winding numbers. φ is libigl's distance at the nodes of a grid, linear
    between them: a stored stationary level set (7.7), since an exact distance would cost some 10 µs each time.

    Parameters
    ----------
    path : str or Path
    scale : float
        Multiplies the file's coordinates, to make them [m].
    translation : (3,) [m]
        Added after that.
    resolution : int
        Cells of the level set along the longest side.

    Raises
    ------
    BodyError
        If the file cannot be read, the surface is open or its triangles do not agree on the outside, or libigl is
        not installed.
    """

    def __init__(
        self,
        path: str | Path,
        scale: float = 1.0,
        translation: ArrayLike = (0, 0, 0),
        resolution: int = 64,
    ) -> None:
        self._points, self._faces = _closed_surface(path, scale, translation)
        self._resolution = positive(str(path), "resolution", resolution)
        self._library = _library(str(path))

    def bounds(self) -> tuple[NDArray, NDArray]:
        return self._points.min(axis=0), self._points.max(axis=0)

    def inside(self, x: NDArray) -> NDArray:
        """Whether points (n, 3) [m] are inside, by winding number, (n,) bool."""
        if not len(x):
            return np.zeros(0, dtype=bool)
        winding = self._library.fast_winding_number(self._points, self._faces, np.ascontiguousarray(x))
        return np.asarray(winding).ravel() > 0.5

    def distance(self, x: NDArray) -> NDArray:
        return self._samples.distance(x)

    def normal(self, x: NDArray) -> NDArray:
        return central_gradient(self.distance, x, 0.5 * float(self._samples.spacing))

    @cached_property
    def _samples(self) -> Samples:
        from scipy.ndimage import distance_transform_edt

        low, high = self.bounds()
        h = float((high - low).max()) / self._resolution
        shape, nodes = grid_nodes(low - BAND * h, high + BAND * h, h)
        sign = np.where(self.inside(nodes), -1.0, 1.0)
        kind = self._library.SignedDistanceType.SIGNED_DISTANCE_TYPE_UNSIGNED
        found = self._library.signed_distance(nodes, self._points, self._faces, kind, 0.0, BAND * h)
        size, closest = np.abs(np.asarray(found[0])).ravel(), np.asarray(found[2]).reshape(-1, 3)
        # farther away the closest point is taken to be that of the nearest node in the band
        far = ~(size <= BAND * h)
        nearest = distance_transform_edt(far.reshape(shape), return_distances=False, return_indices=True)
        owner = np.ravel_multi_index(tuple(nearest), shape).ravel()[far]
        size[far] = length(nodes[far] - closest[owner])
        return Samples((sign * size).reshape(shape), low - BAND * h, h)


def _closed_surface(path: str | Path, scale: float, translation: ArrayLike) -> tuple[NDArray, NDArray]:
    """Points (n, 3) [m] and triangles (m, 3), turned outwards, of a file."""
    name = str(path)
    points, faces = _welded(*_read(Path(path)))
    faces = _closed(points, faces, name)
    return points * positive(name, "scale", scale) + vector(name, "translation", translation, 3), faces


def _read(path: Path) -> tuple[NDArray, NDArray]:
    """Points (n, 3) and triangles (m, 3) of a file, quadrilaterals cut in two."""
    if not path.is_file():
        raise BodyError(f"{path}: no such file; a surface is an STL, OBJ or PLY file")
    import meshio

    try:
        # meshio prints its complaints and may end the process
        with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
            mesh = meshio.read(path)
    except (Exception, SystemExit) as error:
        reason = (str(error).strip().splitlines() or ["unknown format"])[-1]
        raise BodyError(f"{path}: cannot be read as a surface ({reason}); accepted are STL, OBJ and PLY") from None
    faces = [np.empty((0, 3), dtype=np.int64)]
    for block in mesh.cells:
        if block.type == "triangle":
            faces.append(block.data)
        elif block.type == "quad":
            faces += [block.data[:, [0, 1, 2]], block.data[:, [0, 2, 3]]]
    triangles = np.concatenate(faces).astype(np.int64)
    if not len(triangles) or mesh.points.shape[1] != 3:
        raise BodyError(f"{path}: has no triangles in space; a closed surface of triangles is needed")
    return np.array(mesh.points, dtype=float), triangles


def _welded(points: NDArray, faces: NDArray) -> tuple[NDArray, NDArray]:
    """The same surface with equal corners made one and flat triangles left out."""
    from scipy.spatial import cKDTree

    extent = float(np.ptp(points[faces].reshape(-1, 3), axis=0).max())
    pairs = cKDTree(points).query_pairs(WELD * extent, output_type="ndarray")
    first = np.arange(len(points))
    np.minimum.at(first, pairs[:, 1], pairs[:, 0])
    while (first[first] != first).any():
        first = first[first]
    used, faces = np.unique(first[faces], return_inverse=True)
    faces = faces.reshape(-1, 3)
    a, b, c = faces.T
    return points[used], faces[(a != b) & (b != c) & (c != a)].astype(np.int64)


def _closed(points: NDArray, faces: NDArray, name: str) -> NDArray:
    """The faces turned outwards, if each edge has one triangle on either side."""
    edges = faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    there = edges[:, 0] * len(points) + edges[:, 1]
    back = edges[:, 1] * len(points) + edges[:, 0]
    numbers, times = np.unique(there, return_counts=True)
    wrong = np.flatnonzero(~np.isin(back, there) | (times[np.searchsorted(numbers, there)] > 1))
    if len(wrong):
        ends = " and ".join(f"({', '.join(f'{c:g}' for c in points[i])})" for i in edges[wrong[0]])
        raise BodyError(
            f"{name}: the surface is not closed, or its triangles do not agree on the outside, at {len(wrong)} edges, "
            f"one between {ends}; repair it (MeshLab, Blender)"
        )
    volume = float(np.linalg.det(points[faces] - points.mean(axis=0)).sum()) / 6
    return np.ascontiguousarray(faces[:, ::-1] if volume < 0 else faces)


def _library(name: str) -> Any:
    try:
        import igl
    except ImportError:
        raise BodyError(f"{name}: a surface mesh needs libigl; install it by ./setup.sh surfaces") from None
    return igl
