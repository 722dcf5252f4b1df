"""What comes from outside: signals, kill -9, a full disk."""

import json
import os
import random
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from fake_problem import FakeProblem, scene

from extremal.app import checkpoint, session
from extremal.app.results import read_table

PROGRAM = Path(__file__).with_name("fake_problem.py")


def start(*arguments: object, ranks: int = 0) -> subprocess.Popen:
    mpirun = ["mpirun", "--oversubscribe", "-n", str(ranks)] if ranks else []
    command = [*mpirun, sys.executable, str(PROGRAM), *map(str, arguments)]
    # MPI has been started in this process and marked its environment, which would confuse another start
    environment = {
        key: value for key, value in os.environ.items() if not key.startswith(("OMPI_MCA", "PMIX", "PRTE"))
    }
    return subprocess.Popen(
        command,
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        stdin=subprocess.DEVNULL,
    )


def wait_for_rows(process: subprocess.Popen, folder: Path, rows: int) -> None:
    """Wait until history.csv has so many rows."""
    end = time.monotonic() + 30
    while not (folder / "history.csv").exists() or (folder / "history.csv").read_text().count("\n") <= rows:
        assert process.poll() is None, process.stdout.read()
        assert time.monotonic() < end
        time.sleep(0.005)


def without_wall(folder: Path) -> list[dict[str, float]]:
    rows = read_table(folder / "history.csv")[1]
    return [{name: value for name, value in row.items() if name != "wall"} for row in rows]


def assert_whole(folder: Path) -> None:
    """Every file that carries its final name must be complete."""
    json.loads((folder / "run.json").read_text())
    for path in checkpoint.list_checkpoints(folder):
        checkpoint.load(path)
    for path in (folder / "fields").glob("frame_*.vtu"):
        assert path.read_text().rstrip().endswith("</VTKFile>")
    for name in re.findall(r'file="([^"]+)"', (folder / "fields.pvd").read_text()):
        assert (folder / name).exists()


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT, signal.SIGUSR1])
def test_a_signal_ends_the_run_after_the_step_with_everything_saved(tmp_path, number):
    process = start(tmp_path, "--sleep", 0.01)
    wait_for_rows(process, tmp_path, 6)
    process.send_signal(number)
    output = process.communicate(timeout=30)[0]
    assert process.returncode == 3
    record = json.loads((tmp_path / "run.json").read_text())
    assert record["status"] == "stopped"
    assert record["reason"] == f"by {number.name} after step {record['steps']}"
    assert output.splitlines()[-1] == f"stopped {record['reason']}, results in {tmp_path}"
    assert checkpoint.step_of(checkpoint.list_checkpoints(tmp_path)[0]) == record["steps"] < 40
    assert without_wall(tmp_path)[-1]["step"] == record["steps"]


def test_batch_systems_can_stop_ranks_under_mpirun(tmp_path):
    """mpirun passes SIGUSR1 on to the ranks."""
    process = start(tmp_path, "--sleep", 0.01, ranks=2)
    wait_for_rows(process, tmp_path, 6)
    process.send_signal(signal.SIGUSR1)
    output = process.communicate(timeout=30)[0]
    assert process.returncode == 3, output
    record = json.loads((tmp_path / "run.json").read_text())
    assert record["reason"] == f"by SIGUSR1 after step {record['steps']}"
    assert checkpoint.step_of(checkpoint.list_checkpoints(tmp_path)[0]) == record["steps"]


@pytest.mark.mpi
def test_a_signal_to_one_rank_stops_all(comm, shared_path):
    class Signalled(FakeProblem):
        def advance(self, dt):
            if self.time > 0.35 and self.comm.rank == self.comm.size - 1:
                os.kill(os.getpid(), signal.SIGTERM)
            return super().advance(dt)

    handlers = [signal.getsignal(number) for number in (signal.SIGTERM, signal.SIGINT)]
    outcome = session.run(Signalled(comm), scene(), shared_path, quiet=True)
    assert (outcome.status, outcome.exit_code) == ("stopped", 3)
    assert outcome.reason == "by SIGTERM after step 5"
    assert handlers == [signal.getsignal(number) for number in (signal.SIGTERM, signal.SIGINT)]


def test_killed_at_random_moments_a_run_loses_only_the_steps_since_its_last_checkpoint(tmp_path):
    whole, cut = tmp_path / "whole", tmp_path / "cut"
    session.run(FakeProblem(session_comm()), forty(), whole, quiet=True)
    pick = random.Random(1)
    process = start(cut, "--n", 3)
    wait_for_rows(process, cut, 4)
    for _ in range(5):
        time.sleep(pick.uniform(0.0, 0.06))
        process.kill()
        process.communicate()
        assert_whole(cut)
        saved = checkpoint.list_checkpoints(cut)
        rows = without_wall(cut)
        assert rows == without_wall(whole)[: len(rows)]
        if saved:
            assert rows[-1]["step"] - checkpoint.step_of(saved[0]) <= 5
        process = start(cut, "--n", 3, *(["--restart"] if saved else []))
        wait_for_rows(process, cut, len(rows) if saved else 4) if len(rows) < 36 else None
        if process.poll() is not None or len(rows) >= 36:
            break
    output = process.communicate(timeout=30)[0]
    assert process.returncode == 0, output
    assert without_wall(cut) == without_wall(whole)
    first, second = (checkpoint.load(checkpoint.list_checkpoints(folder)[0]).state for folder in (whole, cut))
    assert all(np.array_equal(first[name], second[name]) for name in first)
    assert not list(cut.rglob(".*.partial"))


def session_comm():
    from mpi4py import MPI

    return MPI.COMM_SELF


def forty():
    return scene(analysis={"time_step": 0.025, "largest_step": 0.025}, output={"checkpoint_every": 4})


@pytest.fixture
def small_disk(tmp_path):
    """A file system of 400 kB."""
    place = tmp_path / "disk"
    place.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=400k", "tmpfs", str(place)]
    if os.geteuid() != 0 or subprocess.run(mount, capture_output=True).returncode != 0:
        pytest.skip("only root may make a small disk")
    yield place
    subprocess.run(["umount", "-l", str(place)], check=True)


def test_a_full_disk_ends_the_run_with_one_line_and_whole_files(small_disk):
    process = start(small_disk / "results", "--n", 6)
    lines = process.communicate(timeout=60)[0].splitlines()
    assert process.returncode == 3
    told = [line for line in lines if not line.startswith("step ")]
    assert len(told) == 1, lines
    assert re.fullmatch(
        r"failed: \S+/results/\S+: cannot be written: No space left on device \([\d,]+ bytes free\), "
        r"results in \S+",
        told[0],
    )
    assert_whole(small_disk / "results")
    assert not list((small_disk / "results").rglob(".*.partial"))


@pytest.mark.parametrize("filled", [399_000, 380_000, 340_000, 300_000])
def test_a_disk_that_is_nearly_full_from_the_start_breaks_no_file(small_disk, filled):
    (small_disk / "other").write_bytes(bytes(filled // 4096 * 4096))
    process = start(small_disk / "results", "--n", 6)
    output = process.communicate(timeout=60)[0]
    assert process.returncode in (2, 3), output
    assert "No space left on device" in output and "Traceback" not in output, output
    if (small_disk / "results" / "fields.pvd").exists():
        assert_whole(small_disk / "results")
