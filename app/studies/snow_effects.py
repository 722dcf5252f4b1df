"""`extremal study snow-effects`: what each effect of snow costs, and that one which is off costs nothing.

A snowball lands on a wedge and the ground with everything on. Then effects are switched off one at a time. Seconds are
of the processor, for steps and for frames apart; memory is that of the particles' arrays, and by how much the process
grew at most. PETSc's events tell what ran.
"""

from __future__ import annotations

import argparse
import copy
import ctypes
import gc
import tempfile
import time
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..errors import EXIT_FINISHED, InputError
from ..parallel import on_root
from ..particles_output import openvdb
from ..snow_scene import GRADIENTS, PARTICLE_FIELDS
from ._snow_runs import scene_of, steps
from ._table import aligned, machine, make_folder, write_rows

if TYPE_CHECKING:
    from mpi4py import MPI

    from extremal.mpm.problem import SnowProblem

    from ..snow_scene import SnowScene

STEP = 5e-4  # [s]
FRAMES = 4  # while a run lasts
COARSE, FINE = 0.025, 0.0095  # cells [m]: 2,000 and 39,000 particles
EVERYTHING: dict[str, Any] = {
    "material": {"hardening": 10},
    "body": [
        {
            "shape": "sphere",
            "center": [0, 0, 0.32],
            "radius": 0.1,
            "velocity": [0, 0, -3],
            "shell": {"thickness": 0.03, "stiffness": 2},
            "noise": {"size": 0.05, "stiffness": 0.5},
        }
    ],
    "collider": [
        {"shape": "wedge", "apex": [0, 0, 0.2], "width": 0.12, "height": 0.2, "length": 0.5, "friction": 0.2},
        {"shape": "half_space", "point": [0, 0, 0], "normal": [0, 0, 1], "friction": 0.5},
    ],
    "gravity": {"acceleration": [0, 0, -9.81]},
    "analysis": {"time_step": STEP},
    "output": {"vdb": True, "fields": (*PARTICLE_FIELDS, *GRADIENTS)},
}
Changes = Mapping[tuple[str | int, ...], Any]  # where in the scene, and what stands there instead; None: nothing
FRICTIONLESS: Changes = {("collider", 0, "friction"): None, ("collider", 1, "friction"): None}
EXPLICIT: Changes = {("analysis", "beta"): 0}
NO_FRAMES, NO_VDB = "no frames", "no VDB"
SWITCHED: dict[str, Changes] = {
    "everything": {},
    "no hardening": {("material", "hardening"): 0},
    "no plasticity": {("material",): {"law": "fixed_corotated"}},
    "no shell, no noise": {("body", 0, "shell"): None, ("body", 0, "noise"): None},
    "no friction": FRICTIONLESS,
    "no colliders": {("collider",): None},
    "no gravity": {("gravity",): None},
    "explicit steps": EXPLICIT,
    "single precision operator": {("analysis", "precision"): "single"},
    "quadratic splines": {("grid", "spline"): "quadratic"},
    "no F_E, no F_P": {("output", "fields"): None},
    NO_VDB: {("output", "vdb"): None},
    "positions only": {("output", "fields"): []},
    NO_FRAMES: {},
    "elastic, explicit, nothing else": {
        ("material",): {"law": "fixed_corotated"},
        ("body", 0, "shell"): None,
        ("body", 0, "noise"): None,
        ("collider",): None,
        ("gravity",): None,
        ("output", "vdb"): None,
        ("output", "fields"): None,
        **EXPLICIT,
    },
}
QUICK = ("everything", "no colliders", "explicit steps", "no F_E, no F_P")
COLUMNS = (
    "run", "particles", "steps", "step_ns", "saved_ns", "krylov", "frame_ns", "array_bytes", "growth_bytes", "events",
    "missing",
)  # fmt: skip


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the folder of results, how often to repeat, and a short form."""
    parser.add_argument("-o", "--output", metavar="DIR", type=Path, default=Path("results/snow-effects"))
    parser.add_argument("--repetitions", metavar="N", type=int, default=3, help="the best of N counts (3)")
    parser.add_argument("--quick", action="store_true", help="four runs of 2,000 particles")


def run(args: argparse.Namespace, comm: MPI.Comm) -> int:
    """Run everything, then with an effect less (collective); write effects.csv and print the table."""
    from ..record import start_log

    on_root(comm, lambda: make_folder(args.output))
    start_log()
    names = list(QUICK if args.quick else SWITCHED)
    without = on_root(comm, _without_vdb)
    if without and NO_VDB in names:
        names.remove(NO_VDB)
    h, count, repetitions = (COARSE, 5, 1) if args.quick else (FINE, 40, max(1, args.repetitions))
    best = {name: measure(comm, name, COARSE, 2) for name in names}  # libraries are loaded, loops are compiled
    for repetition in range(repetitions):
        for name in names:
            row = measure(comm, name, h, count)
            best[name] = _better(best[name], row) if repetition else row
    rows = list(best.values())
    for row in rows:
        row["saved_ns"] = int(rows[0]["step_ns"]) - int(row["step_ns"])
        row["missing"] = " ".join(sorted(set(rows[0]["events"].split()) - set(row["events"].split())))
    on_root(comm, lambda: write_rows(args.output / "effects.csv", COLUMNS, rows))
    if comm.rank == 0:
        print(*filter(None, (machine(), without)), sep="\n")
        print(table(rows))
        print(args.output / "effects.csv", flush=True)
    return EXIT_FINISHED


def table(rows: list[dict[str, Any]]) -> str:
    """The rows as Markdown."""
    columns = (
        "", "step [ns]", "saved [ns]", "CR iterations", "frame [ns]", "arrays [bytes]", "growth [bytes]",
        "PETSc events that did not run",
    )  # fmt: skip
    keys = ("run", "step_ns", "saved_ns", "krylov", "frame_ns", "array_bytes", "growth_bytes", "missing")
    heading = f"{rows[0]['particles']} particles; times and bytes per particle"
    return "\n\n".join([heading, aligned(columns, [tuple(row[key] for key in keys) for row in rows])])


def scene(name: str, h: float, count: int) -> SnowScene:
    """The scene with what `name` switches off, `count` steps long."""
    tables = copy.deepcopy(EVERYTHING)
    tables["grid"] = {"cell_size": h}
    tables["analysis"]["end_time"] = count * STEP
    tables["output"]["every"] = count * STEP
    switched = dict(SWITCHED[name])
    if _without_vdb():
        switched["output", "vdb"] = None
    for where, value in switched.items():
        place: Any = tables
        for key in where[:-1]:
            place = place[key]
        if value is None:
            place.pop(where[-1])
        else:
            place[where[-1]] = value
    return scene_of(tables)


def _without_vdb() -> str:
    """Why there are no volumes; nothing where they can be written."""
    try:
        openvdb()
    except InputError as error:
        return str(error)
    return ""


def measure(comm: MPI.Comm, name: str, h: float, count: int) -> dict[str, Any]:
    """Run it (collective): nanoseconds and bytes per particle, all ranks together, and the events that ran."""
    from ..record import event_seconds

    what = scene(name, h, count)
    frames = 0 if name == NO_FRAMES else FRAMES
    folder = on_root(comm, lambda: tempfile.mkdtemp(prefix="extremal-"))
    events = event_seconds(comm)
    memory = _Memory()
    try:
        problem, stepping, drawing, krylov = _play(comm, what, Path(folder), count, frames)
    finally:
        on_root(comm, lambda: _remove(Path(folder)))
    n = comm.allreduce(len(problem.particles))
    own = sum(array.nbytes for array in problem.particles.arrays().values())
    step, frame, growth, arrays = (comm.allreduce(value) / n for value in (stepping, drawing, memory.growth(), own))
    after = event_seconds(comm)
    ran = [event for event, now in after.items() if now["calls"] > events.get(event, {"calls": 0})["calls"]]
    return {
        "run": name,
        "particles": n,
        "steps": len(krylov),
        "step_ns": f"{step / len(krylov) * 1e9:.0f}",
        "krylov": f"{sum(krylov) / len(krylov):.1f}",
        "frame_ns": f"{frame / frames * 1e9:.0f}" if frames else "",
        "array_bytes": f"{arrays:.0f}",
        "growth_bytes": f"{growth:.0f}",
        "events": " ".join(sorted(ran)),
    }


def _play(
    comm: MPI.Comm, what: SnowScene, folder: Path, count: int, frames: int
) -> tuple[SnowProblem, float, float, list[int]]:
    """Seconds of this rank's processor in steps with their diagnostics, and in frames; iterations of each step."""
    from ..output import Counts, Output
    from ..results import prepare
    from ..snow import snow_alone

    on_root(comm, lambda: prepare(folder, keep=False))
    problem = snow_alone(what, comm)
    counts = Counts()
    output = Output(problem, what.output, folder, counts)
    output.open(None, [], None)
    problem.advance(STEP / 10)  # it measures volumes, which no other does
    stepping, drawing, krylov, due = 0.0, 0.0, [], 1
    start, end = problem.time, count * STEP
    for step in steps(problem, STEP, end):
        counts.add({"krylov_iterations": step.krylov}, 0)
        began = time.process_time()
        output.row(step.dt, 0, 0.0, problem.diagnostics())
        stepping += step.seconds + time.process_time() - began
        krylov.append(step.krylov)
        while due <= frames and problem.time >= start + (end - start) * due / frames * (1 - 1e-9):
            began = time.process_time()
            output.frame()
            drawing += time.process_time() - began
            due += 1
    output.close()
    return problem, stepping, drawing, krylov


def _better(old: dict[str, Any], new: dict[str, Any]) -> dict[str, Any]:
    """The smaller of all that was measured."""
    measured = ("step_ns", "frame_ns", "growth_bytes")
    return new | {key: min(old[key], new[key], key=lambda text: float(text or 0)) for key in measured}


def _remove(folder: Path) -> None:
    import shutil

    shutil.rmtree(folder, ignore_errors=True)


class _Memory:
    """By how much this process grows, at most, from now on; it is Linux's files and glibc's heap that tell."""

    def __init__(self) -> None:
        gc.collect()
        # what was freed goes back to the system, and the record starts anew
        ctypes.CDLL(None).malloc_trim(0)
        Path("/proc/self/clear_refs").write_text("5")
        self._before = self._read("VmRSS")

    def growth(self) -> int:
        """Bytes."""
        return self._read("VmHWM") - self._before

    @staticmethod
    def _read(name: str) -> int:
        with open("/proc/self/status", encoding="ascii", errors="replace") as status:
            return next(int(line.split()[1]) * 1024 for line in status if line.startswith(f"{name}:"))
