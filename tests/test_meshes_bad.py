"""Every unusable mesh is refused with one line that names the file, the place and what is accepted."""

import subprocess
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import meshio
import numpy as np
import pytest

from extremal.meshes import MeshData, MeshError, check_mesh, generate, read_mesh, repair, write_mesh

CUBE = np.array([[x, y, z] for z in (0, 1) for y in (0, 1) for x in (0, 1)], dtype=float)
TETS = [[0, 1, 3, 7], [0, 3, 2, 7], [0, 2, 6, 7], [0, 6, 4, 7], [0, 4, 5, 7], [0, 5, 1, 7]]
SIDES = [
    [0, 2, 3],
    [0, 3, 1],
    [4, 5, 7],
    [4, 7, 6],
    [0, 1, 5],
    [0, 5, 4],
    [2, 6, 7],
    [2, 7, 3],
    [0, 4, 6],
    [0, 6, 2],
]
SIDES += [[1, 3, 7], [1, 7, 5]]


def mesh(
    points: Sequence | np.ndarray = CUBE,
    cells: Sequence | np.ndarray = TETS,
    facets: Sequence = (),
    tags: Sequence[int] = (),
    order: int = 1,
) -> MeshData:
    points = np.array(points, dtype=float)
    d = points.shape[1]
    return MeshData(
        points=points,
        cells=np.array(cells, dtype=np.int64),
        order=order,
        regions=np.ones(len(cells), dtype=np.int32),
        facets=np.array(facets, dtype=np.int64).reshape(-1, d),
        facet_tags=np.array(tags, dtype=np.int32),
        region_names={"body": 1},
        boundary_names={"a": 1, "b": 2},
    )


def moved(node: int, to: Sequence[float], points: np.ndarray = CUBE) -> np.ndarray:
    points = points.copy()
    points[node] = to
    return points


def test_a_good_mesh_has_no_notes():
    assert check_mesh(mesh(), "cube") == []


SQUARE = [[0, 0], [1, 0], [1, 1], [0, 1]]
FOLDED = generate("triangle", order=2)
FOLDED = replace(FOLDED, points=moved(3, [0.5, 0.8], FOLDED.points))

BAD = {
    "no elements": (
        mesh(cells=np.zeros((0, 4))),
        "the mesh has no elements",
    ),
    "node number too large": (
        mesh(cells=[[0, 1, 2, 8]]),
        "element 0 uses node 8, but nodes are numbered 0 to 7",
    ),
    "negative node number": (
        mesh(cells=[*TETS, [0, -1, 2, 3]]),
        "element 6 uses node -1, but nodes are numbered 0 to 7",
    ),
    "not a number": (
        mesh(moved(3, [1, np.nan, 0])),
        "node 3 has coordinates (1, nan, 0); finite numbers below 1e+50 are accepted",
    ),
    "infinite": (
        mesh(moved(3, [1, np.inf, 0])),
        "node 3 has coordinates (1, inf, 0); finite numbers below 1e+50 are accepted",
    ),
    "astronomical": (
        mesh(moved(3, [1, 1e60, 0])),
        "node 3 has coordinates (1, 1e+60, 0); finite numbers below 1e+50 are accepted",
    ),
    "node twice": (
        mesh(cells=[*TETS, [0, 1, 1, 7]]),
        "element 6 (nodes 0, 1, 1, 7) uses a node twice",
    ),
    "flat tetrahedron": (
        mesh(cells=[*TETS, [0, 1, 2, 3]]),
        "element 6 (nodes 0, 1, 2, 3) at (0.5, 0.5, 0) has no volume",
    ),
    "flat, small and far away": (
        mesh(np.vstack([CUBE, 100 + 1e-6 * CUBE]), [*TETS, [8, 9, 10, 11], [8, 9, 10, 11]]),
        "element 6 (nodes 8, 9, 10, 11) at (100, 100, 100) has no volume (and 1 more)",
    ),
    "flat triangle": (
        mesh([*SQUARE, [2, 0]], [[0, 1, 2], [0, 1, 4]]),
        "element 1 (nodes 0, 1, 4) at (1, 0) has no area",
    ),
    "coinciding nodes": (
        mesh(np.vstack([CUBE, CUBE[7:]]), [*TETS[:5], [0, 5, 1, 8]]),
        "nodes 7 and 8 coincide at (1, 1, 1); merge them (in gmsh: Coherence Mesh), "
        "or the body comes apart there",
    ),
    "element twice": (
        mesh(cells=[*TETS, [3, 1, 0, 7]]),
        "elements 0 and 6 have the same nodes 0, 1, 3, 7; remove one of them",
    ),
    "three elements at a facet": (
        mesh(np.vstack([CUBE, [[0.5, 0.2, 3]]]), [*TETS, [0, 3, 7, 8]]),
        "facet (nodes 0, 3, 7) at (0.666667, 0.666667, 0.333333) is shared by the elements 0, 1, 6; "
        "at most 2 can meet at a facet",
    ),
    "overlapping elements": (
        mesh([[0, 0], [1, 0], [0, 1], [0.3, 2]], [[0, 1, 2], [0, 1, 3]]),
        "elements 0 and 1 overlap: they lie on the same side of their common facet (nodes 0, 1)",
    ),
    "facet in two boundaries": (
        mesh(facets=[SIDES[0], SIDES[1], SIDES[0][::-1]], tags=[1, 1, 2]),
        "facet (nodes 0, 2, 3) is in two boundaries, 'a' and 'b'; one is accepted "
        "(unions are written as lists of names, and 'surface' is the whole boundary)",
    ),
    "folded second-order element": (
        FOLDED,
        "second-order element 0 near (0.5, 0.422008) is folded by its curved sides; "
        "use smaller elements or first order",
    ),
}


