"""Feeds malformed inputs to the real entry point: `python tests/fuzz.py FIRST LAST [--run EVERY] [--start]`.

A worker handles one input after the other, each in a folder of its own, and tells a line of JSON about each. The
parent watches it: an input that takes too long or kills the worker is put down as such, and a new worker goes on
with the next. With --start every input has a process of its own, as a person would start it.
"""

from __future__ import annotations

import argparse
import contextlib
import csv
import json
import math
import os
import resource
import select
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any
from unittest import mock

import fuzz_inputs

MEMORY = 6 << 30  # [bytes] of address space: nothing here may need as much
PATIENCE = 60.0  # [s] for one input, on a busy machine
PREFIX = "extremal: "


@dataclass
class Finding:
    """What became of an input: "refused", "valid", "ran", "stopped", or a fault and what shows it."""

    number: int
    kind: str
    verdict: str
    words: str = ""

    @property
    def is_fault(self) -> bool:
        """Whether this must not happen."""
        return self.verdict not in ("refused", "valid", "ran", "stopped")


def fuzz(numbers: range, every: int = 0, start: bool = False) -> list[Finding]:
    """Findings about all inputs of `numbers`; each `every`th valid one that is small enough is run as well."""
    found: list[Finding] = []
    begin = numbers.start
    while begin < numbers.stop:
        for finding in _watched(begin, numbers.stop, every, start):
            found.append(finding)
            begin = finding.number + 1
    return found


def counted(found: Sequence[Finding]) -> str:
    """As a person reads it."""
    counts = {what: sum(f.verdict == what for f in found) for what in ("refused", "valid", "ran", "stopped")}
    faults = [f for f in found if f.is_fault]
    ways = ", ".join(f"{sum(f.verdict == w for f in faults)} {w}" for w in dict.fromkeys(f.verdict for f in faults))
    run = counts["ran"] + counts["stopped"]
    valid = counts["valid"] + run
    return (
        f"{len(found):,} inputs: {counts['refused']:,} refused, {valid:,} valid, {run:,} of them run for two steps "
        f"({counts['stopped']:,} ended by their solver), {ways or '0 tracebacks, hangs, nan or half-written folders'}"
    )


def _watched(first: int, last: int, every: int, start: bool) -> Iterator[Finding]:
    """Findings of one worker; the last one is of the input at which it died or hung, if any."""
    command = [sys.executable, __file__, str(first), str(last), "--run", str(every), *(["--start"] if start else [])]
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "MPLBACKEND": "Agg"}
    said = tempfile.TemporaryFile()
    worker = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=said, stdin=subprocess.DEVNULL, env=environment)
    assert worker.stdout is not None
    number = first
    try:
        while number < last:
            # a first input waits for libraries
            ready = select.select([worker.stdout], [], [], PATIENCE * (2 if number == first else 1))[0]
            line = worker.stdout.readline() if ready else b""
            if not line:
                worker.kill()
                said.seek(0)
                verdict = "dead" if ready else "hung"
                yield Finding(
                    number, fuzz_inputs.make(number).kind, verdict, said.read().decode(errors="replace")[-2000:]
                )
                return
            finding = Finding(**json.loads(line))
            number = finding.number + 1
            yield finding
    finally:
        worker.kill()
        worker.wait()


# ------------------------------------------------------------------ the worker


def main() -> None:
    """Be the worker."""
    parser = argparse.ArgumentParser()
    parser.add_argument("first", type=int)
    parser.add_argument("last", type=int)
    parser.add_argument("--run", type=int, default=0)
    parser.add_argument("--start", action="store_true")
    options = parser.parse_args()
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    told = os.fdopen(os.dup(1), "w")
    with tempfile.TemporaryDirectory(prefix="extremal-fuzz-") as place:
        for number in range(options.first, options.last):
            folder = Path(place) / str(number)
            folder.mkdir()
            os.chdir(folder)
            runs = options.run > 0 and number % options.run == 0
            print(json.dumps(asdict(_one(number, folder, runs, options.start))), file=told, flush=True)
            os.chdir(place)
            shutil.rmtree(folder, ignore_errors=True)


def _one(number: int, folder: Path, runs: bool, start: bool) -> Finding:
    what = fuzz_inputs.make(number)
    for name, data in what.files.items():
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_bytes(data)
    call = _started if start else _called
    finding = Finding(number, what.kind, *_judged(what.words, *call(what.words, False), folder, what))
    if finding.verdict == "valid" and runs and what.runnable and (words := _shortened(folder)):
        verdict, why = _ran(words, *call(words, True), folder)
        finding = Finding(number, what.kind, verdict, why)
    return finding


def _judged(words: list[str], code: int, out: str, err: str, folder: Path, what: fuzz_inputs.Input) -> tuple[str, str]:
    told = f"{words}\ncode {code}\n{out[-1500:]}{err[-1500:]}"
    if "Traceback" in out + err:
        return "traceback", told
    if code not in (0, 2):
        return f"status {code}", told
    left = sorted(p.name for p in folder.rglob("*") if p.is_file() and str(p.relative_to(folder)) not in what.files)
    if code == 0:
        return ("half-written", f"{told}\n{left}") if any("partial" in name for name in left) else ("valid", "")
    lines = [line for line in err.splitlines() if line]
    if not lines or not all(line.startswith(PREFIX) for line in lines):
        return "not one line per error", told
    if what.kind != "words":
        names = (*what.files, words[1])
        if not all(any(name in line for name in names) for line in lines):
            return "no file named", told
    if left:
        return "half-written", f"{told}\n{left}"
    return "refused", ""


