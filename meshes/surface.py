"""Closed surfaces of triangles, checked and filled with tetrahedra by gmsh."""

from __future__ import annotations

import math
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import breadth_first_order, connected_components
from scipy.spatial import cKDTree

from .data import MeshData, MeshError
from .gmsh_model import check_curved, collect, limit_cells, run_mesher, session
from .parameters import positive
from .rows import number_rows

# Corners closer than this part of the surface's extent are one: STL repeats them in single precision.
WELD = 1e-6
# Edges sharper than this [rad] stay edges where the surface is meshed anew.
CREASE = math.radians(40)

Faces: TypeAlias = NDArray[np.int64]
Points: TypeAlias = NDArray[np.float64]


def fill(points: Points, faces: Faces, name: str, cell_size: float | None, order: int) -> MeshData:
    """Tetrahedra inside a closed surface; parts of it inside others are cavities.

    Parameters
    ----------
    points : NDArray, shape (n, 3)
        [m]
    faces : NDArray of int64, shape (m, 3)
        Corners of the triangles.
    name : str
        What messages begin with, usually the file.
    cell_size : float or None
        Target edge length [m] for surface and inside; None keeps the surface's triangles.
    order : int
        1 or 2.

    Raises
    ------
    MeshError
        If the surface is open or not a manifold, naming an edge; if it intersects itself; if gmsh fails.
    """
    points, faces, notes = _welded(points, faces, name)
    faces, part = _oriented(points, _closed(points, faces, name))
    corners = points[faces]
    volumes = np.bincount(part, np.linalg.det(corners) / 6)
    faces = np.where((volumes < 0)[part][:, None], faces[:, ::-1], faces)
    bodies = _nested(points, faces, part, name)
    volume = sum(abs(volumes[outer]) - sum(abs(volumes[c]) for c in inner) for outer, inner in bodies.items())
    if cell_size is None:
        h = float(np.linalg.norm(corners[:, 0] - corners[:, 1], axis=1).mean())
    else:
        h = positive(name, "cell_size", cell_size)
        extent = float(np.ptp(points, axis=0).min())
        if h > extent:
            raise MeshError(f"{name}: cell_size must be at most the smallest extent, {extent:g} m, got {h:g}")
    limit_cells(name, float(volume), h, 3)

    with session() as gmsh:
        gmsh.option.setNumber("Mesh.MeshSizeMin", 0 if cell_size is None else h)
        gmsh.option.setNumber("Mesh.MeshSizeMax", 1e22 if cell_size is None else h)
        if cell_size is not None and _has_lonely_triangle(points, faces):
            points, faces = _quartered(points, faces)
            part = np.tile(part, 4)
        shells = _discrete(gmsh, points, faces, part)
        if cell_size is not None:
            shells = _reparametrised(gmsh, points, faces, part, name)
        loops = [gmsh.model.geo.addSurfaceLoop(shell) for shell in shells]
        solids = [
            gmsh.model.geo.addVolume([loops[outer], *(loops[c] for c in inner)])
            for outer, inner in bodies.items()
        ]
        gmsh.model.geo.synchronize()
        try:
            run_mesher(gmsh, name, order, 3)
        except MeshError as error:
            raise MeshError(_advice(str(error))) from None
        data = collect(gmsh, order, 3, {}, {"body": solids})
    check_curved(data, name)
    filled = float(data.volumes().sum()) if len(data.cells) else 0.0
    if abs(filled - volume) > (1e-6 if cell_size is None else 0.2) * volume:
        raise MeshError(
            f"{name}: the elements fill {filled:.4g} m3 of the surface's {volume:.4g} m3; "
            + ("the surface intersects itself" if cell_size is None else "give a smaller cell_size")
        )
    return MeshData(**{**vars(data), "notes": tuple(notes)})


def _advice(message: str) -> str:
    if "overlapping" in message or "intersect" in message.lower() or "recover" in message:
        return message.replace("; try a smaller cell_size", "; the surface intersects itself or nearly does")
    return message


