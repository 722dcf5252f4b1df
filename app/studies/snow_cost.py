"""`extremal study snow-cost`: what a step of snow costs per particle on one core, and what a second core brings.

A ball in whirling motion, so that it flows plastically everywhere, is advanced by steps of fixed length. The parts of a
step are those of its PETSc events; the time of one iteration of conjugate residuals is the difference between steps of
many and of few. In the same run the same particles are advanced by a neighbour, MLS-MPM in taichi. Then
`mpirun` runs a scene on one and on two ranks.
"""

from __future__ import annotations

import argparse
import csv
import sys
import tempfile
import time
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..errors import EXIT_FINISHED, InputError
from ._process import output_of, report_of
from ._table import aligned, machine, make_folder, petsc_options, write_rows

if TYPE_CHECKING:
    from mpi4py import MPI
    from numpy.typing import NDArray

    from extremal.mpm.law import Law
    from extremal.mpm.particles import Particles
    from extremal.mpm.problem import SnowProblem

CELL_SIZE = 0.005  # [m]
PER_CELL = 8
RADIUS = 0.104  # [m]: about 300,000 particles
COARSE = 4.0  # --quick: so many times fewer cells across
GRAVITY = (0.0, 0.0, -9.81)
EXPLICIT, IMPLICIT = 2e-5, 5e-4  # steps [s] at CELL_SIZE
FEW, MANY = 4, 16  # iterations between which one is measured
BATCH = 4  # steps between two looks at the clock, for both programs
PARTS = {
    "grid": "sort, numbering of nodes",
    "to_grid": "particles to grid",
    "force": "forces",
    "to_particles": "grid to particles",
    "flow": "deformation, plastic flow",
}
STEP = "explicit step"
NEIGHBOUR = Path(__file__).with_name("_taichi_mls_mpm.py")
TAICHI = Path("build/peers/taichi/bin/python")
COLUMNS = ("quantity", "particles", "ours_ns", "taichi_ns", "ratio", "note")
RANK_COLUMNS = ("step", "particles", "one_rank_ms", "two_ranks_ms", "speed_up")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare how often to repeat and where taichi is."""
    parser.add_argument("-o", "--output", metavar="DIR", type=Path, default=Path("results/snow-cost"))
    parser.add_argument("--repetitions", metavar="N", type=int, default=7, help="the best of N counts (7)")
    parser.add_argument(
        "--taichi", metavar="PYTHON", type=Path, default=TAICHI, help=f"an interpreter that has taichi ({TAICHI})"
    )
    parser.add_argument("--quick", action="store_true", help="5,000 particles, one repetition")


def run(args: argparse.Namespace, comm: MPI.Comm) -> int:
    """Measure, write cost.csv and ranks.csv and print both tables."""
    if comm.size > 1:
        raise InputError("study snow-cost: measures one core and starts mpirun itself; run it without mpirun")
    make_folder(args.output)
    coarse, repetitions = (COARSE, 1) if args.quick else (1.0, max(1, args.repetitions))
    rows = measure(comm, coarse, repetitions, args.taichi)
    write_rows(args.output / "cost.csv", COLUMNS, rows)
    print(machine())
    print(table(rows), flush=True)
    ranks = [on_two_ranks(kind, coarse, min(repetitions, 4)) for kind in (("explicit",) if args.quick else STEPS)]
    write_rows(args.output / "ranks.csv", RANK_COLUMNS, ranks)
    print(rank_table(ranks))
    print(args.output / "cost.csv", args.output / "ranks.csv", flush=True)
    return EXIT_FINISHED


def table(rows: list[dict[str, Any]]) -> str:
    """The rows as Markdown, notes below."""
    columns = ("ns per particle", "ours", "taichi", "ratio")
    out = [(row["quantity"], row["ours_ns"], row["taichi_ns"], row["ratio"]) for row in rows]
    notes = [row["note"] for row in rows if row["note"]]
    return "\n\n".join([f"{rows[0]['particles']} particles", aligned(columns, out), *notes])


def rank_table(rows: list[dict[str, Any]]) -> str:
    """The times on one and two ranks as Markdown."""
    columns = ("step", "particles", "1 rank [ms]", "2 ranks [ms]", "speed-up")
    return "\n" + aligned(columns, [tuple(row[key] for key in RANK_COLUMNS) for row in rows])


# ---------------------------------------------------------------------- one core


def measure(comm: MPI.Comm, coarse: float, repetitions: int, taichi: Path) -> list[dict[str, Any]]:
    """Nanoseconds per particle of an explicit step, its parts and one Krylov iteration; taichi's beside them."""
    from extremal.mpm.law import Law

    h, law, count = CELL_SIZE * coarse, Law(), BATCH * repetitions
    start = whirling_ball(h, law)
    n = len(start)
    problem = _problem(comm, start, h, law, beta=0.0)
    seconds = _steps(problem, EXPLICIT * coarse, count)
    step = min(seconds)
    energy = problem.diagnostics()["kinetic_energy"]
    theirs, note = _taichi(taichi, start, h, law, EXPLICIT * coarse, repetitions, energy)
    rows = [_row(STEP, n, step, note, theirs)]
    parts = _parts(problem, EXPLICIT * coarse, count)
    rows += [_row(f"- {what}", n, parts[name]) for name, what in PARTS.items()]
    rows.append(_row("- everything else", n, max(0.0, step - sum(parts.values()))))
    for precision in ("double", "single"):
        problem = _problem(comm, start, h, law, beta=1.0, precision=precision)
        _steps(problem, EXPLICIT * coarse, BATCH)  # the whirl has begun to flow
        best = {k: _fixed_iterations(problem, k, IMPLICIT * coarse, max(2, repetitions)) for k in (FEW, MANY)}
        rows.append(_row(f"one iteration, {precision} precision", n, (best[MANY] - best[FEW]) / (MANY - FEW)))
    return rows


