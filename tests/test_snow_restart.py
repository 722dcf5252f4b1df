"""A run of snow that is killed or told to stop goes on to the very end it would have had."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from extremal.app import checkpoint
from extremal.app.results import read_table

SCENE = """
part = "snow"
[grid]
cell_size = 0.05
[[body]]
shape = "sphere"
center = [0, 0, 0.16]
radius = 0.12
per_cell = 8
velocity = [1, 0, -4]
[[collider]]
shape = "half_space"
point = [0, 0, 0]
normal = [0, 0, 1]
friction = 0.5
[gravity]
acceleration = [0, 0, -9.81]
[analysis]
end_time = 0.05
time_step = 5e-4
[output]
every = 0.01
checkpoint_every = 7
summary = false
"""


def command(folder: Path, ranks: int, *words: str) -> list[str]:
    mpirun = ["mpirun", "--oversubscribe", "--mca", "mpi_yield_when_idle", "1", "-n", str(ranks)] if ranks else []
    scene = str(folder.parent / "scene.toml")
    return [*mpirun, sys.executable, "-m", "extremal.app", "snow", scene, "-o", str(folder), "--quiet", *words]


def finish(folder: Path, ranks: int, *words: str) -> None:
    done = subprocess.run(command(folder, ranks, *words), capture_output=True, text=True, env=dict(os.environ))
    assert done.returncode == 0, done.stderr


def end(folder: Path, number: int, ranks: int) -> None:
    """Send a signal in the middle of a run: with mpirun to one rank."""
    process = subprocess.Popen(
        command(folder, ranks), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, env=dict(os.environ)
    )
    limit = time.monotonic() + 60
    while len(steps(folder)) < 20:
        assert process.poll() is None and time.monotonic() < limit
        time.sleep(0.002)
    pid = process.pid
    if ranks:
        pid = int(Path(f"/proc/{pid}/task/{pid}/children").read_text().split()[-1])
    os.kill(pid, number)
    assert process.wait(timeout=30) != 0


def steps(folder: Path) -> list[float]:
    path = folder / "history.csv"
    return [row["step"] for row in read_table(path)[1]] if path.exists() else []


def last(folder: Path) -> tuple[int, dict[str, np.ndarray]]:
    """Step and state of the newest checkpoint."""
    found = checkpoint.load(checkpoint.list_checkpoints(folder)[0])
    return found.facts["step"], found.state


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The results of a run that nobody disturbed."""
    folder = tmp_path_factory.mktemp("restart") / "whole"
    (folder.parent / "scene.toml").write_text(SCENE)
    finish(folder, 0)
    return folder


@pytest.mark.parametrize(
    ("number", "before", "after", "tolerance"),
    [
        (signal.SIGKILL, 0, 0, 1e-12),
        (signal.SIGTERM, 0, 0, 1e-12),
        (signal.SIGKILL, 0, 2, 1e-10),
        (signal.SIGTERM, 2, 0, 1e-10),
        (signal.SIGKILL, 2, 3, 1e-10),
    ],
)
def test_stopped_half_way_snow_ends_as_if_it_had_not_been(
    whole: Path, number: int, before: int, after: int, tolerance: float
) -> None:
    """To rounding; on another number of ranks sums are rounded in another order."""
    folder = whole.parent / f"{signal.Signals(number).name}_{before}_{after}"
    end(folder, number, before)
    made, (saved, _) = steps(folder)[-1], last(folder)
    assert made < 100
    # what SIGTERM ends is saved, what SIGKILL ends has lost the steps since its last checkpoint
    assert saved == made if number == signal.SIGTERM else 0 <= made - saved < 8
    finish(folder, after, "--restart")
    assert steps(folder) == steps(whole)
    (step, state), (last_step, reference) = last(folder), last(whole)
    assert step == last_step
    for name, values in reference.items():
        assert np.abs(state[name] - values).max() <= tolerance * np.abs(values).max(), name
    assert len(list((folder / "fields").iterdir())) == len(list((whole / "fields").iterdir()))
