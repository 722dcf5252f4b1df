"""Small scenes of each part that take a second or two, and how to start, stop and compare their runs."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import time
from pathlib import Path

import numpy as np

from extremal.app import checkpoint
from extremal.app.results import read_table

SCENES = {
    "elastic": """
[mesh]
shape = "box"
size = [1, 1, 1]
cell_size = 0.5
structured = true
[material]
law = "neo_hookean"
young_modulus = 1e5
poisson_ratio = 0.3
density = 1000
extension = "c2"
[[fixed]]
boundary = "left"
[initial]
velocity = ["0", "3*x", "-2*x*y"]
[analysis]
type = "dynamic"
integrator = "bdf2"
end_time = 0.4
time_step = 0.005
[output]
every = 0.02
checkpoint_every = 5
summary = false
""",
    "snow": """
part = "snow"
[grid]
cell_size = 0.05
[[body]]
shape = "sphere"
center = [0, 0, 0.16]
radius = 0.12
per_cell = 6
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
""",
    "hawkes": """
part = "hawkes"
[network]
agents = 6
[simulation]
count = 1500
incomplete = 500
[estimation]
rounds = 60
[output]
checkpoint_every = 5
summary = false
""",
}
# a restarted run on as many ranks as before repeats every operation; on others sums are rounded in another order
REPEATED = 1e-12


def command(part: str, folder: Path, ranks: int = 0, *words: str) -> list[str]:
    """What runs the part's scene into a folder; 0 ranks: without mpirun."""
    mpirun = ["mpirun", "--oversubscribe", "--mca", "mpi_yield_when_idle", "1", "-n", str(ranks)] if ranks else []
    scene = folder.parent / f"{part}.toml"
    if not scene.exists():
        scene.write_text(SCENES[part])
    return [*mpirun, sys.executable, "-m", "extremal.app", part, str(scene), "-o", str(folder), "--quiet", *words]


def finish(part: str, folder: Path, ranks: int = 0, *words: str) -> Path:
    """Run to the end."""
    done = subprocess.run(
        command(part, folder, ranks, *words), capture_output=True, text=True, timeout=240, env=dict(os.environ)
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return folder


def start(part: str, folder: Path, ranks: int = 0, *words: str) -> subprocess.Popen[bytes]:
    """Begin a run."""
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL, "stdin": subprocess.DEVNULL}
    return subprocess.Popen(command(part, folder, ranks, *words), env=dict(os.environ), **quiet)  # type: ignore


def wait_for_step(process: subprocess.Popen[bytes], folder: Path, step: int) -> bool:
    """Wait until history.csv tells of a step; False where the run has ended before."""
    limit = time.monotonic() + 120
    while last_row(folder) < step:
        if process.poll() is not None:
            return False
        assert time.monotonic() < limit, "the run makes no steps"
        time.sleep(0.001)
    return True


def last_row(folder: Path) -> int:
    """Number of the last step in history.csv, -1 without any."""
    path = folder / "history.csv"
    if not path.exists():
        return -1
    text = path.read_text()
    rows = text[: text.rfind("\n") + 1].splitlines()[1:]
    return int(rows[-1].split(",")[0]) if rows else -1


def last_state(folder: Path) -> tuple[int, dict[str, np.ndarray]]:
    """Step and state of the newest checkpoint."""
    found = checkpoint.load(checkpoint.list_checkpoints(folder)[0])
    return found.facts["step"], found.state


def difference(folder: Path, whole: Path) -> float:
    """Largest difference of two final states, relative to the largest value of each array."""
    (step, state), (last, reference) = last_state(folder), last_state(whole)
    assert step == last and set(state) == set(reference)
    worst = 0.0
    for name, values in reference.items():
        assert state[name].shape == values.shape, name
        if values.size:
            apart = np.abs(state[name].astype(float) - values.astype(float)).max()
            worst = max(worst, float(apart) / (float(np.abs(values.astype(float)).max()) or 1.0))
    return worst


def fingerprint(folder: Path) -> dict[str, list[float]]:
    """Of each array of the final state its length as a vector, and a sum in which every number counts otherwise."""
    state = last_state(folder)[1]
    numbers = {name: np.ravel(values).astype(float) for name, values in state.items() if values.dtype.kind == "f"}
    return {
        name: [float(np.linalg.norm(values)), float(values @ np.cos(np.arange(values.size)))]
        for name, values in numbers.items()
    }


def assert_same_run(folder: Path, whole: Path, tolerance: float = REPEATED) -> None:
    """The same final state, the same steps in history.csv, no frame too few or too many, nothing unfinished."""
    assert difference(folder, whole) <= tolerance
    rows = [[row["step"] for row in read_table(place / "history.csv")[1]] for place in (folder, whole)]
    assert rows[0] == rows[1]
    frames = [sorted(path.name for path in (place / "fields").iterdir()) for place in (folder, whole)]
    assert frames[0] == frames[1]
    assert json.loads((folder / "run.json").read_text())["status"] == "finished"
    assert_whole(folder)
    assert not list(folder.rglob("*.partial"))


def assert_whole(folder: Path) -> None:
    """Every file that carries its final name is complete."""
    if (folder / "run.json").exists():
        json.loads((folder / "run.json").read_text())
    for path in checkpoint.list_checkpoints(folder):
        checkpoint.load(path)
    for path in (folder / "fields").glob("frame_*.vtu"):
        assert path.read_text(errors="replace").rstrip().endswith("</VTKFile>"), path
    if (folder / "fields.pvd").exists():
        for name in re.findall(r'file="([^"]+)"', (folder / "fields.pvd").read_text()):
            assert (folder / name).exists(), name
