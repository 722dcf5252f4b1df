"""`extremal study stability`: what the hard cases of elasticity end in, model by model.

Each case of `_stability_cases` is run with every model of the recovery map and with three naive solvers. Finished runs
are kept in stability.csv and are not run again. Under mpirun the runs are shared out; each is solved by one rank.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..arguments import positive
from ..errors import EXIT_FINISHED
from ..parallel import on_root
from ..results import write_text
from . import recovery
from ._share import share_out
from ._stability_cases import CASES, Case, domains, refusal
from ._table import Row, machine, petsc_options, read_rows, write_rows

if TYPE_CHECKING:
    from mpi4py import MPI

    from extremal.forms import ElasticProblem
    from extremal.meshes import Domain

# what one writes first: the law as it stands; Newton's matrix as it is; steps as they come
NAIVE = {
    "plain": recovery.Model("Neo-Hookean, no extension", "neo_hookean", "none"),
    "unprojected": recovery.Model("C2, tangent never projected", "neo_hookean", "c2", exact_tangent=True),
    "full_steps": recovery.Model("C2, Newton's full steps", "neo_hookean", "c2", exact_tangent=True),
}
FULL_STEPS = {
    "snes_linesearch_type": "basic", "ksp_type": "preonly", "pc_type": "lu", "pc_factor_mat_solver_type": "mumps",
}  # fmt: skip
MODELS = {**recovery.MODELS, **NAIVE}
BY_NAME = {case.name: case for case in CASES}
ENOUGH = 10.0  # [s], several periods of the cube: who is inverted after that stays so
GROWTH = 1 + 1e-9  # of the energy over a run of backward Euler: rounding
CELL_SIZE, QUICK_CELL_SIZE = 0.2, 0.34
QUICK_MODELS = ("c2_staged", "c2", "c1", "fixed_corotated", "corotated", "ife")
COLUMNS = (
    "case", "model", "seed", "cell_size", "cells", "outcome", "newton", "krylov", "seconds", "inverted", "smallest_J",
    "max_displacement", "residual", "end",
)  # fmt: skip
Run = tuple[str, str, int]  # case, model, seed


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare what to run and where the results go."""
    parser.add_argument("-o", "--output", metavar="DIR", type=Path, default=Path("results/stability"))
    groups = dict.fromkeys(case.group for case in CASES)
    for name, known in (("--models", MODELS), ("--cases", groups)):
        choices = dict.fromkeys(known)
        parser.add_argument(
            name,
            metavar="A,B",
            type=recovery.some_of(choices),
            default=[*choices],
            help=f"some of: {', '.join(choices)}",
        )
    parser.add_argument("--cell-size", metavar="H", type=positive(), default=CELL_SIZE, help="[m] (0.2)")
    parser.add_argument("--quick", action="store_true", help="one seed, no naive solvers, a coarse mesh: half a minute")


def run(args: argparse.Namespace, comm: MPI.Comm) -> int:
    """Run what has not been run, then write stability.csv, .md and .png (collective)."""
    if args.quick:
        args.cell_size, args.models = QUICK_CELL_SIZE, [m for m in args.models if m in QUICK_MODELS]
    path = args.output / "stability.csv"
    rows = on_root(comm, lambda: read_rows(path, COLUMNS))
    done = {_key(row) for row in rows if float(row["cell_size"]) == args.cell_size}
    wanted = list(runs(args.cases, args.models, 1 if args.quick else None))
    todo = [one for one in wanted if one not in done]
    if todo:
        meshes = domains(args.cell_size, {BY_NAME[name].mesh for name, _, _ in todo})

        def take(row: Row) -> None:
            rows.append(row)
            write_rows(path, COLUMNS, rows)
            words = f"{row['case']}, {MODELS[row['model']].label}, seed {row['seed']}"
            print(f"{words}: {row['outcome']}, {row['newton']} Newton, {row['seconds']} s", flush=True)

        share_out(todo, lambda one: outcome_of(one, meshes, args.cell_size), take, comm)
    if comm.rank == 0:
        from ._stability_picture import draw, sentences, table

        keys = set(wanted)
        shown = [row for row in rows if _key(row) in keys and float(row["cell_size"]) == args.cell_size]
        draw(args.output / "stability.png", shown)
        said = [*sentences(shown), f"An element without volume is refused: {refusal(args.cell_size)}"]
        text = "\n\n".join([table(shown), *said, f"Measured on: {machine()}."])
        write_text(args.output / "stability.md", text + "\n")
        print("\n".join(said), flush=True)
        print(", ".join(str(path.with_suffix(end)) for end in (".csv", ".md", ".png")), flush=True)
    comm.barrier()
    return EXIT_FINISHED


