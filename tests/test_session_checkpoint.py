"""Checkpoints: restarting is as if nothing had happened, and damaged files are never trusted."""

import json
import random

import h5py
import numpy as np
import pytest
from fake_problem import FakeProblem, scene

from extremal.app import checkpoint, session
from extremal.app.errors import InputError
from extremal.app.results import read_table


def history(folder) -> list[dict[str, float]]:
    """Return the rows of a run without the wall time."""
    rows = read_table(folder / "history.csv")[1]
    return [{name: value for name, value in row.items() if name != "wall"} for row in rows]


def growing(end: float, **output) -> object:
    """Return a scene whose step grows, so that the state of the step control matters."""
    analysis = {"end_time": end, "time_step": 0.01, "largest_step": 0.2}
    return scene(analysis=analysis, output={"checkpoint_every": 3} | output)


def failing(comm) -> FakeProblem:
    return FakeProblem(comm, fails=lambda time, dt: 0.3 < time < 0.45 and dt > 0.02)


@pytest.mark.mpi
def test_k_and_k_more_steps_equal_2k_steps_exactly(comm, shared_path):
    whole, parts = shared_path / "whole", shared_path / "parts"
    straight = failing(comm)
    session.run(straight, growing(1.0, every=0.25), whole, quiet=True)
    # the end of the first half is a time that the whole run hits too
    session.run(failing(comm), growing(0.5, every=0.25), parts, quiet=True)
    problem = failing(comm)
    outcome = session.run(problem, growing(1.0, every=0.25), parts, restart=parts, quiet=True)
    assert outcome.exit_code == 0
    first, second = straight.state(), problem.state()
    if comm.rank == 0:
        assert all(np.array_equal(first[name], second[name]) for name in first)
        assert history(whole) == history(parts)
        assert (whole / "fields.pvd").read_text() == (parts / "fields.pvd").read_text()
        for frame in (whole / "fields").iterdir():
            assert frame.read_bytes() == (parts / "fields" / frame.name).read_bytes()


@pytest.mark.mpi
def test_a_restart_elsewhere_takes_the_past_with_it_and_leaves_the_old_folder_alone(comm, shared_path):
    old, new, whole = shared_path / "old", shared_path / "new", shared_path / "whole"
    session.run(FakeProblem(comm), scene(analysis={"end_time": 0.5}, output={"every": 0.5}), old, quiet=True)
    before = {path: path.read_bytes() for path in old.rglob("*") if path.is_file()} if comm.rank == 0 else {}
    session.run(FakeProblem(comm), scene(output={"every": 0.5}), new, restart=old, quiet=True)
    session.run(FakeProblem(comm), scene(output={"every": 0.5}), whole, quiet=True)
    if comm.rank == 0:
        assert before == {path: path.read_bytes() for path in old.rglob("*") if path.is_file()}
        assert history(new) == history(whole)
        assert len(list((new / "fields").iterdir())) == 3


@pytest.mark.mpi
def test_the_number_of_ranks_may_change_between_a_run_and_its_restart(comm, shared_path):
    """Sums over ranks are rounded in another order: 1e-12."""
    from mpi4py import MPI

    if comm.rank == 0:
        session.run(
            FakeProblem(MPI.COMM_SELF), scene(analysis={"end_time": 0.5}), shared_path / "a", quiet=True
        )
        whole = session.run(FakeProblem(MPI.COMM_SELF), scene(), shared_path / "b", quiet=True)
    comm.barrier()
    outcome = session.run(
        FakeProblem(comm), scene(), shared_path / "a", restart=shared_path / "a", quiet=True
    )
    if comm.rank == 0:
        assert outcome.diagnostics == pytest.approx(whole.diagnostics, rel=1e-12)


@pytest.mark.mpi
def test_two_checkpoints_are_kept(comm, shared_path):
    session.run(FakeProblem(comm), scene(output={"checkpoint_every": 3}), shared_path, quiet=True)
    if comm.rank == 0:
        names = sorted(path.name for path in (shared_path / "checkpoints").iterdir())
        assert names == ["step_000009.h5", "step_000010.h5"]


def flip(path, position: int) -> None:
    data = bytearray(path.read_bytes())
    data[position] ^= 1
    path.write_bytes(data)