def _called(words: list[str], runs: bool) -> tuple[int, str, str]:
    """Exit code, stdout and stderr of the entry point, in this process."""
    from petsc4py import PETSc

    from extremal.app import cli, run_command, study_command

    database = PETSc.Options()
    before = set(database.getAll())
    if not runs:
        run_command._solve = lambda *_: 0  # type: ignore[assignment]
        study_command.run = lambda *_: 0  # type: ignore[assignment]
    try:
        with _listened() as said:
            try:
                code = cli.main(words)
            except SystemExit as end:
                code = int(end.code or 0)
    finally:
        run_command._solve, study_command.run = _SOLVE, _STUDY
        for name in set(database.getAll()) - before:
            database.delValue(name)
    return code, *said


def _started(words: list[str], runs: bool) -> tuple[int, str, str]:
    """The same of a process of its own; what cannot be given to one is left out."""
    words = [word.replace("\x00", "") for word in words]
    command = [sys.executable, "-m", "extremal.app", *words]
    try:
        done = subprocess.run(command, capture_output=True, timeout=PATIENCE * 0.8, stdin=subprocess.DEVNULL)
    except subprocess.TimeoutExpired:
        return -1, "", "took too long"
    return done.returncode, done.stdout.decode(errors="replace"), done.stderr.decode(errors="replace")


@contextlib.contextmanager
def _listened() -> Iterator[list[str]]:
    """What is written to stdout and stderr, by libraries too, once the context has ended."""
    said: list[str] = []
    kept = [os.dup(number) for number in (1, 2)]
    with tempfile.TemporaryFile() as out, tempfile.TemporaryFile() as err:
        for number, file in ((1, out), (2, err)):
            os.dup2(file.fileno(), number)
        try:
            yield said
        finally:
            for stream in (sys.stdout, sys.stderr):
                stream.flush()
            for number, old in zip((1, 2), kept):
                os.dup2(old, number)
                os.close(old)
            for file in (out, err):
                file.seek(0)
                said.append(file.read().decode(errors="replace"))


# ------------------------------------------------------------------ a short run


def _shortened(folder: Path) -> list[str] | None:
    """The command that runs the scene of a folder for two steps; None of a scene too large for that."""
    from extremal.app.cost import estimate
    from extremal.app.errors import InputError
    from extremal.app.scene import read_scene, read_toml
    from extremal.hawkes.events import DataError
    from extremal.meshes import MeshError

    scene = read_scene("scene.toml")
    tables = dict(read_toml(Path("scene.toml")))
    try:
        with mock.patch("extremal.meshes.gmsh_model.LARGEST", 20_000):
            expected = estimate(scene)
    except (InputError, MeshError, DataError):
        return None
    if expected.seconds_per_step > 1 or expected.seconds_before > 5 or expected.bytes > 1e9:
        return None
    if scene.part == "hawkes":
        for table, key, most in (("estimation", "rounds", 3), ("method", "samples", 20)):
            if key in tables.get(table, {}):
                tables[table] = {**tables[table], key: min(tables[table][key], most)}
    else:
        dt = scene.analysis.time_step
        given = tables.get("analysis", {})
        tables["analysis"] = {**given, "end_time": 2 * dt, "time_step": dt, "smallest_step": dt / 2, "largest_step": dt}
        tables["output"] = {k: v for k, v in tables.get("output", {}).items() if k != "every"}
    if scene.part == "elastic":
        tables["solver"] = {**tables.get("solver", {}), "iterations": 10}
    Path("run.toml").write_text(fuzz_inputs._written(tables))
    return [scene.part, "run.toml", "-o", "out", "--quiet"]


def _ran(words: list[str], code: int, out: str, err: str, folder: Path) -> tuple[str, str]:
    scene = (folder / "scene.toml").read_text(errors="replace")[-1500:]
    told = f"{words}\ncode {code}\n{out[-1500:]}{err[-1500:]}\n{scene}"
    if "Traceback" in out + err:
        return "traceback in a run", told
    if code not in (0, 2, 3):
        return f"status {code} of a run", told
    if list(folder.rglob("*.partial")):
        return "half-written", told
    if code == 2:
        if (folder / "out").exists() and any((folder / "out").iterdir()):
            return "half-written", told
        return "refused", ""
    failed = json.loads((folder / "out" / "run.json").read_text())["status"] == "failed"
    strange = [name for name, value in _numbers(folder / "out", failed) if not math.isfinite(value)]
    if strange:
        return "not a number", f"{strange[:3]}\n{told}"
    return ("stopped" if failed else "ran"), ""


def _numbers(folder: Path, failed: bool) -> Iterator[tuple[str, float]]:
    """Every number of the tables of a run, less those that may be no finite ones.

    Standard errors are infinite where the events say nothing of a parameter; the iterations of a solve that failed show
    where it did. People may be called "inf" or "nan".
    """
    for path in folder.glob("*.csv"):
        if path.name == "parameters.csv" or (failed and path.name == "iterations.csv"):
            continue
        with open(path, newline="") as file:
            for row in csv.DictReader(file):
                for column, text in row.items():
                    if not column.endswith(("first", "second")):
                        with contextlib.suppress(ValueError):
                            yield f"{path.name}: {column} of {row}", float(text)


def _originals() -> tuple[Any, Any]:
    from extremal.app import run_command, study_command

    return run_command._solve, study_command.run


if __name__ == "__main__":
    _SOLVE, _STUDY = _originals()
    main()
