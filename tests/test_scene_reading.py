"""A good scene becomes one frozen object, the same on all ranks, with defaults filled in."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pydantic
import pytest
from bad_scenes import keys
from mpi4py import MPI

from extremal.app.elastic_checks import check_on_mesh
from extremal.app.elastic_scene import ElasticScene
from extremal.app.errors import InputError
from extremal.app.scene import load_scene, read_scene, validate

FULL = """
title = "everything at once"
part = "elastic"
[mesh]
shape = "box"
size = [1, 2, 1]
cell_size = 0.5
[material]
law = "neo_hookean"
young_modulus = "1e5*(1 + x**2)"
poisson_ratio = 0.45
density = 1000
extension = "c1"
[regions.core]
law = "custom"
energy = "a*(I1 - d) - mu*log(J) + lam/2*log(J)**2"
parameters = { a = "0.5e5*(1 + z)" }
[element]
degree = 2
[[fixed]]
boundary = ["left", "right"]
components = ["x"]
[[fixed]]
where = "z < 0.01 and x > 0.5"
[[motion]]
boundary = "top"
displacement = ["0.5*t", "", "free"]
[[motion]]
boundary = "bottom"
keyframes = [{ time = 0 }, { time = 1, translation = [0, 0, 1], rotation = [0, 0, 3], center = [0, 0, 0] }]
[[traction]]
boundary = "front"
value = [0, "1e3*t", 0]
[[pressure]]
boundary = "back"
value = "100*sin(pi*t)"
[gravity]
acceleration = [0, 0, -9.81]
[damping]
mass = 0.1
[initial]
velocity = [1, "y", 0]
[analysis]
type = "dynamic"
end_time = 2
time_step = 0.1
integrator = "bdf2"
error_tolerance = 1e-3
[continuation]
poisson_ratio = [0.3, 0.4]
threshold = [0.9]
[solver]
tolerance = 1e-6
iterations = 80
tangent = "exact"
[petsc]
elastic_ksp_type = "cg"
elastic_ksp_max_it = 300
elastic_snes_monitor = true
[output]
every = 0.5
fields = ["displacement", "J"]
checkpoint_every = 3
summary = false
[expect]
status = "finished"
inverted = 0
residual = { below = 1e-6 }
energy = { value = 3, tolerance = 0.1 }
"""


@pytest.fixture
def full(tmp_path: Path) -> ElasticScene:
    path = tmp_path / "full.toml"
    path.write_text(FULL)
    return read_scene(path)


def minimal(**tables: object) -> ElasticScene:
    return validate(
        {"mesh": {"shape": "box"}, "material": {"young_modulus": 1, "poisson_ratio": 0.3}, **tables}
    )


def test_every_key_is_read(full: ElasticScene) -> None:
    assert full.mesh.parameters == {"size": [1, 2, 1], "cell_size": 0.5}
    assert full.material.young_modulus == "1e5*(1 + x**2)"
    assert full.fixed[0].boundary == ("left", "right")
    assert full.fixed[1].where == "z < 0.01 and x > 0.5"
    assert full.motion[0].displacement == ("0.5*t", None, None)
    assert full.motion[1].keyframes is not None and full.motion[1].keyframes[1].rotation == (0, 0, 3)
    assert full.pressure[0].value == "100*sin(pi*t)"
    assert full.petsc == {"elastic_ksp_type": "cg", "elastic_ksp_max_it": 300, "elastic_snes_monitor": True}
    assert full.expect["residual"].below == 1e-6 and full.expect["status"].value == "finished"
    assert full.dimension == 3


def test_defaults_that_depend_on_other_keys_are_filled_in(full: ElasticScene) -> None:
    assert full.material.threshold == 0.4
    assert minimal().material.threshold == 0.9
    assert (full.analysis.smallest_step, full.analysis.largest_step) == (0.1 / 1024, 2)
    assert minimal(analysis={"end_time": 3}).analysis.time_step == 3


def test_a_region_overrides_what_it_names_and_inherits_the_rest(full: ElasticScene) -> None:
    core = full.material_of("core")
    assert (core.law, core.poisson_ratio, core.extension) == ("custom", 0.45, "c1")
    assert full.material_of("elsewhere") is full.material


def test_a_region_with_other_moduli_or_extension_does_not_inherit_the_old_ones() -> None:
    scene = validate(
        {
            "mesh": {"shape": "box"},
            "material": {"young_modulus": 1, "poisson_ratio": 0.3, "extension": "c1", "stiffness": 5},
            "regions": {"a": {"shear_modulus": 2, "lame_lambda": 3}, "b": {"extension": "c2"}},
        }
    )
    a, b = scene.material_of("a"), scene.material_of("b")
    assert (a.young_modulus, a.poisson_ratio, a.shear_modulus, a.stiffness) == (None, None, 2, 5)
    assert (b.stiffness, b.threshold) == (None, 0.9)


def test_a_scene_is_frozen(full: ElasticScene) -> None:
    with pytest.raises(pydantic.ValidationError):
        full.material.law = "corotated"  # type: ignore[misc]


def test_a_mesh_file_is_found_from_the_folder_of_the_scene(tmp_path: Path) -> None:
    (tmp_path / "body.msh").write_text("")
    path = tmp_path / "scene.toml"
    path.write_text('[mesh]\nfile = "body.msh"\n[material]\nyoung_modulus = 1\npoisson_ratio = 0.3\n')
    assert read_scene(path).mesh_file == tmp_path / "body.msh"


def test_numbers_in_quotes_are_numbers() -> None:
    scene = minimal(traction=[{"boundary": "left", "value": ["1e3", "0", 2]}])
    assert scene.traction[0].value == (1000.0, 0.0, 2.0)


@pytest.mark.filterwarnings("error")
def test_a_scene_can_be_written_as_json(full: ElasticScene) -> None:
    assert json.loads(full.model_dump_json())["fixed"][0]["boundary"] == ["left", "right"]
    assert full.model_dump(mode="json")["motion"][1]["keyframes"][1]["rotation"] == [0, 0, 3]


def test_every_key_says_its_meaning() -> None:
    assert [key for key, meaning in keys(ElasticScene) if not meaning] == []


def test_names_that_the_mesh_does_not_have_are_refused_with_the_nearest() -> None:
    scene = minimal(
        mesh={"file": "body.msh"},
        fixed=[{"boundary": ["left", "rigth"]}],
        pressure=[{"boundary": "roof", "value": 1}],
        regions={"sift": {"poisson_ratio": 0.2}},
        gravity={"acceleration": [0, 0, -1]},
        material={"young_modulus": 1, "poisson_ratio": 0.3, "density": 1},
    )
    check_on_mesh(scene, ["left", "rigth", "roof"], ["sift"], 3)
    with pytest.raises(InputError) as caught:
        check_on_mesh(scene, ["left", "right"], ["soft", "hard"], 2)
    assert caught.value.messages == (
        'scene: [[fixed]] #1 boundary = ["left", "rigth"]: the mesh has no "rigth"; did you mean right?',
        'scene: [[pressure]] #1 boundary = "roof": the mesh has no "roof"; known: left, right',
        "scene: [gravity] acceleration = [0, 0, -1]: must have 2 components: the body is 2-dimensional",
        "scene: [regions.sift]: the mesh has no region of this name; did you mean soft?",
    )


def test_checking_plain_numbers_loads_no_heavy_library(tmp_path: Path) -> None:
    path = tmp_path / "scene.toml"
    (tmp_path / "body.msh").write_text("")
    path.write_text('[mesh]\nfile = "body.msh"\n[material]\nyoung_modulus = 1\npoisson_ratio = 0.3\n')
    program = (
        "import json, sys; from extremal.app.scene import read_scene; read_scene(sys.argv[1]);"
        "print(json.dumps(sorted({m.split('.')[0] for m in sys.modules})))"
    )
    done = subprocess.run(
        [sys.executable, "-c", program, str(path)], capture_output=True, text=True, check=True, env=os.environ
    )
    loaded = set(json.loads(done.stdout))
    assert not loaded & {"dolfinx", "gmsh", "matplotlib", "petsc4py", "sympy", "h5py", "meshio"}


@pytest.mark.mpi
def test_every_rank_gets_the_same_scene(shared_path: Path, comm: MPI.Intracomm) -> None:
    path = shared_path / "scene.toml"
    if comm.rank == 0:
        path.write_text(FULL)
    scene = load_scene(path, comm)
    assert scene.path == path
    assert all(other == scene for other in comm.allgather(scene))


@pytest.mark.mpi
def test_every_rank_gets_the_same_error(shared_path: Path, comm: MPI.Intracomm) -> None:
    path = shared_path / "scene.toml"
    if comm.rank == 0:
        path.write_text(FULL.replace("0.45", "0.75").replace("degree = 2", "degree = 4"))
    with pytest.raises(InputError) as caught:
        load_scene(path, comm)
    assert len(caught.value.messages) == 2
    assert len(set(comm.allgather(caught.value.messages))) == 1


def test_the_reference_in_docs_is_current() -> None:
    from extremal.app.scene_reference import markdown

    written = Path(__file__).parent.parent / "docs" / "scenes.md"
    assert written.read_text(encoding="utf-8") == markdown(), (
        "python -m extremal.app.scene_reference > docs/scenes.md"
    )
