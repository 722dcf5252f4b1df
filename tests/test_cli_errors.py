"""A bad command line is refused with one plain line and exit code 2, before anything is written."""

from pathlib import Path

import pytest

from extremal.app import cli, run_command, study_command
from extremal.app.errors import EXIT_INPUT
from extremal.meshes import SHAPES

SCENE = """
[mesh]
shape = "box"
cell_size = 0.5
[material]
young_modulus = 1e5
poisson_ratio = 0.3
"""

KNOWN = ", ".join(SHAPES)

# (arguments, message); {here} is the folder of scene.toml and full/notes.txt
CASES = [
    ("", "a command is missing; one of {commands} (extremal --help explains them)"),
    ("chekc", "chekc: unknown command; did you mean check?"),
    ("dance", "dance: unknown command; known: {commands}"),
    (
        "scene.toml",
        "scene.toml: unknown command; write extremal elastic scene.toml or extremal snow scene.toml or "
        "extremal hawkes scene.toml",
    ),
    ("--verbose", "--verbose: options come after the command, one of {commands}"),
    (
        "-log_view elastic",
        "-log_view: options come after the command, one of {commands}",
    ),
    ("elastic", "elastic: SCENE is missing"),
    ("elastic --quiet", "elastic: SCENE is missing"),
    (
        "elastic -elastic_snes_monitor scene",
        "elastic: SCENE is missing (scene was taken for the value of a PETSc option)",
    ),
    ("elastic scene.toml --retsart", "--retsart: unknown option; did you mean --restart?"),
    ("elastic scene.toml --over", "--over: unknown option; did you mean --overwrite?"),
    (
        "elastic scene.toml --colour",
        "--colour: unknown option; known: --help, --output, --restart, --overwrite, --steps, --quiet",
    ),
    ("elastic scene.toml --outptu=x", "--outptu: unknown option; did you mean --output?"),
    ("elastic scene.toml second.toml", "elastic: second.toml: one argument too many"),
    ("elastic scene.toml -o", "elastic: -o/--output: needs a value"),
    ("elastic scene.toml --steps", "elastic: --steps: needs a value"),
    ("elastic scene.toml --steps 0", "elastic: --steps: 0: must be a whole number of steps from 1 to 10000000"),
    ("elastic scene.toml --steps -3", "elastic: --steps: -3: must be a whole number of steps from 1 to 10000000"),
    ("elastic scene.toml --steps many", "elastic: --steps: many: must be a whole number of steps from 1 to 10000000"),
    ("elastic nothing.toml", "nothing.toml: no such file"),
    ("render full", "full: is no results folder; run.json cannot be read"),
    ("render full --size 3", "render: --size: 3: must be width x height from 16 to 8192, as 960x720"),
    ("render full --every 0", "render: --every: 0: must be a whole number, 1 or more"),
    ("elastic .", ".: is a folder; give a scene file"),
    ("elastic scene.toml -options_file nothing", "-options_file nothing: no such file"),
    ("elastic scene.toml -options_file", "-options_file: needs a file"),
    (
        "elastic scene.toml -options_file scene.toml.rc",
        "scene.toml.rc: line 3: elastic_ksp_type: an option begins with -, a comment with #",
    ),
    (
        "elastic scene.toml -o full",
        "full: is not empty; give --restart to continue it, --overwrite to replace it, "
        "or another folder by -o",
    ),
    ("elastic scene.toml -o scene.toml", "scene.toml: is a file; -o names a folder for the results"),
    (
        "elastic scene.toml -o full/notes.txt/x",
        "full/notes.txt/x: {here}/full/notes.txt is a file; -o names a folder for the results",
    ),
    ("elastic scene.toml -o new --restart", "--restart: new: no such results folder or checkpoint"),
    ("elastic scene.toml --restart old", "--restart: old: no such results folder or checkpoint"),
    (
        "elastic scene.toml -o full --restart --overwrite",
        "--overwrite: contradicts --restart; leave one of them out",
    ),
    ("check", "check: SCENE is missing"),
    ("check nothing.toml", "nothing.toml: no such file"),
    ("check scene.toml --quiet", "--quiet: unknown option; known: --help, --cost"),
    (
        "check scene.toml -elastic_snes_monitor",
        "-elastic_snes_monitor: unknown option; known: --help, --cost (check runs no PETSc solver)",
    ),
    ("mesh", f"mesh: SOURCE is missing; give a mesh file first, or a shape: {KNOWN}"),
    ("mesh bxo", "mesh: bxo: unknown shape; did you mean box?"),
    ("mesh body.msh", "mesh: body.msh: no such file"),
    ("mesh box --cellsize 0.5", "--cellsize: unknown option; did you mean --cell-size?"),
    ("mesh box --cell-size", "mesh: --cell-size: needs a value"),
    ("mesh box --cell-size=-1", "box: cell_size must be a positive number [m], got -1"),
    ("mesh box --cell-size -1", "box: cell_size must be a positive number [m], got -1"),
    ("mesh box --size 1,2", "box: size must be 3 positive lengths [m], got [1, 2]"),
    ("mesh box --size big", "box: size must be 3 positive lengths [m], got 'big'"),
    ("mesh box --dimension 4", "box: dimension must be 2 or 3, got 4"),
    ("mesh box -o box.stl", "box.stl: unknown kind of file; must end with .msh, .vtu or .xdmf"),
    ("mesh box -o none/box.msh", "none/box.msh: the folder none does not exist"),
    ("mesh box -o full/old.msh", "full/old.msh: exists; give --overwrite to replace it"),
    ("mesh box -o full/folder.msh", "full/folder.msh: is a folder; give a file"),
    ("study", "study: NAME is missing; known: contour, speed"),
    ("study contuor", "study contuor: unknown study; did you mean contour?"),
]


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder to work in, with a good scene and a results folder in use."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(study_command, "names", lambda: ["contour", "speed"])
    monkeypatch.setattr(run_command, "_solve", lambda *_: pytest.fail("the scene was run"))
    (tmp_path / "scene.toml").write_text(SCENE)
    (tmp_path / "scene.toml.rc").write_text("# solver\n-elastic_ksp_rtol 1e-3\nelastic_ksp_type cg\n")
    (tmp_path / "full" / "folder.msh").mkdir(parents=True)
    for name in ("notes.txt", "old.msh"):
        (tmp_path / "full" / name).write_text("")
    return tmp_path