@pytest.mark.parametrize("case", BAD)
def test_unusable_meshes_are_refused(case):
    data, message = BAD[case]
    with pytest.raises(MeshError) as error:
        repair(data, "mesh")
    assert str(error.value) == f"mesh: {message}"


def test_thin_elements_are_accepted():
    assert check_mesh(mesh(CUBE * [1, 1, 1e-6]), "slab") == []


REPAIRED = {
    "negative orientation": (
        mesh(cells=[[1, 0, 3, 7], *TETS[1:5], [0, 5, 7, 1]]),
        ["2 negatively oriented elements re-oriented"],
    ),
    "unused node": (
        mesh(np.vstack([[[9, 9, 9]], CUBE]), np.array(TETS) + 1),
        ["1 node removed that no element uses"],
    ),
    "strange facet": (
        mesh(facets=[SIDES[0], [0, 1, 6]], tags=[1, 2]),
        ["1 boundary facet removed that belong to no element"],
    ),
    "facet given twice": (mesh(facets=[SIDES[0], SIDES[0]], tags=[1, 1]), []),
    "two pieces": (
        mesh(np.vstack([CUBE, CUBE + 3]), np.vstack([TETS, np.array(TETS) + 8])),
        ["the mesh has 2 separate pieces"],
    ),
}


@pytest.mark.parametrize("case", REPAIRED)
def test_what_can_be_put_right_is_put_right_and_noted(case):
    data, notes = REPAIRED[case]
    good = repair(data, "mesh")
    assert list(good.notes) == notes == check_mesh(data, "mesh")
    assert good.volumes().min() > 0
    assert good.volumes().sum() == pytest.approx(np.abs(data.volumes()).sum())
    assert good.cells.max() == len(good.points) - 1
    assert len(good.facets) == len(good.facet_tags) <= 1
    assert check_mesh(good, "mesh") == [note for note in notes if "pieces" in note]


@pytest.mark.parametrize("dimension", [2, 3])
def test_negative_second_order_elements_keep_their_curved_sides(dimension):
    data = generate("sphere", dimension=dimension, order=2, cell_size=0.5)
    d = dimension
    swap = [1, 0, 2, 3, 5, 4] if d == 2 else [1, 0, 2, 3, 4, 6, 5, 9, 8, 7]
    mirrored = replace(data, cells=data.cells[:, swap])
    assert mirrored.volumes().max() < 0
    good = repair(mirrored, "sphere")
    assert good.volumes() == pytest.approx(data.volumes())
    assert good.notes == (f"{len(data.cells)} negatively oriented elements re-oriented",)


def msh(
    path: Path, points: np.ndarray, cells: list, tags: list | None = None, names: dict | None = None
) -> Path:
    data = {} if tags is None else {"gmsh:physical": tags, "gmsh:geometrical": tags}
    saved = meshio.Mesh(points, cells, cell_data=data, field_data=names or {})
    meshio.write(path, saved, file_format="gmsh22", binary=False)
    return path


HEX = [("hexahedron", np.array([[0, 1, 3, 2, 4, 5, 7, 6]]))]


def test_other_cells_are_named(tmp_path):
    path = msh(tmp_path / "hex.msh", CUBE, HEX)
    refused(path, "cells of other kinds (1 hexahedron); triangle, triangle6, tetra, tetra10 are accepted")


