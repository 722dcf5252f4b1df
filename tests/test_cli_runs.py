"""The command line does what it is asked, alone and under mpirun; PETSc's options do what users expect."""

import json
import subprocess
import time
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import pytest

from extremal.app import cli
from extremal.app.options import split
from extremal.app.run_command import in_steps
from extremal.app.scene import validate

Launch = Callable[..., subprocess.CompletedProcess[str]]

SCENE = """
[mesh]
shape = "box"
cell_size = 0.5
[material]
young_modulus = 1e5
poisson_ratio = 0.3
[petsc]
elastic_ksp_rtol = 1e-3
"""

# Uses the database like a command does; prints what it finds as one line of JSON.
OPTIONS = """
import json, sys
from extremal.app.options import PetscOptions
options = PetscOptions(sys.argv[2:])
options.add_scene(json.loads(sys.argv[1]))
from petsc4py import PETSc
from extremal.native.options import defaults
ksp = PETSc.KSP().create()
ksp.setOptionsPrefix("elastic_")
with defaults("elastic_", {"ksp_type": "cg", "ksp_max_it": 7, "pc_typo": "none"}):
    ksp.setFromOptions()
    print(json.dumps([ksp.getType(), ksp.getTolerances()[0], ksp.getTolerances()[3], options.unused_line()]))
options.close()
"""


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "scene.toml").write_text(SCENE)
    return tmp_path