DAMAGE = {
    "empty": lambda path: path.write_bytes(b""),
    "cut by one byte": lambda path: path.write_bytes(path.read_bytes()[:-1]),
    "cut in half": lambda path: path.write_bytes(path.read_bytes()[: path.stat().st_size // 2]),
    "longer": lambda path: path.write_bytes(path.read_bytes() + b"x"),
    "one bit at the end": lambda path: flip(path, -1),
    "one bit in the middle": lambda path: flip(path, path.stat().st_size // 2),
    "one bit of the digest": lambda path: flip(path, len(checkpoint.MARK)),
    "another file": lambda path: path.write_text("hello"),
    "no file": lambda path: path.unlink(),
}


@pytest.mark.parametrize("damage", DAMAGE)
def test_a_damaged_newest_checkpoint_is_told_and_the_one_before_is_used(comm, tmp_path, capsys, damage):
    settings = scene(output={"checkpoint_every": 3})
    session.run(FakeProblem(comm), settings, tmp_path / "whole", quiet=True)
    session.run(FakeProblem(comm), settings, tmp_path / "cut", quiet=True)
    newest = tmp_path / "cut" / "checkpoints" / "step_000010.h5"
    DAMAGE[damage](newest)
    capsys.readouterr()
    outcome = session.run(FakeProblem(comm), settings, tmp_path / "cut", restart=tmp_path / "cut", quiet=True)
    lines = capsys.readouterr().out.splitlines()
    assert outcome.steps == 10
    assert history(tmp_path / "cut") == history(tmp_path / "whole")
    if damage != "no file":
        assert lines.pop(0).startswith(f"{newest} ")
    assert lines[0] == f"restarted from {newest.with_name('step_000009.h5')}: step 9, time 0.9"
    checkpoint.load(newest)


def test_any_flipped_bit_is_noticed(tmp_path):
    path = tmp_path / "results" / "checkpoints" / "step_000001.h5"
    path.parent.mkdir(parents=True)
    checkpoint.save(path, {"u": np.arange(100.0)}, {"step": 1})
    good = path.read_bytes()
    pick = random.Random(0)
    # the padding between digest and HDF5 carries nothing
    positions = [p for p in range(len(good)) if not len(checkpoint.MARK) + 64 <= p < checkpoint.BLOCK]
    for position in pick.sample(positions, 200):
        path.write_bytes(good)
        flip(path, position)
        with pytest.raises(checkpoint.CheckpointError):
            checkpoint.load(path)


def test_a_checkpoint_gives_back_every_kind_of_array(tmp_path):
    path = tmp_path / "results" / "checkpoints" / "step_000001.h5"
    path.parent.mkdir(parents=True)
    state = {
        "a": np.random.default_rng(0).random((5, 3)),
        "group/b": np.arange(4, dtype=np.int32),
        "empty": np.zeros((0, 3)),
        "flags": np.array([True, False]),
        "number": np.array(3.0),
    }
    checkpoint.save(path, state, {"step": 1})
    found = checkpoint.load(path)
    assert list(found.state) == list(state)
    assert all(
        np.array_equal(found.state[n], state[n]) and found.state[n].dtype == state[n].dtype for n in state
    )
    with h5py.File(path) as file:
        assert file.userblock_size == checkpoint.BLOCK


@pytest.mark.mpi
def test_no_good_checkpoint_is_an_input_error(comm, shared_path):
    with pytest.raises(
        InputError, match="no checkpoint there; accepted is the results folder of an earlier run"
    ):
        session.run(
            FakeProblem(comm), scene(), shared_path / "new", restart=shared_path / "nowhere", quiet=True
        )
    session.run(FakeProblem(comm), scene(), shared_path / "old", quiet=True)
    if comm.rank == 0:
        DAMAGE["cut in half"](shared_path / "old" / "checkpoints" / "step_000010.h5")
    comm.barrier()
    with pytest.raises(InputError, match="no good checkpoint: .*step_000010.h5 is damaged or cut short"):
        session.run(FakeProblem(comm), scene(), shared_path / "old", restart=shared_path / "old", quiet=True)


@pytest.mark.mpi
def test_a_restart_names_the_key_that_was_changed(comm, shared_path):
    session.run(FakeProblem(comm), scene(), shared_path, quiet=True)
    with pytest.raises(InputError, match=r"stiffness \(was 40.0, is 41.0\); accepted are changes of output"):
        session.run(FakeProblem(comm), scene(stiffness=41.0), shared_path, restart=shared_path, quiet=True)
    with pytest.raises(InputError, match=r"analysis.integrator \(was backward_euler, is bdf2\)"):
        changed = scene(analysis={"type": "dynamic", "integrator": "bdf2"})
        session.run(FakeProblem(comm), changed, shared_path, restart=shared_path, quiet=True)


@pytest.mark.mpi
def test_a_restart_with_another_mesh_is_refused(comm, shared_path):
    session.run(FakeProblem(comm), scene(), shared_path, quiet=True)
    with pytest.raises(InputError, match="the mesh has been changed since"):
        session.run(FakeProblem(comm, n=4), scene(), shared_path, restart=shared_path, quiet=True)


@pytest.mark.mpi
def test_points_which_differ_by_rounding_are_the_same_mesh_and_moved_ones_are_not(comm, shared_path):
    """A distributed mesh gives its points back with errors of 1e-16 that depend on the number of ranks."""
    session.run(FakeProblem(comm), scene(), shared_path, quiet=True)
    problem = FakeProblem(comm)
    problem.points = problem.points + 2e-16
    outcome = session.run(problem, scene(), shared_path, restart=shared_path, quiet=True)
    assert outcome.status == "finished"
    problem.points = problem.points + 1e-6
    with pytest.raises(InputError, match="the mesh has been changed since"):
        session.run(problem, scene(), shared_path, restart=shared_path, quiet=True)


@pytest.mark.mpi
def test_a_restart_may_change_end_steps_output_and_expectations(comm, shared_path):
    session.run(FakeProblem(comm), scene(), shared_path, quiet=True)
    changed = scene(
        title="longer",
        analysis={"end_time": 1.5, "time_step": 0.05},
        output={"every": 0.5, "checkpoint_every": 1},
        expect={"time": {"value": 1.5}},
    )
    outcome = session.run(FakeProblem(comm), changed, shared_path, restart=shared_path, quiet=True)
    assert (outcome.status, outcome.exit_code, outcome.time) == ("finished", 0, 1.5)


@pytest.mark.mpi
def test_restarting_a_finished_run_changes_nothing(comm, shared_path):
    session.run(FakeProblem(comm), scene(), shared_path, quiet=True)
    before = history(shared_path) if comm.rank == 0 else []
    outcome = session.run(FakeProblem(comm), scene(), shared_path, restart=shared_path, quiet=True)
    assert (outcome.status, outcome.steps) == ("finished", 10)
    if comm.rank == 0:
        assert history(shared_path) == before
        assert json.loads((shared_path / "run.json").read_text())["steps"] == 10


def test_one_checkpoint_file_may_be_named_to_go_back_further(comm, tmp_path):
    settings = scene(output={"checkpoint_every": 3})
    session.run(FakeProblem(comm), settings, tmp_path / "a", quiet=True)
    older = tmp_path / "a" / "checkpoints" / "step_000009.h5"
    session.run(FakeProblem(comm), settings, tmp_path / "b", restart=older, quiet=True)
    assert history(tmp_path / "a") == history(tmp_path / "b")


def test_steps_since_a_frame_are_not_written_twice_after_a_restart(comm, tmp_path):
    """A run is cut between its last checkpoint and the end; rows and frames of the lost steps must go."""
    settings = scene(output={"checkpoint_every": 4})
    session.run(FakeProblem(comm), settings, tmp_path / "a", quiet=True)
    (tmp_path / "a" / "checkpoints" / "step_000010.h5").unlink()
    shorter = scene(output={"checkpoint_every": 4}, analysis={"end_time": 0.9})
    session.run(FakeProblem(comm), shorter, tmp_path / "a", restart=tmp_path / "a", quiet=True)
    assert [row["step"] for row in history(tmp_path / "a")] == list(range(10))
    assert len(list((tmp_path / "a" / "fields").iterdir())) == 10
    rows = read_table(tmp_path / "a" / "iterations.csv")[1]
    assert [row["total"] for row in rows] == list(range(1, 28))


@pytest.mark.parametrize("order", ["dolfinx, h5py", "h5py, dolfinx"])
def test_dolfinx_and_h5py_write_hdf5_in_one_process(launch, tmp_path, order):
    """They are linked with two different HDF5 libraries on Debian (with and without MPI)."""
    script = tmp_path / "both.py"
    script.write_text(f"""
import {order.split(", ")[0]}, {order.split(", ")[1]}
import h5py, numpy as np
from dolfinx import io, mesh
from mpi4py import MPI
square = mesh.create_unit_square(MPI.COMM_SELF, 2, 2)
for name in ("one", "two"):
    with io.XDMFFile(MPI.COMM_SELF, name + ".xdmf", "w") as file:
        file.write_mesh(square)
    with h5py.File(name + "_own.h5", "w") as file:
        file["a"] = np.arange(5.0)
    with h5py.File(name + ".h5") as file, h5py.File(name + "_own.h5") as own:
        assert list(file) == ["Mesh"] and own["a"][4] == 4.0
""")
    result = launch(0, script, cwd=tmp_path)
    assert result.returncode == 0, result.stderr
