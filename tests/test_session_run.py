"""A whole run: the loop, the results folder, run.json, expectations."""

import json
import xml.etree.ElementTree as ET

import meshio
import numpy as np
import pytest
from fake_problem import FakeProblem, scene

from extremal.app import session
from extremal.app.errors import InputError
from extremal.app.results import OutputError, Table, atomic, read_table

pytestmark = pytest.mark.mpi


def frames(folder) -> list[tuple[float, str]]:
    root = ET.parse(folder / "fields.pvd").getroot()
    return [(float(entry.get("timestep")), entry.get("file")) for entry in root.iter("DataSet")]


def test_a_run_leaves_history_frames_checkpoint_and_record(comm, shared_path):
    scene_path = shared_path / "scene.in.toml"
    if comm.rank == 0:
        scene_path.write_text('title = "springs"\n')
    folder = shared_path / "results"
    outcome = session.run(FakeProblem(comm), scene(), folder, scene_path=scene_path, quiet=True)
    assert (outcome.status, outcome.exit_code, outcome.steps, outcome.time) == ("finished", 0, 10, 1.0)
    if comm.rank > 0:
        return
    names, rows = read_table(folder / "history.csv")
    assert names[:5] == ["step", "time", "dt", "cutbacks", "wall"]
    assert [row["step"] for row in rows] == list(range(11))
    assert rows[-1]["time"] == 1.0
    assert rows[-1]["energy"] == outcome.diagnostics["energy"]
    assert (folder / "scene.toml").read_text() == 'title = "springs"\n'
    assert [path.name for path in (folder / "checkpoints").iterdir()] == ["step_000010.h5"]
    record = json.loads((folder / "run.json").read_text())
    assert (record["status"], record["exit_code"], record["ranks"]) == ("finished", 0, comm.size)
    assert record["solver_iterations"] == {"total": 30, "newton_iterations": 30, "krylov_iterations": 210}
    assert record["effects"]["springs"] == {"facts": {"stiffness": 40.0}, "seconds": None}
    assert record["events"]["session:output"]["seconds"] > 0
    assert len(record["peak_memory_bytes"]) == len(record["cpu_seconds"]) == comm.size
    assert {"extremal", "python", "numpy", "petsc", "petsc4py", "mpi"} <= set(record["versions"])
    assert not list(folder.rglob(".*"))


def test_frames_are_a_series_with_displacement_and_cell_fields(comm, shared_path):
    problem = FakeProblem(comm)
    session.run(problem, scene(output={"every": 0.25}), shared_path, quiet=True)
    last = problem.fields()
    if comm.rank > 0:
        return
    assert [time for time, _ in frames(shared_path)] == [0.0, 0.25, 0.5, 0.75, 1.0]
    mesh = meshio.read(shared_path / frames(shared_path)[-1][1])
    assert np.array_equal(mesh.points, problem.points)
    assert np.array_equal(mesh.cells[0].data, problem.cells)
    assert np.array_equal(mesh.point_data["displacement"], last[0]["displacement"])
    assert np.array_equal(mesh.cell_data["smallest_stretch"][0], last[1]["smallest_stretch"])
    assert set(mesh.cell_data["inverted"][0]) <= {0, 1}


def test_vtk_reads_a_frame(comm, shared_path):
    if comm.size > 1:
        pytest.skip("one reader is enough")
    vtk = pytest.importorskip("vtkmodules.vtkIOXML")
    session.run(FakeProblem(comm), scene(), shared_path, quiet=True)
    for _, name in frames(shared_path):
        reader = vtk.vtkXMLUnstructuredGridReader()
        reader.SetFileName(str(shared_path / name))
        reader.Update()
        grid = reader.GetOutput()
        assert reader.GetErrorCode() == 0
        assert (grid.GetNumberOfPoints(), grid.GetNumberOfCells()) == (64, 162)
        assert grid.GetPointData().GetArray("displacement").GetNumberOfComponents() == 3
        assert grid.GetCellData().GetArray("inverted") is not None


def test_only_the_fields_asked_for_are_written(comm, shared_path):
    session.run(FakeProblem(comm), scene(output={"fields": ["J"]}), shared_path, quiet=True)
    if comm.rank == 0:
        mesh = meshio.read(shared_path / "fields/frame_00000.vtu")
        assert (set(mesh.point_data), set(mesh.cell_data)) == ({"displacement"}, {"J"})


