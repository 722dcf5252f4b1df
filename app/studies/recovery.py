"""`extremal study recovery`: which models bring back a crushed cube (figures 6.10, 6.11).

A cube with one face held starts from a degenerate or inverted shape and is solved for equilibrium, whose only
correct answer is rest. Each model does so for several ν, starts and random seeds. Finished runs are kept in
recovery.csv and are not run again. Under mpirun the runs are shared out; each is solved by one rank.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..arguments import positive, whole
from ..errors import EXIT_FINISHED, suggestion
from ..parallel import on_root
from ._share import share_out
from ._table import Row, read_rows, write_rows

if TYPE_CHECKING:
    from mpi4py import MPI

    from extremal.forms import ElasticProblem, Field, Prescribed
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
    exact_tangent: bool = False


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
            name, metavar="A,B", type=some_of(choices), default=[*choices], help="some of: " + ", ".join(choices)
        )
    parser.add_argument("--poisson-ratios", metavar="A,B", type=_ratios, default=[*POISSON_RATIOS], help="below 0.5")
    parser.add_argument("--seeds", metavar="N", type=whole(), default=5, help="random starts (5)")
    parser.add_argument(
        "--cell-size", metavar="H", type=positive(), default=0.1, help="of edges [m] (0.1: 4994 cells)"
    )
    parser.add_argument("--quick", action="store_true", help="one seed, two ν, a coarse mesh: half a minute")


def some_of(table: dict[str, Any]) -> Any:
    """A reader of names from `table`, parted by commas."""
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
    rows = on_root(comm, lambda: read_rows(path, COLUMNS))
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
    """Add a row for each of `todo` to `rows` and to `path` on rank 0."""
    if not todo:
        return
    domain = cube(cell_size)
    share_out(todo, lambda case: recover(domain, case, cell_size), lambda row: _take(row, rows, path), comm)


def _take(row: Row, rows: list[Row], path: Path) -> None:
    rows.append(row)
    write_rows(path, COLUMNS, rows)
    start, model = STARTS[row["start"]].label, MODELS[row["model"]].label
    words = f"{model}, {start}, ν = {row['poisson_ratio']}, seed {row['seed']}"
    print(f"{words}: {row['outcome']}, {row['newton']} Newton, {row['seconds']} s", flush=True)


def cube(cell_size: float) -> Domain:
    """The unit cube on this rank alone."""
    from mpi4py import MPI

    from extremal import meshes

    data = meshes.generate("box", size=[1.0, 1.0, 1.0], cell_size=cell_size)
    return meshes.distribute(MPI.COMM_SELF, data)


def problem(
    domain: Domain,
    model: Model,
    poisson_ratio: float,
    *,
    young_modulus: Field = 1.0,
    prescribed: Sequence[Prescribed] = (),
    **how: Any,
) -> ElasticProblem:
    """The body of that model at rest, its left face held; `prescribed` and `how` go to `ElasticProblem`."""
    from extremal import forms

    material = forms.Material(
        forms.law(model.law, 3),
        {"young_modulus": young_modulus, "poisson_ratio": poisson_ratio},
        extension=model.extension,
    )
    return forms.ElasticProblem(
        domain,
        dict.fromkeys(domain.region_names, material),
        prescribed=[forms.Prescribed(boundary=("left",), components=(0, 1, 2)), *prescribed],
        stages=[forms.Stage(poisson_ratio=ν) for ν in model.stages],
        exact_tangent=model.exact_tangent,
        **{"tolerance": TOLERANCE, "iterations": ITERATIONS, **how},
    )


@dataclass
class Attempt:
    """What steps from a start took, and how they ended.

    `end` is what the solver says: "converged", or why it stopped; `figures` are those of the last iterate that
    there was; `moved` is the largest displacement [m], nan unless all steps converged. Seconds are of this process on
    its processor, so that other programs do not count.
    """

    end: str = "converged"
    newton: int = 0
    krylov: int = 0
    seconds: float = 0.0
    moved: float = float("nan")
    figures: dict[str, float] = field(default_factory=dict)

    @property
    def outcome(self) -> str:
        """recovered: rest is reached. untangled: no element is inverted, but the body is not at rest. tangled: some
        are inverted. failed: no iterate could be judged."""
        if not self.figures or self.figures["residual"] != self.figures["residual"]:
            return "failed"
        if self.figures["inverted"] > 0:
            return "tangled"
        return "recovered" if self.moved < AT_REST else "untangled"


def attempt(body: ElasticProblem, steps: Iterable[float] = (1.0,)) -> Attempt:
    """Take the steps [s] until one fails."""
    from extremal.forms import StepFailure

    made, newton = Attempt(), 0

    def watch(figures: dict[str, float]) -> None:
        nonlocal newton
        newton += figures["iteration"] > 0
        made.figures.update(figures, smallest_J=float(body.laws.determinants().min()))

    body.on_iteration = watch
    began = time.process_time()
    try:
        for dt in steps:
            newton = 0
            report = body.advance(dt)
            made.newton += int(report["newton_iterations"])
            made.krylov += int(report["krylov_iterations"])
        made.figures.update(body.diagnostics())
        made.moved = made.figures["max_displacement"]
    except StepFailure as error:
        made.newton += newton
        made.end = str(error)
    made.seconds = time.process_time() - began
    return made


def recover(domain: Domain, case: Case, cell_size: float) -> Row:
    """One run, and how it ended."""
    model, start, ν, seed = case
    body = problem(domain, MODELS[model], ν)
    how = STARTS[start].how | ({"seed": seed} if STARTS[start].random else {})
    body.start(STARTS[start].state, **how)
    made = attempt(body)
    body.destroy()
    row = {
        "model": model,
        "start": start,
        "poisson_ratio": ν,
        "seed": seed,
        "cell_size": cell_size,
        "cells": len(domain.original_cells),
        "outcome": made.outcome,
        "newton": made.newton,
        "krylov": made.krylov if made.end == "converged" else "",
        "seconds": f"{made.seconds:.2f}",
        "inverted": int(made.figures.get("inverted", -1)),
        "max_displacement": f"{made.moved:.3g}",
        "residual": f"{made.figures.get('residual', float('nan')):.3g}",
        "end": made.end.partition(" after ")[0],
    }
    return {name: str(value) for name, value in row.items()}
