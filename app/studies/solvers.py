"""`extremal study solvers`: linear solvers in the kinds of problems Newton meets.

The defaults of `forms.newton.REGIMES` come from this table. A cube of C2 Neo-Hookean material is untangled from a
scattered start (ν = 0 first), or stretched by half, at small and at large ν; a slender bar is bent by a dead load
at its end. Finished runs are kept in solvers.csv.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..errors import EXIT_FINISHED
from ..parallel import on_root
from ._table import Row, aligned, machine, petsc_options, read_rows, write_rows

if TYPE_CHECKING:
    from mpi4py import MPI

    from extremal.meshes import Domain

COLUMNS = ("problem", "element", "cells", "unknowns", "solver", "outcome", "newton", "krylov", "seconds", "end")


@dataclass(frozen=True)
class Kind:
    """What is solved."""

    start: str
    poisson_ratio: float
    stretch: float = 0.0
    load: float = 0.0  # on the right end, downwards [Pa]; E = 1 Pa
    length: float = 1.0  # [m]; the cross section is a unit square


KINDS = {
    "tangled, ν 0.45": Kind("scatter", 0.45),
    "tangled, ν 0.499": Kind("scatter", 0.499),
    "stretched, ν 0.3": Kind("rest", 0.3, stretch=0.5),
    "stretched, ν 0.49": Kind("rest", 0.49, stretch=0.5),
    "stretched, ν 0.499": Kind("rest", 0.499, stretch=0.5),
    "bent bar, ν 0.3": Kind("rest", 0.3, load=2e-3, length=10.0),
    "bent bar, ν 0.499": Kind("rest", 0.499, load=2e-3, length=10.0),
}
_CG = {"ksp_type": "cg", "ksp_max_it": 2000}
SOLVERS: dict[str, dict[str, object]] = {
    "pbjacobi": {**_CG, "pc_type": "pbjacobi"},
    "GAMG": {**_CG, "pc_type": "gamg"},
    "hypre": {**_CG, "pc_type": "hypre", "pc_hypre_boomeramg_strong_threshold": 0.5},
    "Cholesky": {**_CG, "pc_type": "cholesky", "pc_factor_mat_solver_type": "mumps"},
}
MESHES = ((1, 0.1), (2, 0.2), (1, 0.06))  # degree, cell size [m]
QUICK = ((1, 0.34), (2, 0.45))  # at most 1 m in the longest bar


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare where the results go."""
    parser.add_argument("-o", "--output", metavar="DIR", type=Path, default=Path("results/solvers"))
    parser.add_argument("--quick", action="store_true", help="coarse meshes")


def run(args: argparse.Namespace, comm: MPI.Comm) -> int:
    """Run what has not been run on rank 0, write solvers.csv and print the table."""
    on_root(comm, lambda: _run(args.output, QUICK if args.quick else MESHES))
    return EXIT_FINISHED


def _run(folder: Path, sizes: tuple[tuple[int, float], ...]) -> None:
    from mpi4py import MPI

    from extremal import meshes

    path = folder / "solvers.csv"
    rows = read_rows(path, COLUMNS)
    for degree, cell_size in sizes:
        for length in sorted({kind.length for kind in KINDS.values()}):
            size = cell_size * length ** (1 / 3)  # as many cells for every length
            data = meshes.generate("box", size=[length, 1.0, 1.0], cell_size=size)
            domain = meshes.distribute(MPI.COMM_SELF, data)
            done = {tuple(row[name] for name in ("problem", "element", "cells", "solver")) for row in rows}
            for kind in (name for name, what in KINDS.items() if what.length == length):
                for solver in SOLVERS:
                    if (kind, f"P{degree}", str(len(data.cells)), solver) not in done:
                        rows.append(solve(domain, degree, kind, solver))
                        write_rows(path, COLUMNS, rows)
    print(machine())
    print(table(rows))
    print(path, flush=True)


def table(rows: list[Row]) -> str:
    """A line for each problem; a cell says seconds (Newton / Krylov iterations), or how it failed."""
    problems = dict.fromkeys((row["problem"], row["element"], row["cells"]) for row in rows)
    lines = []
    for problem in problems:
        cells = {r["solver"]: _cell(r) for r in rows if (r["problem"], r["element"], r["cells"]) == problem}
        kind, element, count = problem
        lines.append((f"{kind}; {element}, {count} cells", *(cells.get(solver, "") for solver in SOLVERS)))
    return aligned(("", *SOLVERS), lines)


def _cell(row: Row) -> str:
    if row["outcome"] != "solved":
        return f"{row['outcome']}, {row['seconds']} s"
    return f"{row['seconds']} s ({row['newton']} / {row['krylov']})"


def solve(domain: Domain, degree: int, kind: str, solver: str) -> Row:
    """One run; its seconds are of this process on its processor."""
    import numpy as np

    from extremal import forms

    what = KINDS[kind]
    moduli = {"young_modulus": 1.0, "poisson_ratio": what.poisson_ratio}
    material = forms.Material(forms.law("neo_hookean", 3), moduli)
    prescribed = [forms.Prescribed(boundary=("left",), components=(0, 1, 2))]
    if what.stretch:
        pull = lambda x, t: np.tile([what.stretch * t, 0.0, 0.0], (len(x), 1))  # noqa: E731
        prescribed.append(forms.Prescribed(boundary=("right",), components=(0, 1, 2), motion=pull))
    load = lambda x, t: np.tile([0.0, 0.0, -what.load * t], (len(x), 1))  # noqa: E731
    row: dict[str, Any] = dict.fromkeys(COLUMNS, "")
    end, outcome = "converged", "solved"
    with petsc_options("elastic_", SOLVERS[solver]):
        body = forms.ElasticProblem(
            domain,
            dict.fromkeys(domain.region_names, material),
            degree=degree,
            prescribed=prescribed,
            tractions=[(("right",), load)] if what.load else [],
            stages=[forms.Stage(poisson_ratio=0.0)] if what.start == "scatter" else [],
        )
        how: dict[str, Any] = {"seed": 1} if what.start == "scatter" else {}
        body.start(what.start, **how)
        began = time.process_time()
        try:
            report = body.advance(1.0)
            row |= {key: int(report[f"{key}_iterations"]) for key in ("newton", "krylov")}
            outcome = "tangled" if body.diagnostics()["inverted"] else "solved"
        except forms.StepFailure as error:
            end, outcome = str(error).partition(" after ")[0], "failed"
        seconds = time.process_time() - began
    row |= {
        "problem": kind,
        "element": f"P{degree}",
        "cells": body.space.cells,
        "unknowns": body.equations.vector.getSize(),
        "solver": solver,
        "outcome": outcome,
        "seconds": f"{seconds:.2f}",
        "end": end,
    }
    body.destroy()
    return {name: str(value) for name, value in row.items()}