def test_solver_iterations_of_one_static_step_become_frames_along_their_count(comm, shared_path):
    settings = scene(analysis={"time_step": 1.0, "largest_step": 1.0}, output={"iterations": 5})
    session.run(FakeProblem(comm, iterations=12), settings, shared_path, quiet=True)
    if comm.rank == 0:
        assert [time for time, _ in frames(shared_path)] == [0.0, 5.0, 10.0, 12.0]
        rows = read_table(shared_path / "iterations.csv")[1]
        assert [row["total"] for row in rows] == list(range(1, 13))


def test_a_failed_step_is_tried_again_shorter_until_it_succeeds(comm, shared_path):
    problem = FakeProblem(comm, fails=lambda time, dt: 0.35 < time < 0.5 and dt > 0.03)
    outcome = session.run(problem, scene(), shared_path, quiet=True)
    assert (outcome.status, outcome.time) == ("finished", 1.0)
    if comm.rank == 0:
        rows = read_table(shared_path / "history.csv")[1]
        assert [row["cutbacks"] for row in rows[:6]] == [0, 0, 0, 0, 0, 2]
        assert rows[5]["dt"] == pytest.approx(0.025)


def test_a_run_that_cannot_go_on_fails_with_the_reason_and_keeps_the_last_good_state(comm, shared_path):
    problem = FakeProblem(comm, fails=lambda time, dt: time > 0.55)
    outcome = session.run(problem, scene(), shared_path, quiet=True)
    assert (outcome.status, outcome.exit_code, outcome.steps) == ("failed", 3, 6)
    assert outcome.reason == "step 7: dt 9.77e-05 (the smallest step): the fake solver was told to fail"
    assert outcome.diagnostics == problem.diagnostics()
    restarted = FakeProblem(comm)
    outcome = session.run(restarted, scene(), shared_path, restart=shared_path, quiet=True)
    assert (outcome.status, outcome.time) == ("finished", 1.0)
    if comm.rank == 0:
        assert read_table(shared_path / "history.csv")[1][6]["time"] == pytest.approx(0.6)


def test_without_adaptive_steps_the_first_failure_ends_the_run(comm, shared_path):
    problem = FakeProblem(comm, fails=lambda time, dt: time > 0.55)
    outcome = session.run(problem, scene(analysis={"adaptive": False}), shared_path, quiet=True)
    assert outcome.reason == "step 7: dt 0.1 (the fixed step): the fake solver was told to fail"


def test_results_do_not_depend_on_the_number_of_ranks(comm, shared_path):
    """Sums over ranks are rounded in another order: 1e-12."""
    from mpi4py import MPI

    together = session.run(FakeProblem(comm), scene(), shared_path / "all", quiet=True)
    alone = session.run(FakeProblem(MPI.COMM_SELF), scene(), shared_path / f"rank_{comm.rank}", quiet=True)
    assert together.diagnostics == pytest.approx(alone.diagnostics, rel=1e-12)


@pytest.mark.parametrize(
    ("expected", "met", "line"),
    [
        ({"status": {"value": "finished"}}, True, "expect status = finished: finished, met"),
        ({"steps": {"value": 10}}, True, "expect steps = 10: 10, met"),
        ({"time": {"value": 1.1, "tolerance": 0.2}}, True, "expect time = 1.1 ± 0.2: 1, met"),
        ({"time": {"value": 1.1}}, False, "expect time = 1.1: 1, MISSED"),
        ({"time": {"above": 0.5, "below": 2}}, True, "expect time < 2 and > 0.5: 1, met"),
        ({"time": {"below": 0.5}}, False, "expect time < 0.5: 1, MISSED"),
        (
            {"enrgy": {"below": 1}},
            False,
            "expect enrgy < 1: no such diagnostic; did you mean energy?, MISSED",
        ),
    ],
)
def test_expectations_are_told_one_by_one_and_decide_the_exit_code(
    comm, shared_path, capsys, expected, met, line
):
    outcome = session.run(FakeProblem(comm), scene(expect=expected), shared_path, quiet=True)
    assert outcome.status == "finished"
    assert outcome.exit_code == (0 if met else 3)
    if comm.rank == 0:
        assert line in capsys.readouterr().out.splitlines()
        record = json.loads((shared_path / "run.json").read_text())
        assert [entry["met"] for entry in record["expect"]] == [met]


