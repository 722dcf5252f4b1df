"""Meshes survive being written and read; closed surfaces are filled; scripts never run."""

import subprocess
import sys
from pathlib import Path

import meshio
import numpy as np
import pytest

from extremal.meshes import MeshData, MeshError, generate, read_mesh, write_mesh

LINEAR = generate("box", size=[1, 2, 1], cell_size=0.5)


def regions_of(data: MeshData) -> list[float]:
    return sorted(float(data.volumes()[data.regions == tag].sum()) for tag in data.region_names.values())


def halves() -> MeshData:
    """A cube of two regions."""
    data = generate("box", cell_size=0.4, structured=True)
    hard = data.points[data.corners].mean(axis=1)[:, 2] > 0.5
    regions = np.where(hard, 2, 1).astype(np.int32)
    return MeshData(**{**vars(data), "regions": regions, "region_names": {"soft": 1, "hard": 2}})


def save_surface(path: Path, *parts: tuple[np.ndarray, np.ndarray]) -> Path:
    """Triangles of several bodies as one file."""
    starts = np.cumsum([0] + [len(points) for points, _ in parts])
    points = np.vstack([points for points, _ in parts])
    faces = np.vstack([faces + start for (_, faces), start in zip(parts, starts)])
    if path.suffix == ".obj":
        lines = [f"v {x:.17g} {y:.17g} {z:.17g}" for x, y, z in points]
        path.write_text("\n".join(lines + [f"f {a} {b} {c}" for a, b, c in faces + 1]))
    else:
        meshio.write(path, meshio.Mesh(points, [("triangle", faces.astype(np.int32))]))
    return path


def shell(shape: str = "box", scale: float = 1, shift: float = 0, **parameters):
    data = generate(shape, **parameters)
    return data.points * scale + shift, data.facets


@pytest.mark.parametrize("ending", [".msh", ".vtu", ".xdmf"])
@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("dimension", [2, 3])
def test_a_written_mesh_is_read_again(tmp_path, ending, order, dimension):
    data = generate("sphere", dimension=dimension, order=order, cell_size=0.5)
    path = tmp_path / f"sphere{ending}"
    write_mesh(data, path)
    again = read_mesh(path)
    assert again.notes == ()
    assert again.order == order
    assert np.array_equal(again.points, data.points)
    assert np.array_equal(again.cells, data.cells)
    if ending == ".msh":
        assert again.boundary_names == data.boundary_names
        assert again.region_names == data.region_names
    if (ending, order) != (".xdmf", 2):
        assert np.array_equal(again.facets, data.facets)
        assert np.array_equal(again.facet_tags, data.facet_tags)


def test_regions_and_names_survive_in_gmsh_files(tmp_path):
    data = halves()
    write_mesh(data, tmp_path / "halves.msh")
    again = read_mesh(tmp_path / "halves.msh")
    assert again.region_names == {"soft": 1, "hard": 2}
    assert np.array_equal(again.regions, data.regions)
    assert again.notes == ("the mesh has the regions soft, hard",)


GMSH = """
import gmsh, sys
gmsh.initialize(readConfigFiles=False)
gmsh.option.setNumber("General.Terminal", 0)
gmsh.model.occ.addBox(0, 0, 0, 1, 1, 1)
gmsh.model.occ.addBox(1, 0, 0, 2, 1, 1)
gmsh.model.occ.fragment([(3, 1)], [(3, 2)])
gmsh.model.occ.synchronize()
for dim, tags, number, name in [(3, [1], 7, "soft"), (3, [2], 9, "hard"), (2, [1], 3, "left")]:
    gmsh.model.setPhysicalName(dim, gmsh.model.addPhysicalGroup(dim, tags, number), name)
gmsh.option.setNumber("Mesh.MeshSizeMax", 0.5)
gmsh.model.mesh.generate(3)
gmsh.model.mesh.setOrder(2)
for version in (2.2, 4.1):
    for binary in (0, 1):
        for every in (0, 1):
            gmsh.option.setNumber("Mesh.MshFileVersion", version)
            gmsh.option.setNumber("Mesh.Binary", binary)
            gmsh.option.setNumber("Mesh.SaveAll", every)
            gmsh.write(f"{sys.argv[1]}/{version}-{binary}-{every}.msh")
gmsh.finalize()
"""


def test_gmsh_files_of_both_formats_keep_names_regions_and_curvature(tmp_path):
    subprocess.run([sys.executable, "-c", GMSH, str(tmp_path)], check=True, capture_output=True)
    for version in ("2.2", "4.1"):
        for binary in (0, 1):
            for every in (0, 1):
                data = read_mesh(tmp_path / f"{version}-{binary}-{every}.msh")
                assert data.order == 2
                assert data.volumes().sum() == pytest.approx(3, rel=1e-9)
                if (version, every) == ("2.2", 1):  # gmsh itself writes no groups then
                    assert data.region_names == {"body": 0}
                    assert data.notes == (
                        "no element is in a physical group (saved with 'save all elements'?), "
                        "so their names are lost",
                    )
                else:
                    assert data.region_names == {"soft": 7, "hard": 9}
                    assert regions_of(data) == pytest.approx([1, 2])
                    assert data.boundary_names == {"left": 3}