@pytest.mark.parametrize(
    ("words", "ours", "petsc"),
    [
        ("a.toml -log_view", "a.toml", "-log_view"),
        ("a.toml -ksp_rtol 1e-3 -o out", "a.toml -o out", "-ksp_rtol 1e-3"),
        ("-options_left a.toml", "a.toml", "-options_left"),
        ("-shift -1e-3 a.toml", "a.toml", "-shift -1e-3"),
        ("a.toml --steps 3 -a -b c", "a.toml --steps 3", "-a -b c"),
        ("a.toml -o -5", "a.toml -o -5", ""),
        ("a.toml -- -x", "a.toml -- -x", ""),
    ],
)
def test_single_dash_belongs_to_petsc(words: str, ours: str, petsc: str) -> None:
    assert split(words.split(), {"-o"}) == (ours.split(), petsc.split())


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("--version", "extremal "),
        ("--help", "usage: extremal COMMAND"),
        ("-h", "usage: extremal COMMAND"),
        ("elastic --help", "usage: extremal elastic"),
        ("check scene.toml -h", "usage: extremal check"),
        ("mesh box --help", "usage: extremal mesh"),
        ("study --help", "usage: extremal study"),
    ],
)
def test_help_is_printed_and_nothing_run(
    line: str, expected: str, here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(line.split()) == 0
    assert capsys.readouterr().out.startswith(expected)
    assert [path.name for path in here.iterdir()] == ["scene.toml"]


@pytest.mark.parametrize(
    ("line", "folder", "restart", "quiet", "steps"),
    [
        ("", "results/scene", None, False, 1.0),
        ("-o out --quiet", "out", None, True, 1.0),
        ("--steps 4", "results/scene", None, False, 0.25),
        ("-o full --overwrite", "full", None, False, 1.0),
        ("-o full --restart", "full", "full", False, 1.0),
        ("-o new --restart full -elastic_snes_monitor", "new", "full", False, 1.0),
    ],
)
def test_elastic_hands_the_scene_to_the_session(
    line: str,
    folder: str,
    restart: str | None,
    quiet: bool,
    steps: float,
    here: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    from extremal.app import elastic, session

    calls = []
    monkeypatch.setattr(elastic, "build", lambda scene, comm: ("problem", scene.title))
    monkeypatch.setattr(
        session, "run", lambda *args, **named: calls.append((args, named)) or SimpleNamespace(exit_code=3)
    )
    (here / "full").mkdir()
    (here / "full" / "history.csv").write_text("time\n")
    assert cli.main(["elastic", "scene.toml", *line.split()]) == 3
    ((problem, scene, where), named) = calls[0]
    assert problem == ("problem", "") and where == Path(folder)
    assert scene.analysis.time_step == steps
    assert named == {
        "restart": None if restart is None else Path(restart),
        "scene_path": Path("scene.toml"),
        "quiet": quiet,
    }


def test_steps_replace_the_time_step_of_the_scene() -> None:
    scene = validate(
        {
            "mesh": {"shape": "box"},
            "material": {"young_modulus": 1, "poisson_ratio": 0.3},
            "analysis": {"end_time": 2, "time_step": 0.5, "smallest_step": 0.1},
        }
    )
    assert in_steps(scene, 10).analysis.time_step == in_steps(scene, 10).analysis.largest_step == 0.2


def test_mesh_is_built_reported_written_and_read_again(
    here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main("mesh box --size 1,2,1 --corner -1,0,0 --cell-size 0.5 -o box.msh".split()) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith("box: ") and "tetrahedra of order 1" in lines[0]
    assert lines[1].startswith("  extent 1 x 2 x 1 m, volume 2 m3, ")
    assert lines[-1] == "  written to box.msh"
    assert cli.main("mesh box.msh".split()) == 0
    again = capsys.readouterr().out.splitlines()
    assert again[1:5] == lines[1:5]
    assert cli.main("mesh triangle -o box.msh --overwrite".split()) == 0


def test_defaults_yield_to_the_scene_and_the_scene_to_the_command_line(launch: Launch, here: Path) -> None:
    (here / "file").write_text("-elastic_ksp_rtol 1e-4\n")
    scene = json.dumps(
        {"elastic_ksp_type": "gmres", "elastic_ksp_rtol": 1e-3, "elastic_ksp_gmres_restrat": 9}
    )
    done = launch(
        0,
        "-c",
        OPTIONS,
        scene,
        "-options_file",
        "file",
        "-elastic_ksp_type",
        "bcgs",
        "-elastic_kps_type",
        "cg",
    )
    assert json.loads(done.stdout) == [
        "bcgs",
        1e-4,
        7,
        "unused PETSc options: -elastic_kps_type cg (did you mean -elastic_ksp_type?), "
        "-elastic_ksp_gmres_restrat 9 (did you mean -elastic_ksp_gmres_restart?)",
    ]
    # PETSc's own report at exit repeats nothing
    assert done.returncode == 0 and "WARNING" not in done.stdout + done.stderr


def test_used_options_and_our_defaults_are_never_reported(launch: Launch, tmp_path: Path) -> None:
    log = tmp_path / "log.txt"
    done = launch(0, "-c", OPTIONS, "{}", "-ELASTIC_KSP_TYPE", "fcg", "-log_view", f":{log}", "-malloc_debug")
    assert json.loads(done.stdout)[0] == "fcg"
    assert json.loads(done.stdout)[3] is None and "WARNING" not in done.stdout
    assert "Performance" in log.read_text()


def test_options_left_is_left_to_petsc(launch: Launch) -> None:
    done = launch(0, "-c", OPTIONS, "{}", "-options_left", "-fou", "1")
    first, rest = done.stdout.split("\n", 1)
    assert json.loads(first)[3] is None
    assert "-fou" in rest and "pc_typo" not in rest


def test_wrong_value_of_a_petsc_option_is_named(launch: Launch, here: Path) -> None:
    done = launch(0, "-m", "extremal.app", "elastic", "scene.toml", "-elastic_ksp_type", "cgg", cwd=here)
    assert done.returncode == 2
    assert done.stderr.strip().splitlines()[-1] == (
        "extremal: -elastic_ksp_type cgg: PETSc: Unable to find requested KSP type cgg"
    )


def own_lines(text: str) -> list[str]:
    return [line for line in text.splitlines() if "extremal: " in line]


def test_bad_input_under_mpirun_is_reported_once(launch: Launch, here: Path) -> None:
    (here / "bad.toml").write_text(SCENE.replace("0.3", "0.8"))
    done = launch(2, "-m", "extremal.app", "elastic", "bad.toml", "-elastic_snes_monitor", cwd=here)
    assert done.returncode == 2
    assert own_lines(done.stderr) == [
        "extremal: bad.toml: [material] poisson_ratio = 0.8: must be above -1 and below 0.5 "
        "(nearly incompressible: 0.499)"
    ]
    assert sorted(path.name for path in here.iterdir()) == ["bad.toml", "scene.toml"]


@pytest.mark.parametrize("failing", [0, 1])
def test_exception_on_one_rank_ends_all_with_one_message(failing: int, launch: Launch) -> None:
    program = f"""
import sys
from mpi4py import MPI
from extremal.app.parallel import run_on_all
comm = MPI.COMM_WORLD
def main():
    if comm.rank == {failing}:
        raise IndexError("out of cells")
    comm.barrier()
    return 0
sys.exit(run_on_all(comm, main))
"""
    start = time.monotonic()
    done = launch(2, "-c", program, timeout=60)
    assert done.returncode == 1
    rank = f"rank {failing}: " if failing else ""
    assert done.stderr.count("Traceback") == 1 and f"{rank}Traceback" in done.stderr
    assert own_lines(done.stderr) == ["extremal: unexpected IndexError: out of cells"]
    assert time.monotonic() - start < 30


def test_exception_on_all_ranks_is_reported_once(launch: Launch) -> None:
    program = """
import sys
from mpi4py import MPI
from extremal.app.parallel import on_root, run_on_all
comm = MPI.COMM_WORLD
sys.exit(run_on_all(comm, lambda: on_root(comm, lambda: {}["cells"])))
"""
    done = launch(2, "-c", program)
    assert done.returncode == 1
    assert own_lines(done.stderr) == ["extremal: unexpected KeyError: 'cells'"]
