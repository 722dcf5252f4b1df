"""Import of a user's mesh through meshio; gmsh never sees the file (it would run a script under any name)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from . import libraries
from .check import check_nodes, repair
from .data import MeshData, MeshError, choose
from .order import with_order
from .parameters import among
from .surface import fill

# Cell types of meshio which are read: dimension and order.
ACCEPTED = {"triangle": (2, 1), "triangle6": (2, 2), "tetra": (3, 1), "tetra10": (3, 2)}
LOWER = {"vertex": 0, "line": 1, "line3": 1, "triangle": 2, "triangle6": 2}
SCRIPTS = (".geo", ".geo_unrolled", ".pos", ".opt", ".py", ".jl")
COMMON = (".msh", ".vtk", ".vtu", ".xdmf", ".stl", ".obj", ".ply")
CAD = (".step", ".stp", ".iges", ".igs", ".brep", ".x_t")
# Cell data which hold tags, the most particular first.
TAGS = ("gmsh:physical", "medit:ref", "region", "cell_tags", "name_to_read", "MaterialIDs")
# gmsh and VTK (meshio's order) differ in the last two mid-edge nodes of a tetrahedron.
TETRA10 = [0, 1, 2, 3, 4, 5, 6, 7, 9, 8]


def read_mesh(path: str | Path, cell_size: float | None = None, order: int | None = None) -> MeshData:
    """Mesh from a file, checked and repaired (see `check.repair`; the notes are in the result).

    Triangles or tetrahedra of first or second order; gmsh's physical groups name regions and boundaries.
    A closed surface of triangles (STL, OBJ, PLY or any other format) is filled with tetrahedra.

    Parameters
    ----------
    path : str or Path
        In any format that meshio reads.
    cell_size : float, optional
        Target edge length for a closed surface [m], which is meshed anew; without it its triangles stay.
    order : int, optional
        1 drops the mid-edge nodes of the file, 2 adds missing ones in the middle of the edges; otherwise as
        in the file.

    Raises
    ------
    MeshError
        If the file cannot be read, or holds no usable mesh.
    """
    path = Path(path)
    name = str(path)
    if order is not None:
        among(name, "order", order, (1, 2))
    mesh = _read(path)
    points = np.asarray(mesh.points, dtype=np.float64)
    blocks = _blocks(mesh, name)
    if points.ndim != 2 or points.shape[1] not in (2, 3):
        raise MeshError(f"{name}: damaged: its nodes have no 2 or 3 coordinates each")
    if not any(ACCEPTED.get(kind, (0,))[0] == 3 for kind, _, _ in blocks) and not _is_flat(points, blocks):
        corners = np.concatenate([nodes[:, :3] for kind, nodes, _ in blocks if LOWER.get(kind) == 2])
        return repair(fill(points, corners, name, cell_size, order or 1), name)
    if cell_size is not None:
        raise MeshError(
            f"{name}: cell_size is accepted for closed surfaces only, and this file has its own elements"
        )
    names = _names(mesh)
    data = _assemble(points, blocks, names, name)
    if names and not set(names.values()) & {*data.region_names, *data.boundary_names}:
        note = "no element is in a physical group (saved with 'save all elements'?), so their names are lost"
        data = replace(data, notes=(note,))
    return with_order(repair(data, name), order)


def _read(path: Path) -> Any:
    """meshio's mesh, or a MeshError that says why not."""
    suffix = path.suffix.lower()
    if suffix in SCRIPTS:
        raise MeshError(
            f"{path}: scripts are not accepted, they can run commands; "
            "run it in gmsh and give the .msh file it saves"
        )
    if suffix in CAD:
        raise MeshError(
            f"{path}: CAD files are not accepted; mesh it in gmsh and give the .msh file it saves"
        )
    try:
        if path.is_dir():
            raise MeshError(f"{path}: this is a folder; a mesh file is accepted")
        with path.open("rb") as file:
            start = file.read(64)
    except OSError as error:
        raise MeshError(f"{path}: cannot be opened ({error.strerror})") from None
    if not start:
        raise MeshError(f"{path}: the file is empty")
    formats = libraries.meshio_formats().get(suffix)
    if formats is None:
        raise MeshError(
            f"{path}: unknown file type '{suffix}': {choose(suffix, COMMON)}, and others of meshio"
        )
    if start.startswith(b"$"):  # gmsh's own format; Fluent's has the same ending
        formats = ["gmsh"]
        version = start.split()[1:2]
        if start.startswith(b"$MeshFormat") and version not in ([b"2.2"], [b"4.1"]):
            found = b"".join(version).decode("ascii", "replace")
            raise MeshError(f"{path}: gmsh's format {found} is not accepted; save it as 2.2 or 4.1")
    reasons = []
    for file_format in formats:
        try:
            return libraries.meshio_read(path, file_format)
        except ValueError as error:
            reasons.append(str(error))
    raise MeshError(f"{path}: damaged, or not in the format {' or '.join(formats)} ({'; '.join(reasons)})")


Block: TypeAlias = tuple[str, NDArray[np.int64], NDArray[np.int64]]