def test_order_can_be_raised_and_lowered(tmp_path):
    write_mesh(generate("sphere", order=2), tmp_path / "curved.msh")
    write_mesh(LINEAR, tmp_path / "box.msh")
    curved, straight = read_mesh(tmp_path / "curved.msh"), read_mesh(tmp_path / "curved.msh", order=1)
    assert (curved.order, straight.order) == (2, 1)
    assert straight.volumes().sum() < curved.volumes().sum()
    assert straight.cells.max() == len(straight.points) - 1
    raised = read_mesh(tmp_path / "box.msh", order=2)
    assert raised.cells.shape[1] == 10
    assert raised.volumes().sum() == pytest.approx(2)


def test_the_newest_vtu_version_is_read(tmp_path):
    write_mesh(LINEAR, tmp_path / "box.vtu")
    content = (tmp_path / "box.vtu").read_text()
    (tmp_path / "new.vtu").write_text(content.replace('version="0.1"', 'version="2.2"'))
    assert read_mesh(tmp_path / "new.vtu").volumes().sum() == pytest.approx(2)


@pytest.mark.parametrize("ending", [".stl", ".obj", ".ply"])
@pytest.mark.parametrize("shape", ["box", "torus"])
def test_closed_surfaces_are_filled(tmp_path, ending, shape):
    data = generate(shape, cell_size=0.25)
    path = save_surface(tmp_path / f"surface{ending}", (data.points, data.facets))
    volume = data.volumes().sum()
    kept = read_mesh(path)
    assert kept.volumes().sum() == pytest.approx(volume, rel=1e-5)  # STL is in single precision
    finer = read_mesh(path, cell_size=0.12)
    assert finer.volumes().sum() == pytest.approx(volume, rel=0.05)
    assert len(finer.cells) > 2 * len(kept.cells)
    assert read_mesh(path, order=2).order == 2


def test_turned_triangles_of_a_surface_do_not_matter(tmp_path):
    points, faces = shell(cell_size=0.4)
    turned = np.arange(len(faces)) % 3 == 0
    faces[turned] = faces[turned][:, ::-1]
    assert read_mesh(save_surface(tmp_path / "s.ply", (points, faces))).volumes().sum() == pytest.approx(1)


def test_surfaces_inside_others_are_cavities_and_bodies_in_turn(tmp_path):
    parts = [shell(cell_size=0.4), shell(scale=0.6, shift=0.2, cell_size=0.4), shell(scale=0.2, shift=0.4)]
    hollow = read_mesh(save_surface(tmp_path / "hollow.ply", *parts[:2]))
    assert hollow.volumes().sum() == pytest.approx(1 - 0.216)
    nested = read_mesh(save_surface(tmp_path / "nested.ply", *parts))
    assert nested.volumes().sum() == pytest.approx(1 - 0.216 + 0.008)
    assert nested.notes == ("the mesh has 2 separate pieces",)


@pytest.mark.parametrize(
    "ending", [".geo", ".geo_unrolled", ".msh", ".vtu", ".vtk", ".stl", ".ply", ".obj", ".mesh"]
)
def test_no_gmsh_script_runs_under_any_ending(tmp_path, ending):
    script = tmp_path / f"evil{ending}"
    script.write_text(f'SystemCall "touch {tmp_path}/ran";\nPoint(1) = {{0, 0, 0}};\n')
    with pytest.raises(MeshError):
        read_mesh(script)
    assert not (tmp_path / "ran").exists()


def test_reading_prints_nothing(tmp_path, capfd):
    write_mesh(LINEAR, tmp_path / "box.msh")
    read_mesh(tmp_path / "box.msh")
    read_mesh(save_surface(tmp_path / "box.stl", shell()))
    (tmp_path / "bad.vtu").write_text('<VTKFile version="9.9" type="UnstructuredGrid"></VTKFile>')
    with pytest.raises(MeshError):
        read_mesh(tmp_path / "bad.vtu")
    assert capfd.readouterr() == ("", "")


def test_a_file_that_cannot_be_written_is_named(tmp_path):
    with pytest.raises(MeshError) as error:
        write_mesh(LINEAR, tmp_path / "box.foo")
    assert str(error.value) == f"{tmp_path}/box.foo: unknown file type '.foo': accepted: .msh, .vtu, .xdmf"
    with pytest.raises(MeshError) as error:
        write_mesh(LINEAR, tmp_path / "no" / "box.msh")
    assert str(error.value) == f"{tmp_path}/no/box.msh: cannot be written (No such file or directory)"