def test_a_mesh_of_lines_is_refused(tmp_path):
    path = msh(tmp_path / "lines.msh", CUBE, [("line", np.array([[0, 1], [1, 2]]))])
    refused(
        path, "no triangles or tetrahedra (found: line); triangle, triangle6, tetra, tetra10 are accepted"
    )


def test_mixed_orders_are_refused(tmp_path):
    points = np.vstack([CUBE, generate("tetrahedron", order=2).points + 5])
    cells = [("tetra", np.array(TETS)), ("tetra10", np.arange(8, 18)[None])]
    meshio.write(tmp_path / "mixed.vtu", meshio.Mesh(points, cells))
    refused(tmp_path / "mixed.vtu", "tetra and tetra10 are mixed; elements of one order are accepted")


def test_lower_dimensional_meshes_in_space_are_refused(tmp_path):
    path = msh(tmp_path / "sheet.msh", CUBE, [("triangle", np.array(SIDES[:1] + SIDES[4:5]))])
    refused(
        path,
        "the surface is not closed: the edge from (0, 0, 0) to (1, 0, 0), of triangle 1, "
        "has one triangle only (and 5 more edges); "
        "closed surfaces, and flat meshes in z = const, are accepted",
    )


def test_a_plane_mesh_in_space_is_a_mesh_of_two_dimensions(tmp_path):
    path = msh(tmp_path / "plane.msh", CUBE[:4] + [0, 0, 2], [("triangle", np.array(SIDES[:2]))])
    data = read_mesh(path)
    assert data.dimension == 2
    assert data.volumes().sum() == pytest.approx(1)


def test_cell_size_is_refused_for_a_mesh_with_elements(tmp_path):
    write_mesh(mesh(), tmp_path / "cube.msh")
    with pytest.raises(MeshError) as error:
        read_mesh(tmp_path / "cube.msh", cell_size=0.1)
    assert str(error.value) == (
        f"{tmp_path}/cube.msh: cell_size is accepted for closed surfaces only, "
        "and this file has its own elements"
    )


def test_an_order_other_than_one_or_two_is_refused(tmp_path):
    with pytest.raises(MeshError) as error:
        read_mesh(tmp_path / "cube.msh", order=3)
    assert str(error.value) == f"{tmp_path}/cube.msh: order must be 1 or 2, got 3"


def refused(path: Path, message: str, **options) -> None:
    with pytest.raises(MeshError) as error:
        read_mesh(path, **options)
    assert str(error.value) == f"{path}: {message}"


SCRIPT = "scripts are not accepted, they can run commands; run it in gmsh and give the .msh file it saves"
FILES = {
    "empty.msh": (b"", "the file is empty"),
    "script.geo": (b"Point(1) = {0,0,0};", SCRIPT),
    "script.geo_unrolled": (b"Point(1) = {0,0,0};", SCRIPT),
    "part.step": (
        b"ISO-10303-21;",
        "CAD files are not accepted; mesh it in gmsh and give the .msh file it saves",
    ),
    "mesh.vtuu": (
        b"x",
        "unknown file type '.vtuu': did you mean '.vtu'? "
        "accepted: .msh, .vtk, .vtu, .xdmf, .stl, .obj, .ply, and others of meshio",
    ),
    "old.msh": (
        b"$MeshFormat\n4.0 0 8\n$EndMeshFormat\n",
        "gmsh's format 4.0 is not accepted; save it as 2.2 or 4.1",
    ),
    "noise.ply": (b"noise\nmore\n", "damaged, or not in the format ply (Expected ply)"),
    "noise.vtu": (b"noise", "damaged, or not in the format vtu (not a file of this kind)"),
    "empty.obj": (
        b"# nothing here\n",
        "no triangles or tetrahedra (found: no cells); triangle, triangle6, tetra, tetra10 are accepted",
    ),
}


@pytest.mark.parametrize("name", FILES)
def test_unusable_files_are_named(tmp_path, name):
    content, message = FILES[name]
    (tmp_path / name).write_bytes(content)
    refused(tmp_path / name, message)


def test_missing_files_and_folders_are_named(tmp_path):
    refused(tmp_path / "missing.msh", "cannot be opened (No such file or directory)")
    refused(tmp_path, "this is a folder; a mesh file is accepted")


@pytest.mark.parametrize("keep", [0.3, 0.6, 0.9])
def test_cut_off_files_are_refused(tmp_path, keep):
    write_mesh(generate("box", cell_size=0.5), tmp_path / "box.msh")
    content = (tmp_path / "box.msh").read_bytes()
    (tmp_path / "cut.msh").write_bytes(content[: int(keep * len(content))])
    with pytest.raises(MeshError, match="cut.msh: "):
        read_mesh(tmp_path / "cut.msh")