def _blocks(mesh: Any, name: str) -> list[Block]:
    """Type, nodes and tags of each block of cells; all of them usable."""
    _check_groups(mesh, name)
    key = next((key for key in TAGS if key in mesh.cell_data), None)
    blocks: list[Block] = []
    strange: dict[str, int] = {}
    for i, block in enumerate(mesh.cells):
        nodes = np.asarray(block.data)
        kind = block.type
        if kind == "quad" and all(b.type in ("triangle", "quad", *LOWER) for b in mesh.cells):
            # The faces of a surface: two triangles each.
            kind, nodes = "triangle", np.concatenate([nodes[:, [0, 1, 2]], nodes[:, [0, 2, 3]]])
        if kind not in ACCEPTED and kind not in LOWER:
            strange[kind] = strange.get(kind, 0) + len(nodes)
            continue
        tags = np.zeros(len(nodes), dtype=np.int64)
        if key is not None and len(mesh.cell_data[key][i]) == len(nodes):
            tags = np.abs(np.asarray(mesh.cell_data[key][i]).reshape(len(nodes), -1)[:, 0]).astype(np.int64)
        nodes = nodes.astype(np.int64)
        check_nodes(np.asarray(mesh.points), nodes, name, "element" if kind in ACCEPTED else kind)
        blocks.append((kind, nodes, tags))
    if strange:
        listing = ", ".join(f"{count} {kind}" for kind, count in strange.items())
        raise MeshError(f"{name}: cells of other kinds ({listing}); {', '.join(ACCEPTED)} are accepted")
    kinds = {kind for kind, nodes, _ in blocks if len(nodes)}
    if not kinds & set(ACCEPTED):
        found = ", ".join(sorted(kinds)) or "no cells"
        raise MeshError(
            f"{name}: no triangles or tetrahedra (found: {found}); {', '.join(ACCEPTED)} are accepted"
        )
    return [block for block in blocks if len(block[1])]


def _check_groups(mesh: Any, name: str) -> None:
    """A cell is in one physical group: of several, meshio would keep the first without a word."""
    names = [key for key in mesh.cell_sets if not key.startswith("gmsh:")]
    for i in range(len(mesh.cells)):
        groups = [key for key in names if mesh.cell_sets[key][i] is not None and len(mesh.cell_sets[key][i])]
        if len(groups) > 1 and "gmsh:physical" in mesh.cell_data:
            raise MeshError(
                f"{name}: {mesh.cells[i].type} cells are in {len(groups)} physical groups, "
                f"{' and '.join(repr(g) for g in groups)}; one is accepted "
                "(unions are written as lists of names, and 'surface' is the whole boundary)"
            )


def _is_flat(points: NDArray[np.float64], blocks: list[Block]) -> bool:
    """Whether the triangles lie in one plane z = const."""
    if points.shape[1] == 2:
        return True
    used = points[np.concatenate([np.unique(nodes) for _, nodes, _ in blocks])]
    return bool(np.ptp(used[:, 2]) <= 1e-12 * np.abs(used).max())


def _names(mesh: Any) -> dict[tuple[int, int], str]:
    """Names of (dimension, tag)."""
    found = {}
    for key, value in mesh.field_data.items():
        numbers = np.asarray(value).reshape(-1)
        if len(numbers) == 2 and numbers.dtype.kind in "iuf":
            found[int(numbers[1]), int(numbers[0])] = str(key)
    return found


def _assemble(
    points: NDArray[np.float64], blocks: list[Block], names: Mapping[tuple[int, int], str], name: str
) -> MeshData:
    """The cells of the highest dimension with the tagged ones of one dimension less."""
    d = max(ACCEPTED[kind][0] for kind, _, _ in blocks if kind in ACCEPTED)
    kinds = {kind for kind, _, _ in blocks if ACCEPTED.get(kind, (0,))[0] == d}
    if len(kinds) > 1:
        raise MeshError(
            f"{name}: {' and '.join(sorted(kinds))} are mixed; elements of one order are accepted"
        )
    kind = kinds.pop()
    order = ACCEPTED[kind][1]
    cells = np.concatenate([nodes for k, nodes, _ in blocks if k == kind])
    if kind == "tetra10":
        cells = cells[:, TETRA10]
    regions = np.concatenate([tags for k, _, tags in blocks if k == kind])
    outer = [(nodes[:, :d], tags) for k, nodes, tags in blocks if LOWER.get(k) == d - 1]
    facets = np.concatenate([np.zeros((0, d), dtype=np.int64), *[nodes for nodes, _ in outer]])
    facet_tags = np.concatenate([np.zeros(0, dtype=np.int64), *[tags for _, tags in outer]])
    facets, facet_tags = facets[facet_tags > 0], facet_tags[facet_tags > 0]
    region_names = _named(regions, d, names, "region")
    return MeshData(
        points=np.ascontiguousarray(points[:, :d]),
        cells=np.ascontiguousarray(cells),
        order=order,
        regions=regions.astype(np.int32),
        facets=np.ascontiguousarray(facets),
        facet_tags=facet_tags.astype(np.int32),
        region_names=region_names,
        boundary_names=_named(facet_tags, d - 1, names, "boundary"),
    )


def _named(
    tags: NDArray[np.int64], d: int, names: Mapping[tuple[int, int], str], noun: str
) -> dict[str, int]:
    """Every tag that occurs, with the file's name for it or one made of its number; 0 is "body"."""
    return {names.get((d, int(t)), f"{noun}_{t}" if t else "body"): int(t) for t in np.unique(tags)}