def contents(folder: Path) -> list[tuple[Path, float]]:
    return sorted((path, path.stat().st_mtime) for path in folder.rglob("*"))


@pytest.mark.parametrize(("line", "message"), CASES, ids=[line or "nothing" for line, _ in CASES])
def test_bad_command_line_is_refused(
    line: str, message: str, here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = contents(here)
    expected = message.replace("{here}", str(here)).replace("{commands}", ", ".join(cli.COMMANDS))
    assert cli.main(line.split()) == EXIT_INPUT
    out, err = capsys.readouterr()
    assert (out, err) == ("", f"extremal: {expected}\n")
    assert contents(here) == before


def test_there_are_at_least_forty_distinct_messages() -> None:
    assert len({message for _, message in CASES}) >= 40


def test_check_lists_the_errors_of_all_scenes(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (here / "bad.toml").write_text(SCENE.replace("0.3", "0.7").replace("1e5", "-1"))
    (here / "worse.toml").write_text("[mesh\n")
    assert cli.main(["check", "bad.toml", "scene.toml", "worse.toml"]) == EXIT_INPUT
    out, err = capsys.readouterr()
    assert out == "scene.toml: good: elastic, box 3D, P1, neo_hookean with c2 extension, static\n"
    assert err.splitlines() == [
        "extremal: bad.toml: [material] poisson_ratio = 0.7: must be above -1 and below 0.5 "
        "(nearly incompressible: 0.499)",
        "extremal: bad.toml: [material] young_modulus = -1: must be above 0",
        "extremal: worse.toml: line 1, column 6: not TOML: Expected ']' at the end of a table declaration",
    ]


def test_scene_errors_keep_a_run_from_starting(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (here / "bad.toml").write_text(SCENE + '[petsc]\n"-ksp_type" = "cg"\n')
    before = contents(here)
    assert cli.main(["elastic", "bad.toml"]) == EXIT_INPUT
    assert capsys.readouterr().err == (
        'extremal: bad.toml: [petsc] -ksp_type = "cg": '
        "the name of a PETSc option is written without the dash\n"
    )
    assert contents(here) == before
