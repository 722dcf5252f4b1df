"""One quiet, repeatable use of gmsh: build a model, mesh it, take out plain arrays."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from . import libraries
from .data import MeshData, MeshError
from .quality import EDGES, cell_volumes, jacobians

LARGEST = 20_000_000  # cells; more would not fit the memory of one machine together with their matrices

# Everything that decides what the mesh looks like, so that the same parameters always give the same mesh.
OPTIONS = {
    "General.Terminal": 0,
    "General.Verbosity": 2,
    "General.NumThreads": 1,
    "Mesh.RandomSeed": 1,
    "Mesh.Algorithm": 6,  # frontal Delaunay
    "Mesh.Algorithm3D": 1,  # Delaunay
    "Mesh.Optimize": 1,
    "Mesh.MeshSizeExtendFromBoundary": 1,
    "Mesh.MeshSizeFromCurvature": 0,
    "Mesh.MeshSizeFromPoints": 1,
}


@contextmanager
def session() -> Iterator[Any]:
    """A fresh gmsh, without terminal output, configuration files or signal handlers; closed at the end."""
    # Terminal output stays off, but below a verbosity of 2 the log would not collect errors either.
    import gmsh

    gmsh.initialize(**libraries.gmsh_arguments(gmsh.initialize))
    try:
        for name, value in OPTIONS.items():
            gmsh.option.setNumber(name, value)
        gmsh.logger.start()
        gmsh.model.add("extremal")
        yield gmsh
    finally:
        gmsh.logger.stop()
        gmsh.finalize()


def limit_cells(shape: str, measure: float, cell_size: float, dimension: int) -> None:
    """Refuse a mesh too large to build; `measure` is the body's volume [m³] or area [m²].

    Equilateral cells of edge h have the volume h³/(6√2) or the area √3 h²/4.

    Raises
    ------
    MeshError
        If more than `LARGEST` cells are to be expected.
    """
    cell = cell_size**3 / (6 * np.sqrt(2)) if dimension == 3 else cell_size**2 * np.sqrt(3) / 4
    if measure > LARGEST * cell:
        smallest = cell_size * (measure / (LARGEST * cell)) ** (1 / dimension)
        raise MeshError(
            f"{shape}: cell_size {cell_size:g} would give about {measure / cell:.1e} cells; "
            f"at most {LARGEST:.0e} are accepted, cell_size >= {smallest:.2g}"
        )


def mesh_model(
    gmsh: Any,
    shape: str,
    cell_size: float,
    order: int,
    dimension: int,
    boundaries: Mapping[str, Sequence[int]],
    regions: Mapping[str, Sequence[int]] | None = None,
) -> MeshData:
    """Mesh the current gmsh model with one target edge length.

    Parameters
    ----------
    gmsh
        Module inside a `session`.
    shape : str
        Name for messages.
    cell_size : float
        Target edge length [m].
    order, dimension : int
        1 or 2; 2 or 3.
    boundaries, regions : mapping of str to sequence of int
        gmsh entities of dimension d - 1 and d under each name; by default one region "body" with all.

    Raises
    ------
    MeshError
        If gmsh fails, or its curved second-order cells are inverted.
    """
    gmsh.option.setNumber("Mesh.MeshSizeMin", cell_size)
    gmsh.option.setNumber("Mesh.MeshSizeMax", cell_size)
    run_mesher(gmsh, f"{shape} with cell_size {cell_size:g}", order, dimension)
    if regions is None:
        regions = {"body": [tag for _, tag in gmsh.model.getEntities(dimension)]}
    data = straighten(collect(gmsh, order, dimension, boundaries, regions))
    check_curved(data, f"{shape} with cell_size {cell_size:g}")
    return data


def run_mesher(gmsh: Any, name: str, order: int, dimension: int) -> None:
    """Mesh the current model.

    Raises
    ------
    MeshError
        With gmsh's own first error.
    """
    # gmsh meshes inside parallel regions: an exception thrown there, its default, would end the process.
    gmsh.option.setNumber("General.AbortOnError", 1)
    errors = []
    try:
        gmsh.model.mesh.generate(dimension)
        if order == 2:
            gmsh.model.mesh.setOrder(2)
    except Exception as error:  # gmsh raises plain Exception
        errors.append(str(error))
    errors = [message[7:] for message in gmsh.logger.get() if message.startswith("Error: ")] + errors
    if errors:
        reason = " ".join(errors[0].split())
        raise MeshError(f"{name}: gmsh could not mesh it ({reason}); try a smaller cell_size")


def folded(data: MeshData) -> NDArray[np.bool_]:
    """Which second-order cells are inverted somewhere: det(∂x/∂ξ) <= 0 at a node, shape (cells,)."""
    if data.order == 1:
        return np.zeros(len(data.cells), dtype=bool)
    d = data.dimension
    corners = np.vstack([np.zeros(d), np.eye(d)])
    middles = (corners[:, None] + corners[None])[np.triu_indices(d + 1, 1)] / 2
    at_nodes = jacobians(data.points, data.cells, 2, np.vstack([corners, middles]))
    return np.asarray(at_nodes.min(axis=1) <= 0)


def straighten(data: MeshData) -> MeshData:
    """The same mesh with the edges of folded second-order cells made straight.

    Where a curved side is coarsely meshed it may run through the cell's other sides. gmsh's own optimisation
    of such cells keeps the curve, but takes seconds to minutes.
    """
    points, edges = data.points, EDGES[data.dimension]
    for _ in range(100):  # a straight edge may fold a neighbour which was good
        bad = folded(replace(data, points=points))
        if not bad.any():
            break
        points = points.copy()
        for middle, (i, j) in enumerate(edges, start=data.dimension + 1):
            points[data.cells[bad, middle]] = points[data.cells[bad][:, [i, j]]].mean(axis=1)
    return replace(data, points=points)


def check_curved(data: MeshData, name: str) -> None:
    """Refuse folded second-order cells.

    Raises
    ------
    MeshError
        Naming the first of them.
    """
    found = np.flatnonzero(folded(data))
    if len(found):
        cell = int(found[0])
        where = ", ".join(f"{x:.6g}" for x in data.points[data.cells[cell]].mean(axis=0))
        raise MeshError(
            f"{name}: second-order element {cell} near ({where}) is folded by its curved sides; "
            "use smaller elements or first order"
        )


def collect(
    gmsh: Any,
    order: int,
    dimension: int,
    boundaries: Mapping[str, Sequence[int]],
    regions: Mapping[str, Sequence[int]],
) -> MeshData:
    """Arrays and names of the current mesh; only nodes which cells use, in the order of gmsh's node tags."""
    d = dimension
    tags, coordinates, _ = gmsh.model.mesh.getNodes()
    cells, region = _elements(gmsh, d, 4 if d == 3 else 2, 11 if d == 3 else 9, order, regions)
    facets, facet_tags = _elements(gmsh, d - 1, 2 if d == 3 else 1, 9 if d == 3 else 8, order, boundaries)
    used = np.unique(cells)
    place = np.zeros(int(tags.max(initial=0)) + 1, dtype=np.int64)
    place[tags] = np.arange(len(tags))
    number = np.zeros_like(place)
    number[used] = np.arange(len(used))
    points = coordinates.reshape(-1, 3)[place[used]][:, :d]
    return orient(
        MeshData(
            points=np.ascontiguousarray(points),
            cells=number[cells],
            order=order,
            regions=region,
            facets=number[facets[:, :d]],
            facet_tags=facet_tags,
            region_names={name: i + 1 for i, name in enumerate(regions)},
            boundary_names={name: i + 1 for i, name in enumerate(boundaries)},
        )
    )