def runs(groups: Sequence[str], models: Sequence[str], most: int | None = None) -> Iterator[Run]:
    """The runs of some groups of cases, at most so many seeds of each."""
    for case in CASES:
        if case.group in groups:
            for model in models:
                for seed in range(1, min(case.seeds, most or case.seeds) + 1):
                    yield case.name, model, seed


def _key(row: Row) -> Run:
    return row["case"], row["model"], int(row["seed"])


def outcome_of(one: Run, meshes: dict[str, Domain], cell_size: float) -> Row:
    """One run, and how it ended (see `judge`)."""
    name, model, seed = one
    case, domain = BY_NAME[name], meshes[BY_NAME[name].mesh]
    with petsc_options("elastic_", FULL_STEPS if model == "full_steps" else {}):
        body = recovery.problem(
            domain,
            MODELS[model],
            case.poisson_ratio,
            young_modulus=case.young_modulus,
            prescribed=case.prescribed(),
            integrator="backward_euler" if case.dt else None,
            tolerance=case.tolerance,
            iterations=case.iterations,
        )
        body.start(**case.begin(seed))
        first = body.diagnostics()["energy"]
        made = recovery.attempt(body, case.steps)
        outcome = judge(case, body, made, first)
    body.destroy()
    figures = made.figures
    row = {
        "case": name,
        "model": model,
        "seed": seed,
        "cell_size": cell_size,
        "cells": len(domain.original_cells),
        "outcome": outcome,
        "newton": made.newton,
        "krylov": made.krylov if made.end == "converged" else "",
        "seconds": f"{made.seconds:.2f}",
        "inverted": int(figures.get("inverted", -1)),
        "smallest_J": f"{figures.get('smallest_J', float('nan')):.6g}",
        "max_displacement": f"{made.moved:.3g}",
        "residual": f"{figures.get('residual', float('nan')):.3g}",
        "end": made.end.partition(" after ")[0],
    }
    return {name: str(value) for name, value in row.items()}


def judge(case: Case, body: ElasticProblem, made: recovery.Attempt, first: float) -> str:
    """How a run ended.

    recovered, untangled, tangled and failed are those of the recovery map. moving: with inertia, every step was solved
    and the energy does not exceed that of the start, `first` [J], but there was no time to come to rest. broken: what
    must never happen, which is a number that is not finite, a failed step that changes the state or does not say why in
    one line, energy out of nothing.
    """
    after = body.diagnostics()
    # a law without extension may have no energy at the start, to which a failed step goes back
    judged = [value for name, value in after.items() if "energy" not in name or np.isfinite(first)]
    good = bool(np.isfinite(judged).all())
    good &= len(made.end.splitlines()) == 1 and np.array_equal(body.space.u.x.array, body.motion.u)
    if case.dt is not None and body.laws.has_energy and np.isfinite(first):
        good &= after["energy"] <= GROWTH * first
    if not good:
        return "broken"
    in_time = case.dt is None or made.end != "converged" or body.time >= ENOUGH
    return made.outcome if in_time or made.outcome == "recovered" else "moving"
