"""`extremal study recovery`: which models bring back a crushed cube (figures 6.10, 6.11).

A cube with one face held starts from a degenerate or inverted shape and is solved for equilibrium, whose only
correct answer is rest. Each model does so for several ν, starts and random seeds. Finished runs are kept in
recovery.csv and are not run again. Under mpirun the runs are shared out; each is solved by one rank.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..errors import EXIT_FINISHED, suggestion
from ..parallel import on_root
from ._table import Row, make_folder, read_rows, write_rows

if TYPE_CHECKING:
    from mpi4py import MPI

    from extremal.forms import ElasticProblem
    from extremal.meshes import Domain

TOLERANCE, ITERATIONS = 1e-8, 150
AT_REST = 1e-6  # largest displacement [m] of the unit cube that counts as rest
COLUMNS = (
    "model", "start", "poisson_ratio", "seed", "cell_size", "cells", "outcome", "newton", "krylov", "seconds",
    "inverted", "max_displacement", "residual", "end",
)  # fmt: skip


@dataclass(frozen=True)
class Model:
    """An energy and how it is solved."""

    label: str
    law: str
    extension: str
    stages: tuple[float, ...] = ()  # values of ν solved first


@dataclass(frozen=True)
class Start:
    """A first shape; `how` goes to the function of `forms.initial` called `state`."""

    label: str
    state: str
    how: dict[str, Any] = field(default_factory=dict)
    random: bool = True


MODELS = {
    "c2_staged": Model("C2 Neo-Hookean, ν = 0 first", "neo_hookean", "c2", (0.0,)),
    "c2": Model("C2 Neo-Hookean", "neo_hookean", "c2"),
    "c1": Model("C1 Neo-Hookean", "neo_hookean", "c1"),
    "fixed_corotated": Model("fixed corotated", "fixed_corotated", "none"),
    "corotated": Model("corotated", "corotated", "none"),
    "ife": Model("IFE Neo-Hookean", "neo_hookean", "ife"),
}
STARTS = {
    "point": Start("collapsed to a point", "collapse", {"to": "point"}, random=False),
    "noisy_point": Start("collapsed, noise 0.001", "collapse", {"to": "point", "noise": 1e-3}),
    "scatter_0.5": Start("scattered, half the box", "scatter", {"amplitude": 0.5}),
    "scatter_1": Start("scattered, the box", "scatter", {"amplitude": 1.0}),
    "scatter_2": Start("scattered, twice the box", "scatter", {"amplitude": 2.0}),
}
POISSON_RATIOS = (0.0, 0.3, 0.45, 0.49, 0.495, 0.499)
Case = tuple[str, str, float, int]  # model, start, ν, seed


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare what to run and where the results go."""
    parser.add_argument("-o", "--output", metavar="DIR", type=Path, default=Path("results/recovery"))
    for name, table in (("--models", MODELS), ("--starts", STARTS)):
        choices: dict[str, Any] = {**table}
        parser.add_argument(
            name, metavar="A,B", type=_of(choices), default=[*choices], help="some of: " + ", ".join(choices)
        )
    parser.add_argument("--poisson-ratios", metavar="A,B", type=_ratios, default=[*POISSON_RATIOS], help="below 0.5")
    parser.add_argument("--seeds", metavar="N", type=_positive(int), default=5, help="random starts (5)")
    parser.add_argument(
        "--cell-size", metavar="H", type=_positive(float), default=0.1, help="of edges [m] (0.1: 4994 cells)"
    )
    parser.add_argument("--quick", action="store_true", help="one seed, two ν, a coarse mesh: half a minute")


def _of(table: dict[str, Any]) -> Any:
    def read(text: str) -> list[str]:
        for name in text.split(","):
            if name not in table:
                raise argparse.ArgumentTypeError(f"{name}: unknown; {suggestion(name, table)}")
        return text.split(",")

    return read


def _ratios(text: str) -> list[float]:
    values = [_number(word) for word in text.split(",")]
    if not all(-1 < value < 0.5 for value in values):
        raise argparse.ArgumentTypeError(f"{text}: each must be above -1 and below 0.5")
    return values


def _positive(kind: type) -> Any:
    def read(text: str) -> Any:
        value = _number(text)
        if value <= 0 or kind(value) != value:
            raise argparse.ArgumentTypeError(f"{text}: must be a positive {'whole ' * (kind is int)}number")
        return kind(value)

    return read


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text}: not a number") from None


def cases(args: argparse.Namespace) -> Iterator[Case]:
    """The runs that are wanted; starts without random numbers are run once."""
    for model in args.models:
        for start in args.starts:
            for ν in args.poisson_ratios:
                for seed in range(1, (args.seeds if STARTS[start].random else 1) + 1):
                    yield model, start, ν, seed