def orient(data: MeshData) -> MeshData:
    """The same mesh with every cell positively oriented (gmsh may orient a plane surface either way)."""
    # By the corners: a curved side may turn the sign of the true volume of a cell.
    negative = cell_volumes(data.points, data.corners, 1) < 0
    if not negative.any():
        return data
    cells = data.cells.copy()
    cells[negative] = cells[negative][:, FLIP[data.dimension, data.order]]
    return replace(data, cells=cells)


# Exchanging corners 0 and 1 mirrors a simplex; its mid-edge nodes (see quality.EDGES) move with their edges.
FLIP = {
    (2, 1): [1, 0, 2],
    (3, 1): [1, 0, 2, 3],
    (2, 2): [1, 0, 2, 3, 5, 4],
    (3, 2): [1, 0, 2, 3, 4, 6, 5, 9, 8, 7],
}


def _elements(
    gmsh: Any, d: int, first: int, second: int, order: int, groups: Mapping[str, Sequence[int]]
) -> tuple[NDArray[np.int64], NDArray[np.int32]]:
    """Nodes (gmsh tags) and group number (from 1) of the elements of one gmsh type in named entities."""
    kind = first if order == 1 else second
    width = gmsh.model.mesh.getElementProperties(kind)[3]
    nodes, numbers = [np.zeros((0, width), dtype=np.int64)], [np.zeros(0, dtype=np.int32)]
    for i, entities in enumerate(groups.values()):
        for entity in entities:
            _, found = gmsh.model.mesh.getElementsByType(kind, entity)
            nodes.append(np.asarray(found, dtype=np.int64).reshape(-1, width))
            numbers.append(np.full(len(nodes[-1]), i + 1, dtype=np.int32))
    return np.concatenate(nodes), np.concatenate(numbers)