def _welded(points: Points, faces: Faces, name: str) -> tuple[Points, Faces, list[str]]:
    """Corners in one place become one; triangles that lose a corner by it are removed, with a note."""
    used = np.unique(faces)
    where = points[used]
    pairs = cKDTree(where).query_pairs(WELD * float(np.ptp(where, axis=0).max()), output_type="ndarray")
    graph = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(len(used), len(used)))
    count, label = connected_components(graph, directed=False)
    first = np.zeros(count, dtype=np.int64)
    first[label[::-1]] = np.arange(len(used))[::-1]
    number = np.zeros(len(points), dtype=np.int64)
    number[used] = label
    faces = number[faces]
    ordered = np.sort(faces, axis=1)
    good = (ordered[:, 1:] != ordered[:, :-1]).all(axis=1)
    notes = []
    if not good.all():
        count = int((~good).sum())
        notes.append(f"{count} triangle{'' if count == 1 else 's'} without area removed")
    return where[first], faces[good], notes


def _closed(points: Points, faces: Faces, name: str) -> Faces:
    """Every edge has two triangles and no triangle is there twice, or MeshError."""
    if len(faces) == 0:
        raise MeshError(f"{name}: the surface has no triangles with area")
    number = number_rows(np.sort(faces, axis=1))
    order = np.argsort(number, kind="stable")
    same = np.flatnonzero(number[order][1:] == number[order][:-1])
    if len(same):
        a, b = order[same[0]], order[same[0] + 1]
        raise MeshError(f"{name}: triangles {a} and {b} are the same; remove one of them")
    edges, number = _edges(faces)
    count = np.bincount(number)
    for wrong, what in (
        (count > 2, "has {} triangles, 2 are accepted"),
        (count < 2, "has one triangle only"),
    ):
        if wrong.any():
            k = int(np.flatnonzero(number == np.flatnonzero(wrong)[0])[0])
            a, b = (", ".join(f"{x:.6g}" for x in points[node]) for node in edges[k])
            kind = "not a manifold" if count[number[k]] > 2 else "not closed"
            more = f" (and {int(wrong.sum()) - 1} more edges)" if wrong.sum() > 1 else ""
            raise MeshError(
                f"{name}: the surface is {kind}: the edge from ({a}) to ({b}), of triangle {k % len(faces)}, "
                f"{what.format(count[number[k]])}{more}; "
                "closed surfaces, and flat meshes in z = const, are accepted"
            )
    return faces


def _edges(faces: Faces) -> tuple[Faces, NDArray[np.int64]]:
    """Directed edges of all triangles, shape (3 m, 2), and a number equal for equal undirected edges."""
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    return edges, number_rows(np.sort(edges, axis=1))


def _oriented(points: Points, faces: Faces) -> tuple[Faces, NDArray[np.int64]]:
    """Triangles turned so that neighbours agree, and the number of the connected part of each."""
    m = len(faces)
    edges, number = _edges(faces)
    first, second = np.argsort(number, kind="stable").reshape(-1, 2).T
    # Neighbours agree when they run along their edge in opposite directions.
    disagree = edges[first, 0] == edges[second, 0]
    a, b = first % m, second % m
    graph = coo_array((1.0 + disagree, (a, b)), shape=(m, m)).tocsr()
    graph = graph + graph.T
    count, part = connected_components(graph, directed=False)
    turned = np.zeros(m, dtype=bool)
    if disagree.any():
        for k in range(count):
            order, parent = breadth_first_order(graph, int(np.flatnonzero(part == k)[0]), directed=False)
            weights = np.asarray(graph[order[1:], parent[order[1:]]]).ravel() > 1.5
            for child, other in zip(order[1:], weights, strict=True):
                turned[child] = turned[parent[child]] ^ other
    return np.where(turned[:, None], faces[:, ::-1], faces), part.astype(np.int64)


def _nested(points: Points, faces: Faces, part: NDArray[np.int64], name: str) -> dict[int, list[int]]:
    """Outer parts, each with the cavities directly inside it; parts that cross are a MeshError."""
    count = int(part.max()) + 1
    inside = np.zeros((count, count), dtype=bool)  # [i, j]: part i is inside part j
    for i in range(count):
        nodes = points[np.unique(faces[part == i])]
        for j in range(count):
            if i != j:
                within = _contains(points[faces[part == j]], nodes)
                if within.any() and not within.all():
                    where = ", ".join(f"{x:.6g}" for x in nodes[within][0])
                    raise MeshError(f"{name}: separate parts of the surface cross each other near ({where})")
                inside[i, j] = within[0]
    depth = inside.sum(axis=1)
    bodies: dict[int, list[int]] = {i: [] for i in range(count) if depth[i] % 2 == 0}
    for i in range(count):
        if depth[i] % 2 == 1:
            owner = next(j for j in range(count) if inside[i, j] and depth[j] == depth[i] - 1)
            bodies[owner].append(i)
    return bodies


