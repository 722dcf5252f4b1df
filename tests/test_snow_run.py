"""A scene of snow becomes a results folder, the same on any number of ranks, and can be gone on with."""

import json
import subprocess
from collections.abc import Callable
from pathlib import Path

import meshio
import numpy as np
import pytest
from mpi4py import MPI

from extremal.app import checkpoint, cli
from extremal.app.errors import InputError
from extremal.app.particles_output import grid_density
from extremal.app.results import read_table
from extremal.app.scene import validate
from extremal.app.snow import build
from extremal.app.snow_scene import DIAGNOSTICS, PARTICLE_FIELDS
from extremal.mpm.problem import SnowProblem

Launch = Callable[..., subprocess.CompletedProcess[str]]

SCENE = """
title = "a small snowball"
part = "snow"
[grid]
cell_size = 0.05
[[body]]
shape = "sphere"
center = [0, 0, 0.14]
radius = 0.1
per_cell = 4
velocity = [1, 0, -3]
spin = [0, 0, 5]
[[collider]]
shape = "half_space"
point = [0, 0, 0]
normal = [0, 0, 1]
friction = 0.5
[gravity]
acceleration = [0, 0, -9.81]
[analysis]
end_time = 0.02
time_step = 1e-3
[output]
every = 0.01
checkpoint_every = 5
summary = false
[expect]
status = "finished"
"""


@pytest.fixture
def scene(shared_path: Path, comm: MPI.Intracomm) -> Path:
    path = shared_path / "scene.toml"
    if comm.rank == 0:
        path.write_text(SCENE)
    comm.barrier()
    return path


def history(folder: Path) -> list[dict[str, float]]:
    return read_table(folder / "history.csv")[1]


@pytest.mark.mpi
def test_a_run_leaves_particles_history_and_record(scene: Path, comm: MPI.Intracomm) -> None:
    folder = scene.parent / "results"
    assert cli.main(["snow", str(scene), "-o", str(folder), "--quiet"]) == 0
    if comm.rank > 0:
        return
    rows = history(folder)
    assert rows[-1]["time"] == 0.02
    assert set(DIAGNOSTICS) - set(rows[-1]) <= {"angular_momentum_x", "angular_momentum_y"}
    assert len({row["particles"] for row in rows}) == 1
    assert [row["mass"] for row in rows] == pytest.approx([rows[0]["mass"]] * len(rows), rel=1e-13)
    frames = sorted((folder / "fields").iterdir())
    assert [frame.name for frame in frames] == [f"frame_{i:05d}.vtu" for i in range(3)]
    assert (folder / "fields.pvd").read_text().count("<DataSet") == 3
    last = meshio.vtu.read(str(frames[-1]))
    assert last.cells[0].type == "vertex" and len(last.points) == rows[-1]["particles"]
    assert set(last.point_data) == set(PARTICLE_FIELDS)
    record = json.loads((folder / "run.json").read_text())
    assert {"plasticity", "implicit", "gravity", "colliders"} <= set(record["effects"])
    assert record["solver_iterations"]["total"] == sum(row["krylov_iterations"] for row in rows[1:])


def test_start_is_what_the_scene_says(comm: MPI.Intracomm) -> None:
    import tomllib

    read = validate(tomllib.loads(SCENE))
    p = build(read, comm).particles
    middle = np.array([0, 0, 0.14])
    assert np.all(np.linalg.norm(p.position - middle, axis=1) <= 0.1)
    # 4/3 π r³ ρ; a few hundred random points sample the volume to some per cent
    assert p.mass.sum() == pytest.approx(400 * 4 / 3 * np.pi * 1e-3, rel=0.05)
    expected = np.array([1, 0, -3]) + np.cross([0, 0, 5], p.position - middle)
    assert p.velocity == pytest.approx(expected)