def run(args: argparse.Namespace, comm: MPI.Comm) -> int:
    """Run what has not been run, then write recovery.csv and recovery.png (collective)."""
    if args.quick:
        args.seeds, args.poisson_ratios, args.cell_size = 1, [0.3, 0.499], 0.25
    path = args.output / "recovery.csv"

    def read() -> list[Row]:
        make_folder(args.output)
        return read_rows(path, COLUMNS)

    rows = on_root(comm, read)
    done = {_key(row) for row in rows if float(row["cell_size"]) == args.cell_size}
    todo = [case for case in cases(args) if case not in done]
    _run_all(todo, rows, args.cell_size, path, comm)
    if comm.rank == 0:
        from ._recovery_picture import draw, sentences

        wanted = set(cases(args))
        shown = [r for r in rows if _key(r) in wanted and float(r["cell_size"]) == args.cell_size]
        draw(args.output / "recovery.png", shown)
        print("\n".join(sentences(shown)), flush=True)
        print(f"{path}, {args.output / 'recovery.png'}", flush=True)
    comm.barrier()
    return EXIT_FINISHED


def _key(row: Row) -> Case:
    return row["model"], row["start"], float(row["poisson_ratio"]), int(row["seed"])


def _run_all(todo: Sequence[Case], rows: list[Row], cell_size: float, path: Path, comm: MPI.Comm) -> None:
    """Every rank runs its share; after each of its own rank 0 adds what has arrived to `rows`, `path`."""
    if not todo:
        return
    from mpi4py import MPI

    domain = _domain(cell_size)
    mine = todo[comm.rank :: comm.size]
    sent: list[Any] = []
    for case in mine:
        row = recover(domain, case, cell_size)
        if comm.rank > 0:
            sent.append(comm.isend(row, dest=0))
            continue
        _take(row, rows, path, len(todo))
        while comm.iprobe(source=MPI.ANY_SOURCE):
            _take(comm.recv(source=MPI.ANY_SOURCE), rows, path, len(todo))
    if comm.rank == 0:
        arrived = {_key(row) for row in rows}
        for _ in [case for case in todo if case not in arrived]:
            _take(comm.recv(source=MPI.ANY_SOURCE), rows, path, len(todo))
    MPI.Request.waitall(sent)


def _take(row: Row, rows: list[Row], path: Path, wanted: int) -> None:
    rows.append(row)
    write_rows(path, COLUMNS, rows)
    start, model = STARTS[row["start"]].label, MODELS[row["model"]].label
    words = f"{model}, {start}, ν = {row['poisson_ratio']}, seed {row['seed']}"
    print(f"{words}: {row['outcome']}, {row['newton']} Newton, {row['seconds']} s", flush=True)


def _domain(cell_size: float) -> Domain:
    from mpi4py import MPI

    from extremal import meshes

    data = meshes.generate("box", size=[1.0, 1.0, 1.0], cell_size=cell_size)
    return meshes.distribute(MPI.COMM_SELF, data)


def problem(domain: Domain, model: Model, poisson_ratio: float) -> ElasticProblem:
    """The cube of that model at rest, its left face held."""
    from extremal import forms

    material = forms.Material(
        forms.law(model.law, 3),
        {"young_modulus": 1.0, "poisson_ratio": poisson_ratio},
        extension=model.extension,
    )
    return forms.ElasticProblem(
        domain,
        dict.fromkeys(domain.region_names, material),
        prescribed=[forms.Prescribed(boundary=("left",), components=(0, 1, 2))],
        stages=[forms.Stage(poisson_ratio=ν) for ν in model.stages],
        tolerance=TOLERANCE,
        iterations=ITERATIONS,
    )


def recover(domain: Domain, case: Case, cell_size: float) -> Row:
    """One run, and how it ended.

    recovered: rest is reached. untangled: no element is inverted, but the body is not at rest. tangled: some
    are inverted. failed: no iterate could be judged. `end` is what the solver says: "converged", or why it
    stopped. Seconds are of this process on its processor, so that other programs do not count.
    """
    from extremal import forms

    model, start, ν, seed = case
    body = problem(domain, MODELS[model], ν)
    how = STARTS[start].how | ({"seed": seed} if STARTS[start].random else {})
    body.start(STARTS[start].state, **how)
    last: dict[str, float] = {}
    newton = 0

    def watch(figures: dict[str, float]) -> None:
        nonlocal newton
        newton += figures["iteration"] > 0
        last.update(figures)

    body.on_iteration = watch
    began = time.process_time()
    end, krylov, moved = "converged", "", float("nan")
    try:
        report = body.advance(1.0)
        newton, krylov = int(report["newton_iterations"]), str(int(report["krylov_iterations"]))
        figures = body.diagnostics()
        last.update(residual=figures["residual"], inverted=figures["inverted"])
        moved = figures["max_displacement"]
    except forms.StepFailure as error:
        end = str(error).partition(" after ")[0]
    seconds = time.process_time() - began
    body.destroy()
    row = {
        "model": model,
        "start": start,
        "poisson_ratio": ν,
        "seed": seed,
        "cell_size": cell_size,
        "cells": len(domain.original_cells),
        "outcome": _outcome(last, moved),
        "newton": newton,
        "krylov": krylov,
        "seconds": f"{seconds:.2f}",
        "inverted": int(last.get("inverted", -1)),
        "max_displacement": f"{moved:.3g}",
        "residual": f"{last.get('residual', float('nan')):.3g}",
        "end": end,
    }
    return {name: str(value) for name, value in row.items()}


def _outcome(last: dict[str, float], moved: float) -> str:
    if not last or last["residual"] != last["residual"]:
        return "failed"
    if last["inverted"] > 0:
        return "tangled"
    return "recovered" if moved < AT_REST else "untangled"