def surface(path: Path, points: np.ndarray = CUBE, faces: Sequence = SIDES) -> Path:
    meshio.write(path, meshio.Mesh(points, [("triangle", np.array(faces, dtype=np.int32))]))
    return path


def test_open_surfaces_name_an_edge(tmp_path):
    refused(
        surface(tmp_path / "open.ply", faces=SIDES[1:]),
        "the surface is not closed: the edge from (0, 1, 0) to (0, 0, 0), of triangle 8, "
        "has one triangle only (and 2 more edges); "
        "closed surfaces, and flat meshes in z = const, are accepted",
    )


def test_surfaces_that_meet_in_an_edge_name_it(tmp_path):
    points = np.vstack([CUBE, CUBE + [1, 1, 0]])
    refused(
        surface(tmp_path / "edge.ply", points, SIDES + (np.array(SIDES) + 8).tolist()),
        "the surface is not a manifold: the edge from (1, 1, 0) to (1, 1, 1), of triangle 20, "
        "has 4 triangles, 2 are accepted; "
        "closed surfaces, and flat meshes in z = const, are accepted",
    )


def test_repeated_triangles_are_named(tmp_path):
    refused(
        surface(tmp_path / "twice.ply", faces=[*SIDES, SIDES[2]]),
        "triangles 2 and 12 are the same; remove one of them",
    )


def test_surfaces_with_wrong_numbers_name_the_node(tmp_path):
    refused(
        surface(tmp_path / "nan.ply", moved(5, [1, np.nan, 0])),
        "node 5 has coordinates (1, nan, 0); finite numbers below 1e+50 are accepted",
    )


def test_surfaces_with_missing_nodes_name_the_triangle(tmp_path):
    (tmp_path / "s.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 1\nf 1 2 3\nf 1 2 4\n")
    refused(tmp_path / "s.obj", "element 1 uses node 3, but nodes are numbered 0 to 2")


def test_surfaces_without_area_are_refused(tmp_path):
    refused(surface(tmp_path / "point.ply", CUBE * [0, 0, 1]), "the surface has no triangles with area")


def test_bodies_that_cross_are_refused(tmp_path):
    points = np.vstack([CUBE, CUBE + [0.5, 0.4, 0.3]])
    refused(
        surface(tmp_path / "cross.ply", points, SIDES + (np.array(SIDES) + 8).tolist()),
        "separate parts of the surface cross each other near (1, 1, 1)",
    )


def test_cell_sizes_of_surfaces_are_checked(tmp_path):
    path = surface(tmp_path / "cube.ply")
    refused(path, "cell_size must be a positive number [m], got -1", cell_size=-1)
    refused(path, "cell_size must be at most the smallest extent, 1 m, got 3", cell_size=3)
    refused(
        path,
        "cell_size 1e-05 would give about 8.5e+15 cells; at most 2e+07 are accepted, cell_size >= 0.0075",
        cell_size=1e-5,
    )


def test_triangles_without_area_are_dropped_from_surfaces_with_a_note(tmp_path):
    data = read_mesh(surface(tmp_path / "cube.ply", faces=[*SIDES, [3, 3, 1]]))
    assert data.notes == ("1 triangle without area removed",)
    assert data.volumes().sum() == pytest.approx(1)


OVERLAPPING = """
import gmsh, sys
gmsh.initialize(readConfigFiles=False)
gmsh.option.setNumber("General.Terminal", 0)
gmsh.model.occ.addBox(0, 0, 0, 1, 1, 1)
gmsh.model.occ.synchronize()
for dim, tags, name in [(3, [1], "all"), (2, [1], "left"), (2, [1, 2], "sides")]:
    gmsh.model.setPhysicalName(dim, gmsh.model.addPhysicalGroup(dim, tags), name)
gmsh.option.setNumber("Mesh.MeshSizeMax", 1)
gmsh.model.mesh.generate(3)
gmsh.option.setNumber("Mesh.MshFileVersion", 4.1)
gmsh.write(sys.argv[1])
gmsh.finalize()
"""


def test_overlapping_physical_groups_are_named(tmp_path):
    path = tmp_path / "groups.msh"
    subprocess.run([sys.executable, "-c", OVERLAPPING, str(path)], check=True, capture_output=True)
    refused(
        path,
        "triangle cells are in 2 physical groups, 'left' and 'sides'; one is accepted "
        "(unions are written as lists of names, and 'surface' is the whole boundary)",
    )