def _contains(corners: Points, nodes: Points) -> NDArray[np.bool_]:
    """Which nodes a closed surface goes round: the solid angles of its triangles add up to 4π (or -4π).

    tan(Ω/2) = a·(b × c) / (|a||b||c| + (a·b)|c| + (b·c)|a| + (c·a)|b|), van Oosterom and Strackee (1983).
    """
    low, high = corners.min(axis=(0, 1)), corners.max(axis=(0, 1))
    found = ((nodes >= low) & (nodes <= high)).all(axis=1)
    near = np.flatnonzero(found)
    for some in np.array_split(near, max(1, len(near) * len(corners) // 1_000_000)):  # bounds the memory
        a, b, c = (corners[None, :, i] - nodes[some, None] for i in range(3))
        la, lb, lc = (np.linalg.norm(x, axis=2) for x in (a, b, c))
        above = np.einsum("nij,nij->ni", a, np.cross(b, c))
        ab, bc, ca = (np.einsum("nij,nij->ni", x, y) for x, y in ((a, b), (b, c), (c, a)))
        below = la * lb * lc + ab * lc + bc * la + ca * lb
        found[some] = np.abs(2 * np.arctan2(above, below).sum(axis=1)) > 2 * math.pi
    return np.asarray(found)


def _discrete(gmsh: Any, points: Points, faces: Faces, part: NDArray[np.int64]) -> list[list[int]]:
    """One discrete gmsh surface for each connected part, with the triangles as its mesh."""
    shells = []
    for k in range(int(part.max()) + 1):
        own = faces[part == k]
        nodes = np.unique(own)
        tag = gmsh.model.addDiscreteEntity(2)
        gmsh.model.mesh.addNodes(2, tag, nodes + 1, points[nodes].ravel())
        gmsh.model.mesh.addElementsByType(tag, 2, [], own.ravel() + 1)
        shells.append([tag])
    return shells


def _has_lonely_triangle(points: Points, faces: Faces) -> bool:
    """Whether creases go all round some triangle: gmsh never comes to an end with such a patch."""
    a, b, c = (points[faces[:, i]] for i in range(3))
    normals = np.cross(b - a, c - a)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    _, number = _edges(faces)
    first, second = np.argsort(number, kind="stable").reshape(-1, 2).T % len(faces)
    smooth = np.einsum("ij,ij->i", normals[first], normals[second]) > math.cos(CREASE)
    together = np.bincount(np.concatenate([first[smooth], second[smooth]]), minlength=len(faces))
    return bool((together == 0).any())


def _quartered(points: Points, faces: Faces) -> tuple[Points, Faces]:
    """Each triangle cut into four at the middles of its edges; the k-th quarters of all stand together."""
    edges, number = _edges(faces)
    _, one = np.unique(number, return_index=True)
    middle = len(points) + np.unique(number, return_inverse=True)[1].reshape(3, -1)
    (a, b, c), (ab, bc, ca) = faces.T, middle
    quarters = ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))
    faces = np.concatenate([np.column_stack(quarter) for quarter in quarters])
    return np.concatenate([points, points[edges[one]].mean(axis=1)]), faces


def _reparametrised(
    gmsh: Any, points: Points, faces: Faces, part: NDArray[np.int64], name: str
) -> list[list[int]]:
    """Surfaces which gmsh can mesh anew, cut along creases, for each part of the discrete one."""
    try:
        gmsh.model.mesh.classifySurfaces(CREASE, True, True, math.pi)
        gmsh.model.mesh.createGeometry()
    except Exception as error:  # gmsh raises plain Exception
        reason = " ".join(str(error).split())
        raise MeshError(
            f"{name}: gmsh cannot mesh the surface anew ({reason}); leave cell_size out"
        ) from None
    part_of = np.zeros(len(points), dtype=np.int64)
    part_of[faces] = part[:, None]
    tree = cKDTree(points)
    shells: list[list[int]] = [[] for _ in range(int(part.max()) + 1)]
    for _, tag in gmsh.model.getEntities(2):
        _, coordinates, _ = gmsh.model.mesh.getNodes(2, tag, includeBoundary=True)
        shells[part_of[tree.query(coordinates[:3])[1]]].append(tag)
    return shells