def test_not_a_number_never_meets_an_expectation(comm, shared_path):
    class Poisoned(FakeProblem):
        def diagnostics(self):
            return super().diagnostics() | {"energy": float("nan")}

    for wanted in ({"value": 1.0}, {"below": 1.0}, {"above": 1.0}, {"value": 1.0, "tolerance": 9.0}):
        outcome = session.run(Poisoned(comm), scene(expect={"energy": wanted}), shared_path, quiet=True)
        assert outcome.exit_code == 3


def test_progress_says_one_line_a_step_on_rank_0_only(comm, shared_path, capsys):
    session.run(FakeProblem(comm), scene(), shared_path)
    lines = capsys.readouterr().out.splitlines()
    if comm.rank == 0:
        assert [line.split("  ")[0] for line in lines[:-1]] == [f"step {k}" for k in range(1, 11)]
        assert lines[-1] == f"finished, results in {shared_path}"
    else:
        assert lines == []


def test_a_new_run_replaces_the_old_results_and_nothing_else(comm, shared_path):
    session.run(FakeProblem(comm), scene(), shared_path, quiet=True)
    if comm.rank == 0:
        (shared_path / "notes.txt").write_text("mine")
    session.run(FakeProblem(comm), scene(analysis={"end_time": 0.3}), shared_path, quiet=True)
    if comm.rank == 0:
        assert len(frames(shared_path)) == len(list((shared_path / "fields").iterdir())) == 4
        assert [path.name for path in (shared_path / "checkpoints").iterdir()] == ["step_000003.h5"]
        assert (shared_path / "notes.txt").read_text() == "mine"


def test_a_folder_that_cannot_be_made_is_an_input_error(comm, shared_path):
    if comm.rank == 0:
        (shared_path / "file").write_text("")
    comm.barrier()
    with pytest.raises(InputError, match="cannot be used: .*; accepted is a folder you may write to"):
        session.run(FakeProblem(comm), scene(), shared_path / "file", quiet=True)


def test_a_crash_is_recorded_before_it_is_passed_on(comm, shared_path):
    class Broken(FakeProblem):
        def advance(self, dt):
            raise KeyError("lost")

    with pytest.raises(KeyError):
        session.run(Broken(comm), scene(), shared_path, quiet=True)
    if comm.rank == 0:
        record = json.loads((shared_path / "run.json").read_text())
        assert (record["status"], record["reason"]) == ("failed", "KeyError: 'lost'")


def test_an_interrupted_write_leaves_the_old_file_and_nothing_else(tmp_path):
    path = tmp_path / "a.txt"
    path.write_text("old")
    with pytest.raises(RuntimeError), atomic(path) as partial:
        partial.write_text("ne")
        raise RuntimeError
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_a_write_that_fails_names_the_file_and_the_free_bytes(tmp_path):
    path = tmp_path / "a.txt"
    message = r"a.txt: cannot be written: No space left on device \([\d,]+ bytes free\)$"
    with pytest.raises(OutputError, match=message):
        with atomic(path):
            raise OSError(28, "x")


def test_a_table_keeps_numbers_exactly_takes_new_columns_and_forgets_a_broken_last_line(tmp_path):
    table = Table(tmp_path / "t.csv")
    table.append({"step": 0, "a": 0.1 + 0.2})
    table.append({"step": 1, "b": 1e-300, "a": float("nan")})
    with open(tmp_path / "t.csv", "a") as file:
        file.write("2,0.")
    again = Table(tmp_path / "t.csv")
    again.keep(lambda row: True)
    again.append({"step": 2, "b": -3.0})
    names, rows = read_table(tmp_path / "t.csv")
    assert names == ["step", "a", "b"]
    assert rows[0] == {"step": 0.0, "a": 0.1 + 0.2}
    assert np.isnan(rows[1].pop("a")) and rows[1] == {"step": 1.0, "b": 1e-300}
    assert rows[2] == {"step": 2.0, "b": -3.0}
