"""Files that are no usable mesh are refused in plain words."""

import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import meshio
import numpy as np
import pytest
from test_meshes_bad import CUBE, SIDES, TETS, mesh, moved

from extremal.meshes import MeshError, generate, read_mesh, write_mesh


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
