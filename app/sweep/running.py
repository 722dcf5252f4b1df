"""Running points: each in a process of its own, kept where it has finished, never run twice."""

from __future__ import annotations

import json
import os
import shutil
import sys
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..results import PARTIAL, RECORD, write_text
from ..studies._process import limited
from ..studies._table import machine, make_folder
from .points import Point, plain

DONE, RUN, RESULT = "point.json", "run", "result.json"
Facts = dict[str, Any]


@dataclass(frozen=True)
class How:
    """How points are run.

    Attributes
    ----------
    folder : pathlib.Path
        Holds a folder for each point.
    jobs, ranks : int
        Points at once, and ranks of each; 0 ranks: without mpirun.
    timeout : float
        Of a run [s].
    repeat : int
        Runs of a point.
    """

    folder: Path
    jobs: int = 1
    ranks: int = 0
    timeout: float = 600.0
    repeat: int = 1


def run_points(points: Sequence[Point], how: How, say: Callable[[str], None]) -> list[Facts]:
    """Run what has not been run, and return what is known of each point, in their order."""
    make_folder(how.folder)

    def one(point: Point) -> Facts:
        known = read_point(how.folder / point.folder)
        if known is not None and not (known["status"] == "timeout" and known["seconds"] < how.timeout):
            say(f"{point}: kept")
            return known
        found = measure(point, how)
        say(f"{point}: {told(found)}")
        return found

    with ThreadPoolExecutor(how.jobs) as pool:
        try:
            return list(pool.map(one, points))
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise


def told(facts: Facts) -> str:
    """What became of a point, in a few words."""
    if facts["status"] != "finished":
        return f"{facts['status']}: {facts['reason']}"
    return f"{facts['seconds']:.3g} s, size {facts['size']}"


def read_point(folder: Path) -> Facts | None:
    """What is known of a point that has been run."""
    try:
        known: Facts = json.loads((folder / DONE).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return known


def measure(point: Point, how: How) -> Facts:
    """Run a point as often as wanted, the fastest run counts; write what is known of it, last of all."""
    place = how.folder / point.folder
    make_folder(place)
    for left in place.glob(f"*{PARTIAL}"):
        shutil.rmtree(left, ignore_errors=True)
    best: Facts = {}
    for _ in range(how.repeat):
        # a name of this process: what a killed one has left running must not write here
        partial = place / f"{RUN}.{os.getpid()}{PARTIAL}"
        found = _run(point, place, partial, how)
        if not best or found["seconds"] < best["seconds"]:
            best = found
            shutil.rmtree(place / RUN, ignore_errors=True)
            if partial.is_dir():
                partial.rename(place / RUN)
        if found["status"] != "finished":
            break
    best = {
        "method": point.method,
        "value": point.value,
        "settings": point.settings,
        "folder": point.folder,
        "ranks": max(1, how.ranks),
        **best,
        "machine": machine(),
    }
    write_text(place / DONE, json.dumps(best, indent=1, ensure_ascii=False) + "\n")
    return best


def _run(point: Point, place: Path, partial: Path, how: How) -> Facts:
    shutil.rmtree(partial, ignore_errors=True)
    launcher = ["mpirun", "--oversubscribe", "-n", str(how.ranks)] if how.ranks else []
    if point.part:
        scene = place / "scene.toml"
        write_text(scene, point.text)
        words = ["-m", "extremal.app", point.part, str(scene), "-o", str(partial), "--quiet"]
        result = partial / RECORD
    else:
        make_folder(partial)
        write_text(place / "case.json", point.text)
        result = partial / RESULT
        words = ["-m", "extremal.app.sweep.case", str(place / "case.json"), str(result)]
    code, said = limited([*launcher, sys.executable, *words], how.timeout)
    blank = {"seconds": how.timeout, "wall_seconds": how.timeout, "size": 0, "steps": 0, "iterations": {}, "memory": 0}
    if code is None:
        return {**blank, "status": "timeout", "reason": f"not finished after {plain(how.timeout)} s"}
    try:
        record = json.loads(result.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {**blank, "seconds": 0.0, "wall_seconds": 0.0, "status": "failed", "reason": _last_words(said, code)}
    return _facts(record, code)


def _last_words(said: str, code: int) -> str:
    """The line that says why a run ended; MPI adds lines of its own."""
    lines = [line for line in said.splitlines() if line.strip(" -*")]
    ours = [line.removeprefix("extremal: ") for line in lines if line.startswith("extremal: ")]
    return [f"exit code {code}", *lines[-1:], *ours[-1:]][-1]


def _facts(record: Facts, code: int) -> Facts:
    """What a run.json, or a case's result, says."""
    status = "finished" if record["status"] == "finished" and code == 0 else "failed"
    facts = {
        "status": status,
        "reason": "" if status == "finished" else record["reason"] or f"exit code {code}",
        "size": int(record["size"]),
        "steps": int(record["steps"]),
        "iterations": {k: int(v) for k, v in record["solver_iterations"].items() if k != "total"},
        "seconds": float(sum(record.get("run_cpu_seconds", [0.0]))),
        "wall_seconds": float(record["wall_seconds"]),
        "total_cpu_seconds": float(sum(record.get("cpu_seconds", [0.0]))),
        "memory": int(sum(record.get("peak_memory_bytes", [0]))),
        "versions": record["versions"],
    }
    return {**facts, "diagnostics": record["diagnostics"]} | (
        {"error": record["error"]} if "error" in record else {}
    )