@pytest.mark.parametrize("volumes", ["measured", "seeded"])
def test_volumes_are_those_of_seeding_or_what_the_first_step_finds(volumes: str, comm: MPI.Intracomm) -> None:
    import tomllib

    data = tomllib.loads(SCENE)
    data["grid"]["volumes"] = volumes
    problem = build(validate(data), comm)
    exact = 0.05**3 / 4
    assert set(problem.state()["volume"]) == {exact if volumes == "seeded" else 0}
    problem.advance(1e-4)
    found = problem.state()["volume"]
    if volumes == "seeded":
        assert set(found) == {exact}
    else:
        # next to the surface the grid is half empty: the density is found too small
        assert found.mean() > 1.2 * exact


@pytest.mark.mpi
def test_particles_are_the_same_on_any_number_of_ranks(comm: MPI.Intracomm) -> None:
    import tomllib

    data = tomllib.loads(SCENE)
    ball = data["body"][0]
    extra = {"shell": {"thickness": 0.05, "stiffness": 3, "density": 2}, "noise": {"size": 0.1, "density": 0.2}}
    data["body"] = [ball | extra, ball | {"center": [1, 0, 0.14], "seed": 2, "material": {"law": "neo_hookean"}}]
    together, alone = build(validate(data), comm).state(), build(validate(data), MPI.COMM_SELF).state()
    if comm.rank == 0:
        assert set(together["body"]) == {0, 1}
        assert np.array_equal(together["ident"], np.arange(len(together["ident"])))
        assert all(np.array_equal(together[name], alone[name]) for name in together)


def test_a_restarted_run_ends_as_if_it_had_not_stopped(scene: Path) -> None:
    whole, half = scene.parent / "whole", scene.parent / "half"
    assert cli.main(["snow", str(scene), "-o", str(whole), "--quiet"]) == 0
    shorter = scene.with_name("shorter.toml")
    shorter.write_text(SCENE.replace("end_time = 0.02", "end_time = 0.01"))
    assert cli.main(["snow", str(shorter), "-o", str(half), "--quiet"]) == 0
    assert cli.main(["snow", str(scene), "-o", str(half), "--restart", "--quiet"]) == 0
    rows, again = history(whole), history(half)
    assert len(rows) == len(again)
    for name in ("kinetic_energy", "elastic_energy", "plastic_dissipation", "momentum_z"):
        # sums may be taken in another order
        assert again[-1][name] == pytest.approx(rows[-1][name], rel=1e-12, abs=1e-14)