def whirling_ball(h: float, law: Law) -> Particles:
    """A ball of snow with a velocity that varies over half its size, strained by a fortieth in ten steps."""
    import numpy as np

    from extremal.mpm.bodies import seed
    from extremal.mpm.particles import Particles
    from extremal.obstacles.shapes import Sphere

    x = seed(Sphere((0.0, 0.0, RADIUS), RADIUS), h, PER_CELL)
    velocity = 2.0 * np.sin(2 * np.pi / RADIUS * x[:, [1, 2, 0]])
    return Particles.at(x, law.density * h**3 / PER_CELL, velocity)


def _problem(comm: MPI.Comm, start: Particles, h: float, law: Law, **how: Any) -> SnowProblem:
    import numpy as np

    from extremal.mpm.problem import SnowProblem

    whole = start.take(np.arange(len(start)))
    return SnowProblem(comm, whole, [law], cell_size=h, gravity=GRAVITY, **how)


def _steps(problem: SnowProblem, dt: float, count: int) -> list[float]:
    """Seconds of the processor a step, averaged over each batch."""
    out = []
    for _ in range(max(1, count // BATCH)):
        began = time.process_time()
        for _ in range(BATCH):
            problem.advance(dt)
        out.append((time.process_time() - began) / BATCH)
    return out


class _Clock:
    """Stands in for a PETSc event, which is timed by the wall: seconds of the processor."""

    def __init__(self) -> None:
        self.seconds = 0.0

    def __enter__(self) -> None:
        self.seconds -= time.process_time()

    def __exit__(self, *_: object) -> None:
        self.seconds += time.process_time()


def _parts(problem: SnowProblem, dt: float, count: int) -> dict[str, float]:
    """Least seconds of the processor of each of PARTS in any of `count` steps."""
    events, least = problem._events, dict.fromkeys(PARTS, float("inf"))
    for _ in range(count):
        clocks = {name: _Clock() for name in PARTS}
        problem._events = {**events, **clocks}
        problem.advance(dt)
        least = {name: min(least[name], clock.seconds) for name, clock in clocks.items()}
    problem._events = events
    return least


def _fixed_iterations(problem: SnowProblem, iterations: int, dt: float, repetitions: int) -> float:
    """Least seconds of the processor of a step with that many Krylov iterations."""
    seconds = []
    with petsc_options("snow_", {"ksp_convergence_test": "skip", "ksp_max_it": iterations}):
        for _ in range(repetitions):
            began = time.process_time()
            problem.advance(dt)
            seconds.append(time.process_time() - began)
    return min(seconds)


def _row(quantity: str, n: int, seconds: float, note: str = "", theirs: float | None = None) -> dict[str, Any]:
    return {
        "quantity": quantity,
        "particles": n,
        "ours_ns": f"{seconds / n * 1e9:.1f}",
        "taichi_ns": "" if theirs is None else f"{theirs / n * 1e9:.1f}",
        "ratio": "" if theirs is None else f"{theirs / seconds:.2f}",
        "note": note,
    }


# ---------------------------------------------------------------------- the neighbour


def _taichi(
    python: Path, start: Particles, h: float, law: Law, dt: float, repetitions: int, energy: float
) -> tuple[float | None, str]:
    """Seconds of the processor of a step of taichi's, or None, and a sentence about it."""
    if not python.exists():
        return None, f"taichi: {python} is not there; `make bench` installs it"
    given = _for_taichi(start, h, law, dt, repetitions)
    with tempfile.TemporaryDirectory(prefix="extremal-") as folder:
        path = Path(folder) / "particles.npz"
        _save(path, given)
        report, words = report_of([str(python), str(NEIGHBOUR), str(path)])
    if report is None:
        return None, f"taichi: did not run: {words}"
    version, theirs = report["version"], report["kinetic_energy"]
    return report["seconds"], (
        f"taichi {version}: MLS-MPM, quadratic splines, single precision, one thread, the same particles in the same "
        f"order. Kinetic energy after {BATCH * repetitions} steps: {theirs:.4g} J, ours {energy:.4g} J."
    )


def _for_taichi(start: Particles, h: float, law: Law, dt: float, repetitions: int) -> dict[str, Any]:
    E, nu = law.young_modulus, law.poisson_ratio
    return {
        "position": start.position,
        "velocity": start.velocity,
        "mass": start.mass[0],
        "volume": start.mass[0] / law.density,
        "h": h,
        "dt": dt,
        "gravity": GRAVITY[2],
        "mu": E / (2 * (1 + nu)),
        "lambda": E * nu / ((1 + nu) * (1 - 2 * nu)),
        "hardening": law.hardening,
        "least": 1 - law.critical_compression,
        "largest": 1 + law.critical_stretch,
        "batch": BATCH,
        "repetitions": repetitions,
    }


def _save(path: Path, arrays: Mapping[str, NDArray[Any] | float]) -> None:
    """Write arrays as NPZ."""
    import numpy as np

    np.savez(path, **{name: np.asarray(values) for name, values in arrays.items()})


# ---------------------------------------------------------------------- two ranks

# β, step [s], steps
STEPS: dict[str, tuple[float, float, int]] = {"explicit": (0.0, EXPLICIT, 25), "implicit": (1.0, IMPLICIT, 8)}
SCENE = """\
part = "snow"
[grid]
cell_size = {h}
[[body]]
shape = "sphere"
center = [0, 0, {radius}]
radius = {radius}
velocity = [0, 0, -1]
per_cell = {per_cell}
[[collider]]
shape = "half_space"
point = [0, 0, 0]
normal = [0, 0, 1]
[gravity]
acceleration = [0, 0, -9.81]
[analysis]
end_time = {end}
time_step = {dt}
beta = {beta}
[output]
every = {end}
summary = false
"""


def on_two_ranks(kind: str, coarse: float, repetitions: int) -> dict[str, Any]:
    """Wall time of a step of `extremal snow` on one and two ranks, the best of several runs of a ball that lands."""
    beta, dt, count = STEPS[kind]
    h, dt = CELL_SIZE * coarse, dt * coarse
    text = SCENE.format(h=h, radius=RADIUS, per_cell=PER_CELL, end=dt * count, dt=dt, beta=beta)
    best, particles = {1: float("inf"), 2: float("inf")}, 0
    with tempfile.TemporaryDirectory(prefix="extremal-") as folder:
        scene = Path(folder) / "scene.toml"
        scene.write_text(text, encoding="utf-8")
        for repetition in range(repetitions):
            for ranks in best:
                results = Path(folder) / f"{ranks}-{repetition}"
                ours = [sys.executable, "-m", "extremal.app", "snow", str(scene), "-o", str(results), "--quiet"]
                words = output_of(["mpirun", "--oversubscribe", "-n", str(ranks), *ours])
                if not (results / "history.csv").exists():
                    note = (words.strip().splitlines() or ["mpirun said nothing"])[0]
                    return dict.fromkeys(RANK_COLUMNS, "") | {"step": f"{kind}: {note}"}
                with open(results / "history.csv", newline="", encoding="utf-8") as file:
                    history = list(csv.DictReader(file))
                # the first step measures volumes, which no other does
                first, last = history[1], history[-1]
                steps = int(last["step"]) - int(first["step"])
                best[ranks] = min(best[ranks], (float(last["wall"]) - float(first["wall"])) / steps)
                particles = int(float(last["particles"]))
    return {
        "step": kind,
        "particles": particles,
        "one_rank_ms": f"{best[1] * 1e3:.1f}",
        "two_ranks_ms": f"{best[2] * 1e3:.1f}",
        "speed_up": f"{best[1] / best[2]:.2f}" if best[2] > 0 else "",
    }
