"""`python -m extremal.app.sweep.case CASE.json RESULT.json`: run a case, alone or under mpirun."""

from __future__ import annotations

import importlib
import json
import math
import sys
import time
from pathlib import Path
from typing import Any

from mpi4py import MPI

from .. import record
from ..parallel import run_on_all
from ..results import write_text
from ..studies._table import petsc_options


def run(case: Path, result: Path, comm: MPI.Comm) -> int:
    """Run the case and write what a run.json would say, with the error (collective)."""
    told = json.loads(case.read_text(encoding="utf-8"))
    module = importlib.import_module(f"..studies.cases.{told['case']}", __package__)
    began, before = time.monotonic(), time.process_time()
    with petsc_options("", told["petsc"]):
        try:
            found: dict[str, Any] = module.run(told["settings"], comm)
        except ArithmeticError as failure:
            found = {"failed": str(failure).splitlines()[0]}
    wall, spent = time.monotonic() - began, time.process_time() - before
    seconds = comm.allgather(found.get("seconds", spent))
    error = float(found.get("error", math.nan))
    failed = found.get("failed") or ("" if math.isfinite(error) else f"error is {error}")
    facts = {
        "status": "failed" if failed else "finished",
        "reason": failed,
        "size": found.get("size", 0),
        "steps": found.get("steps", 1),
        "solver_iterations": found.get("iterations", {}),
        "diagnostics": found.get("diagnostics", {}),
        "wall_seconds": found.get("wall_seconds", wall),
        "versions": record.versions(),
    }
    facts |= record.resources(comm, before) or {}
    facts["run_cpu_seconds"] = seconds
    if math.isfinite(error):
        facts["error"] = error
    if comm.rank == 0:
        write_text(result, json.dumps(facts, indent=1) + "\n")
    return 3 if failed else 0


def main() -> int:
    """Run the case that the command line names."""
    case, result = map(Path, sys.argv[1:])
    return run_on_all(MPI.COMM_WORLD, lambda: run(case, result, MPI.COMM_WORLD))


if __name__ == "__main__":
    sys.exit(main())