@pytest.mark.mpi
@pytest.mark.parametrize("what", ["particle", "mass"])
def test_a_loss_ends_the_run_in_one_line_and_keeps_the_last_good_checkpoint(
    what: str, scene: Path, comm: MPI.Intracomm, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def lose(problem: SnowProblem) -> None:
        arrange(problem)
        if problem.time > 0.0125 and comm.rank == comm.size - 1:
            if what == "particle":
                problem.particles = problem.particles.take(np.arange(1, len(problem.particles)))
            else:
                problem.particles.mass[:1] /= 2

    arrange = SnowProblem._arrange
    monkeypatch.setattr(SnowProblem, "_arrange", lose)
    folder = scene.parent / "results"
    assert cli.main(["snow", str(scene), "-o", str(folder), "--quiet"]) == 3
    if comm.rank > 0:
        return
    record, rows = json.loads((folder / "run.json").read_text()), history(folder)
    assert (record["status"], record["exit_code"]) == ("failed", 3)
    count = f"{rows[0]['particles']:.0f}"
    words = f"{int(what == 'particle')} of {count} particles were lost, "
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("failed: step ") and words in line
    # the state that is worth nothing is neither a row nor a frame nor a checkpoint
    good = [checkpoint.load(path) for path in checkpoint.list_checkpoints(folder)]
    assert [found.facts["step"] for found in good] == [10, 5]
    assert len(good[0].state["ident"]) == rows[0]["particles"]
    assert rows[-1]["step"] == record["steps"] - 1
    assert len(list((folder / "fields").iterdir())) == 2


def test_density_on_the_grid_holds_all_mass_where_it_is() -> None:
    rng = np.random.default_rng(1)
    x, mass, h = rng.uniform(-1, 2, (500, 3)), rng.uniform(1, 2, 500), 0.3
    density, first = grid_density(x, mass, h)
    assert density.sum() * h**3 == pytest.approx(mass.sum())
    nodes = [h * (first[k] + np.arange(density.shape[k])) for k in range(3)]
    # B-splines reproduce linear functions: the centre of mass is kept
    for k, axes in enumerate(((1, 2), (0, 2), (0, 1))):
        assert (density.sum(axis=axes) * nodes[k]).sum() * h**3 == pytest.approx((mass * x[:, k]).sum())


def test_density_is_written_as_openvdb_where_asked_for(scene: Path) -> None:
    vdb = pytest.importorskip("pyopenvdb")
    scene.write_text(SCENE.replace("every = 0.01", "every = 0.01\nvdb = true"))
    folder = scene.parent / "results"
    assert cli.main(["snow", str(scene), "-o", str(folder), "--quiet"]) == 0
    files = sorted((folder / "fields").glob("*.vdb"))
    assert [file.name for file in files] == [f"density_{i:05d}.vdb" for i in range(3)]
    grid = vdb.readAllGridMetadata(str(files[-1]))[0]
    assert grid.name == "density" and grid.transform.voxelSize()[0] == pytest.approx(0.05)
    values = vdb.read(str(files[-1]), "density")
    total = sum(value["value"] if isinstance(value, dict) else value.value for value in values.citerOnValues())
    assert total * 0.05**3 == pytest.approx(history(folder)[-1]["mass"], rel=1e-5)


def test_without_openvdb_the_run_does_not_start(scene: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import sys

    from extremal.app.particles_output import openvdb

    monkeypatch.setitem(sys.modules, "openvdb", None)
    monkeypatch.setitem(sys.modules, "pyopenvdb", None)
    with pytest.raises(InputError, match="apt install python3-openvdb"):
        openvdb()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("radius = 0.1", "radius = 1e-4"), "[[body]] #1: has no particle; its cells or its shape are too small"),
        (('part = "snow"', ""), '{path}: [mesh]: is missing; the body'),
        (
            ("[[collider]]", '[[body]]\nshape = "text"\ntext = "\u200b "\nheight = 1\nthickness = 1\n'
             "center = [0, 0, 0]\n[[collider]]"),
            "[[body]] #2: text: ",
        ),
    ],
)  # fmt: skip
def test_what_cannot_be_built_is_named(
    change: tuple[str, str], message: str, scene: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scene.write_text(SCENE.replace(*change))
    assert cli.main(["snow", str(scene), "-o", str(scene.parent / "results")]) == 2
    assert message.replace("{path}", str(scene)) in capsys.readouterr().err


def test_the_wrong_command_names_the_right_one(scene: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["elastic", str(scene)]) == 2
    assert capsys.readouterr().err == f'extremal: {scene}: part = "snow": write extremal snow {scene}\n'


def test_scale_makes_cells_finer_and_particles_more(scene: Path) -> None:
    counts = []
    for scale in ("1", "2"):
        folder = scene.parent / scale
        words = ["snow", str(scene), "-o", str(folder), "--quiet", "--scale", scale, "--steps", "20"]
        assert cli.main(words) == 0
        counts.append(history(folder)[-1]["particles"])
    assert counts[1] == pytest.approx(8 * counts[0], rel=0.1)


@pytest.mark.parametrize("word", ["0", "-1", "many", "101"])
def test_a_scale_that_is_none_is_refused(word: str, scene: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["snow", str(scene), "--scale", word]) == 2
    line = f"extremal: snow: --scale: {word}: must be a number above 0 and at most 100\n"
    assert capsys.readouterr().err == line


def test_snow_loads_neither_dolfinx_nor_gmsh_nor_what_the_scene_does_not_need(scene: Path, launch: Launch) -> None:
    code = (
        "import sys; from extremal.app import cli; code = cli.main(sys.argv[1:]);"
        "heavy = ('dolfinx', 'gmsh', 'ufl', 'matplotlib', 'sympy', 'openvdb', 'pyopenvdb', 'igl', 'PIL');"
        "print(code, [name for name in heavy if name in sys.modules])"
    )
    done = launch(0, "-c", code, "snow", scene, "-o", scene.parent / "results", "--quiet")
    assert done.stdout.splitlines()[-1] == "0 []", done.stderr
