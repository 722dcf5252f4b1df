"""`run.json`: what was run, with what, at what cost, and how it ended."""

from __future__ import annotations

import csv
import datetime
import importlib.metadata
import json
import math
import platform
import resource
import sys
import tempfile
import time
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .expectations import Expectation
from .parallel import on_root
from .results import RECORD, write_text

if TYPE_CHECKING:
    from mpi4py import MPI


def versions() -> dict[str, str]:
    """Return the versions of what the run used; nothing is imported for it."""
    from mpi4py import MPI
    from petsc4py import PETSc

    found = {
        "extremal": _version("extremal"),
        "python": platform.python_version(),
        "numpy": _version("numpy"),
        "petsc": ".".join(str(number) for number in PETSc.Sys.getVersion()),
        "petsc4py": _version("petsc4py"),
        "mpi": MPI.Get_library_version().split("\n")[0].split(",")[0].strip("\0 "),
    }
    for name in ("dolfinx", "gmsh", "numba", "meshio"):
        if name in sys.modules:
            found[name] = str(getattr(sys.modules[name], "__version__", "")) or _version(name)
    return found


def _version(name: str) -> str:
    try:
        return importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return str(getattr(sys.modules.get(name), "__version__", "unknown"))


def petsc_options() -> dict[str, str]:
    """Return the PETSc options in force."""
    from petsc4py import PETSc

    return dict(PETSc.Options().getAll())


def start_log() -> None:
    """Let PETSc count calls and seconds from here on, as -log_view does."""
    from petsc4py import PETSc

    PETSc.Log.begin()


def event_seconds(comm: MPI.Comm) -> dict[str, dict[str, float]]:
    """Return calls and seconds (largest of all ranks) of our PETSc log events and stages (collective).

    Ours have a colon in their names ("elastic:residual"); a stage is listed as "stage NAME".
    """
    from mpi4py import MPI
    from petsc4py import PETSc

    # PETSc's log belongs to the world: newer versions wait for all of it
    if MPI.Comm.Compare(comm, PETSc.COMM_WORLD.tompi4py()) not in (MPI.IDENT, MPI.CONGRUENT):
        return {}
    # petsc4py cannot list events; PETSc's own table can be had as text only
    place = on_root(comm, lambda: tempfile.mkdtemp(prefix="extremal-"))
    path = Path(place) / "log.csv"
    viewer = PETSc.Viewer().createASCII(str(path), comm=comm)
    viewer.pushFormat(PETSc.Viewer.Format.ASCII_CSV)
    PETSc.Log.view(viewer)
    viewer.popFormat()
    viewer.destroy()
    if comm.rank != 0:
        return {}
    table = _read_log(path)
    path.unlink()
    path.parent.rmdir()
    return table


def _read_log(path: Path) -> dict[str, dict[str, float]]:
    per_rank: dict[tuple[str, str], list[float]] = {}
    with open(path, newline="") as file:
        for row in csv.DictReader(file):
            stage, event = row["Stage Name"], row["Event Name"]
            name = f"stage {stage}" if event == "summary" else event
            count, seconds = float(row["Count"]), float(row["Time"])
            if ":" in name and (count or seconds):
                # an event may run in several stages
                total = per_rank.setdefault((name, row["Rank"]), [0.0, 0.0])
                total[0] += count
                total[1] += seconds
    table: dict[str, dict[str, float]] = {}
    for (name, _), (count, seconds) in per_rank.items():
        before = table.get(name, {"calls": 0, "seconds": 0.0})
        table[name] = {"calls": max(before["calls"], int(count)), "seconds": max(before["seconds"], seconds)}
    return table


def effects_with_cost(
    part: str, effects: Mapping[str, Mapping[str, float]], events: Mapping[str, Mapping[str, float]]
) -> dict[str, Any]:
    """Return the effects that were on with their facts, and the seconds of the events that carry their names.

    The events of effect `gravity` in part `elastic` are "elastic:gravity" and "elastic:gravity:...".
    """
    table = {}
    for effect, facts in effects.items():
        own = f"{part}:{effect}"
        names = [name for name in events if name == own or name.startswith(f"{own}:")]
        seconds = [events[name]["seconds"] for name in names]
        table[effect] = {"facts": dict(facts), "seconds": sum(seconds) if seconds else None}
    return table


def peak_memory() -> int:
    """Largest memory of this process [bytes].

    `ru_maxrss` begins with that of the process which started this one, however large.
    """
    try:
        lines = Path("/proc/self/status").read_text().splitlines()
        return next(int(line.split()[1]) * 1024 for line in lines if line.startswith("VmHWM:"))
    except (OSError, StopIteration):
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024


def resources(comm: MPI.Comm, before: float) -> dict[str, Any] | None:
    """Return memory and processor time of each rank (collective; None on ranks other than 0).

    Parameters
    ----------
    before : float
        Processor seconds of this rank that starting has taken, which "run_cpu_seconds" leaves out.
    """
    seconds = time.process_time()
    mine = (
        platform.node(),
        seconds,
        seconds - before,
        peak_memory(),
    )
    everyone = comm.gather(mine, root=0)
    if everyone is None:
        return None
    hosts, every, run, memory = zip(*everyone, strict=True)
    return {
        "hosts": sorted(set(hosts)),
        "cpu_seconds": list(every),
        "run_cpu_seconds": list(run),
        "peak_memory_bytes": list(memory),
    }


def now() -> str:
    """Return date and time with the offset from UTC."""
    return datetime.datetime.now().astimezone().isoformat(timespec="seconds")


def write_record(folder: Path, record: Mapping[str, Any]) -> None:
    """Write `run.json`, whole or not at all."""
    write_text(folder / RECORD, json.dumps(_plain(record), indent=2, ensure_ascii=False) + "\n")


def _plain(value: Any) -> Any:
    """Return a value as JSON can hold it: no NumPy types; not-a-number and infinity as text."""
    if isinstance(value, Expectation):
        return _plain(asdict(value))
    if isinstance(value, Mapping):
        return {str(key): _plain(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(entry) for entry in value]
    if hasattr(value, "item"):
        value = value.item()
    if isinstance(value, float) and not math.isfinite(value):
        return str(value)
    return value if value is None or isinstance(value, bool | int | float | str) else str(value)
