"""`extremal study snow-iterations`: Krylov iterations of an implicit step of 5e-4 s, against resolution and tolerance.

A ball that lands and a block that breaks over a wedge, in space and in the plane, from before contact until after it.
From one setting, cells, particles per cell and splines are changed one at a time. Only steps of nine tenths
of that length or more count.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..errors import EXIT_FINISHED
from ..parallel import on_root
from ._snow_runs import scene_of, steps
from ._table import aligned, machine, make_folder, petsc_options, write_rows

if TYPE_CHECKING:
    from mpi4py import MPI

STEP = 5e-4  # [s]
END = 0.03  # [s]
FULL = 0.9  # of STEP: hardened snow on a fine grid asks for slightly less
TOLERANCES = (1e-2, 1e-3, 1e-4)
CELL_SIZES = (0.02, 0.01, 0.005)  # [m]
PER_CELL = (4, 8, 16)
SPLINES = ("cubic", "quadratic")
COLUMNS = (
    "scene", "dimension", "cell_size", "per_cell", "spline", "rtol", "particles", "steps", "full_steps", "mean",
    "largest",
)  # fmt: skip


@dataclass(frozen=True)
class Setting:
    """What is varied."""

    scene: str
    dimension: int
    cell_size: float = 0.01  # [m]
    per_cell: int = 8
    spline: str = "cubic"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the folder of results and a short form."""
    parser.add_argument("-o", "--output", metavar="DIR", type=Path, default=Path("results/snow-iterations"))
    parser.add_argument("--quick", action="store_true", help="in the plane, two coarse grids, ten steps")


def run(args: argparse.Namespace, comm: MPI.Comm) -> int:
    """Run all settings (collective), write iterations.csv and print the table."""
    on_root(comm, lambda: make_folder(args.output))
    rows: list[dict[str, Any]] = []
    for setting in settings(args.quick):
        for rtol in TOLERANCES[:2] if args.quick else TOLERANCES:
            rows.append(count(comm, setting, rtol, 10 * STEP if args.quick else END))
            on_root(comm, lambda: write_rows(args.output / "iterations.csv", COLUMNS, rows))
    if comm.rank == 0:
        print(machine())
        print(table(rows))
        print(args.output / "iterations.csv", flush=True)
    return EXIT_FINISHED


def settings(quick: bool) -> Iterator[Setting]:
    """All that is run."""
    for dimension in (2,) if quick else (2, 3):
        for scene in SCENES:
            usual = Setting(scene, dimension)
            if quick:
                yield from (replace(usual, cell_size=h) for h in (0.04, 0.02))
                continue
            yield from (replace(usual, cell_size=h) for h in CELL_SIZES)
            yield from (replace(usual, per_cell=k) for k in PER_CELL if k != usual.per_cell)
            yield from (replace(usual, spline=spline) for spline in SPLINES if spline != usual.spline)


def count(comm: MPI.Comm, setting: Setting, rtol: float, end: float) -> dict[str, Any]:
    """Mean and largest number of iterations in the steps of full length (collective)."""
    from ..snow import snow_alone

    with petsc_options("snow_", {"ksp_rtol": rtol}):
        problem = snow_alone(scene_of(SCENES[setting.scene](setting, end)), comm)
        made = list(steps(problem, STEP, end))
    full = [step.krylov for step in made if step.dt >= FULL * STEP]
    return {
        **vars(setting),
        "rtol": f"{rtol:g}",
        "particles": comm.allreduce(len(problem.particles)),
        "steps": len(made),
        "full_steps": len(full),
        "mean": f"{sum(full) / len(full):.1f}" if full else "",
        "largest": max(full, default=""),
    }


def table(rows: list[dict[str, Any]]) -> str:
    """A line for each setting, a column for each tolerance: mean / largest."""
    tolerances = list(dict.fromkeys(row["rtol"] for row in rows))
    lines: dict[tuple[object, ...], list[str]] = {}
    for row in rows:
        where = "in the plane" if row["dimension"] == 2 else "in space"
        key = (f"{row['scene']} {where}", row["cell_size"], row["per_cell"], row["spline"], row["particles"])
        lines.setdefault(key, []).append(_cell(row))
    columns = ("", "h [m]", "per cell", "splines", "particles", *(f"rtol {rtol}" for rtol in tolerances))
    return aligned(columns, [(*key, *cells) for key, cells in lines.items()])


def _cell(row: dict[str, Any]) -> str:
    """Mean / largest; in brackets the share of the steps that were long enough to count, if not all."""
    short = int(row["steps"]) - int(row["full_steps"])
    share = f" ({100 * row['full_steps'] // row['steps']}%)" if short > 0 else ""
    return f"{row['mean']} / {row['largest']}{share}"


def _drop(setting: Setting, end: float) -> dict[str, Any]:
    """A ball of 10 cm lands on the ground at 2 m/s."""
    d = setting.dimension
    up, ground = _up(d, 1.0), _up(d, 0.0)
    ball = {"shape": "sphere", "center": _up(d, 0.12), "radius": 0.1, "velocity": _up(d, -2.0)}
    return _tables(setting, end, ball, [{"shape": "half_space", "point": ground, "normal": up, "friction": 0.5}])


def _wedge(setting: Setting, end: float) -> dict[str, Any]:
    """A block of 30 cm x 10 cm falls on a wedge at 2 m/s."""
    d = setting.dimension
    low, high = ([-0.15, 0.22], [0.15, 0.32]) if d == 2 else ([-0.15, -0.05, 0.22], [0.15, 0.05, 0.32])
    block = {"shape": "box", "low": low, "high": high, "velocity": _up(d, -2.0)}
    wedge = {"shape": "wedge", "apex": _up(d, 0.2), "width": 0.12, "height": 0.2, "friction": 0.2}
    return _tables(setting, end, block, [wedge if d == 2 else {**wedge, "length": 0.5}])


def _tables(setting: Setting, end: float, body: dict[str, Any], colliders: list[dict[str, Any]]) -> dict[str, Any]:
    return {
        "grid": {"cell_size": setting.cell_size, "spline": setting.spline, "dimension": setting.dimension},
        "body": [{**body, "per_cell": setting.per_cell}],
        "collider": colliders,
        "gravity": {"acceleration": _up(setting.dimension, -9.81)},
        "analysis": {"end_time": end, "time_step": STEP},
        "output": {"every": end},
    }


def _up(d: int, value: float) -> list[float]:
    return [0.0] * (d - 1) + [value]


SCENES = {"drop": _drop, "wedge": _wedge}
