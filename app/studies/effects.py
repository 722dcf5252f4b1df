"""`extremal study effects`: what each effect of elasticity and of networks costs, as a ratio to the plain scene.

A bar is pulled in four load steps, and events on a network are reconstructed; then with one effect more at a time. Each
run is a process of its own; its seconds are of the processor, without the start of Python and its libraries. Snow has a
study of its own, snow-effects.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..errors import EXIT_FINISHED
from ..parallel import on_root
from ..scene_errors import literal
from ._process import output_of
from ._table import aligned, machine, make_folder, write_rows

if TYPE_CHECKING:
    from mpi4py import MPI

Tables = dict[str, Any]
PLAIN: dict[str, Tables] = {
    "elastic": {
        "mesh": {"shape": "bar", "size": [2, 1, 1], "cell_size": 0.1, "structured": True},
        "material": {"law": "neo_hookean", "young_modulus": 1e5, "poisson_ratio": 0.3, "extension": "none"},
        "fixed": [{"boundary": "left"}],
        "motion": [{"boundary": "right", "displacement": ["0.4*t", 0, 0]}],
        "analysis": {"end_time": 1, "time_step": 0.25, "largest_step": 0.25},
        "output": {"summary": False, "every": 1},
    },
    "hawkes": {
        "network": {"agents": 20},
        "simulation": {"count": 5000, "incomplete": 2000},
        "method": {"probabilities": "none"},
        "output": {"summary": False},
    },
}
DYNAMIC = {
    "analysis": {"type": "dynamic", "end_time": 1, "time_step": 0.25, "largest_step": 0.25},
    "material": {"density": 1000},
}
# a table of tables takes the place of the plain one, keys of a table are added to it
WITH: dict[str, dict[str, Tables]] = {
    "elastic": {
        "extension": {"material": {"extension": "c2"}},
        "gravity": {"gravity": {"acceleration": [0, 0, -9.81]}, "material": {"density": 1000}},
        "traction": {"traction": [{"boundary": "top", "value": [0, 0, 100]}]},
        "pressure": {"pressure": [{"boundary": "top", "value": 100}]},
        "inertia": DYNAMIC,
        "inertia, damping": {**DYNAMIC, "damping": {"stiffness": 0.01}},
        "second degree": {"element": {"degree": 2}},
        "custom law": {"material": {"law": "custom", "energy": "mu/2*(i1 - 3) - mu*log(J) + lam/2*log(J)**2"}},
        "frames each step": {"output": {"every": 0.25}},
    },
    "hawkes": {
        "mean_field": {"method": {"probabilities": "mean_field"}},
        "gibbs, 200 samples": {"method": {"probabilities": "gibbs", "samples": 200}},
        "estimation, 20 rounds": {"estimation": {"rounds": 20}},
    },
}
QUICK = {"elastic": ("gravity", "inertia"), "hawkes": ("mean_field",)}
COLUMNS = ("part", "scene", "size", "steps", "iterations", "seconds", "ratio", "megabytes", "events")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the folder of results, how often to repeat, and a short form."""
    parser.add_argument("-o", "--output", metavar="DIR", type=Path, default=Path("results/effects"))
    parser.add_argument("--repetitions", metavar="N", type=int, default=3, help="the best of N counts (3)")
    parser.add_argument("--quick", action="store_true", help="three effects, once")


def run(args: argparse.Namespace, comm: MPI.Comm) -> int:
    """Run all scenes (on rank 0); write effects.csv and print a table of each part."""
    on_root(comm, lambda: _run(args.output, 1 if args.quick else max(1, args.repetitions), args.quick))
    return EXIT_FINISHED


def _run(folder: Path, repetitions: int, quick: bool) -> None:
    make_folder(folder)
    rows = []
    for part, plain in PLAIN.items():
        wanted = {name: change for name, change in WITH[part].items() if not quick or name in QUICK[part]}
        scenes = {"plain": plain, **{name: with_change(plain, change) for name, change in wanted.items()}}
        measured = {name: measure(part, tables, repetitions) for name, tables in scenes.items()}
        for name, row in measured.items():
            row |= {"part": part, "scene": name, "ratio": f"{row['cpu'] / measured['plain']['cpu']:.2f}"}
            row["events"] = " ".join(sorted(row["ran"] - measured["plain"]["ran"]))
            rows.append({column: row[column] for column in COLUMNS})
    write_rows(folder / "effects.csv", COLUMNS, rows)
    print(machine())
    for part in PLAIN:
        shown = [tuple(row[column] for column in COLUMNS[1:]) for row in rows if row["part"] == part]
        print(f"\n{aligned(COLUMNS[1:], shown)}")
    print(folder / "effects.csv", flush=True)


def with_change(plain: Tables, change: Tables) -> Tables:
    """The scene with an effect more."""
    both = {**plain, **change}
    for key, table in change.items():
        if isinstance(table, dict) and key in plain:
            both[key] = {**plain[key], **table}
    return both


def measure(part: str, tables: Tables, repetitions: int) -> dict[str, Any]:
    """Run a scene and return what run.json tells, of the quickest run.

    Raises
    ------
    RuntimeError
        With what the run said, where it did not finish.
    """
    best: dict[str, Any] = {}
    for _ in range(repetitions):
        with tempfile.TemporaryDirectory(prefix="extremal-") as place:
            scene, out = Path(place) / "scene.toml", Path(place) / "out"
            lines = [f"{key} = {literal(table)}\n" for key, table in {"part": part, **tables}.items()]
            scene.write_text("".join(lines), encoding="utf-8")
            said = output_of([sys.executable, "-m", "extremal.app", part, str(scene), "-o", str(out), "--quiet"])
            try:
                record = json.loads((out / "run.json").read_text(encoding="utf-8"))
            except OSError:
                raise RuntimeError(said) from None
        if record["status"] != "finished":
            raise RuntimeError(said)
        cpu = float(record["run_cpu_seconds"][0])
        if not best or cpu < best["cpu"]:
            best = {
                "cpu": cpu,
                "seconds": f"{cpu:.2f}",
                "size": record["size"],
                "steps": record["steps"],
                "iterations": record["solver_iterations"]["total"],
                "megabytes": f"{record['peak_memory_bytes'][0] / 1e6:.0f}",
                "ran": set(record["events"]),
            }
    return best
