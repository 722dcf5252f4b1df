"""`extremal study cost`: seconds per cell of energy, residual and projected tangent, on one core.

Beside ours, in the same run on the same mesh: the insertion of element matrices alone (a form with constant
coefficients, the bound of any assembly), and the Neo-Hookean energy of a dolfinx tutorial, differentiated by UFL,
with the same quadrature and compiler flags.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..errors import EXIT_FINISHED
from ..parallel import on_root
from ._table import aligned, machine, make_folder, write_rows

if TYPE_CHECKING:
    from mpi4py import MPI

    from extremal.forms import ElasticProblem

CELL_SIZE = 0.0464  # [m], about 50,000 cells
COLUMNS = ("element", "state", "cells", "quantity", "ours_us", "stock_us", "insertion_us", "svd_skipped")
STATES = ("near rest", "scattered")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the mesh and how often to repeat."""
    parser.add_argument("-o", "--output", metavar="DIR", type=Path, default=Path("results/cost"))
    parser.add_argument("--cell-size", metavar="H", type=float, help="[m] (0.0464: about 50,000 cells)")
    parser.add_argument("--repetitions", metavar="N", type=int, default=7, help="the best of N counts (7)")
    parser.add_argument("--quick", action="store_true", help="a coarse mesh and two repetitions")


def run(args: argparse.Namespace, comm: MPI.Comm) -> int:
    """Measure on rank 0, write cost.csv and print the table."""
    if args.quick:
        args.cell_size, args.repetitions = 0.25, 2
    on_root(comm, lambda: _run(args))
    return EXIT_FINISHED


def _run(args: argparse.Namespace) -> None:
    make_folder(args.output)
    rows: list[dict[str, Any]] = []
    for degree in (1, 2):
        rows += measure(degree, args.cell_size or CELL_SIZE, max(1, args.repetitions))
    write_rows(args.output / "cost.csv", COLUMNS, rows)
    print(machine())
    print(table(rows), flush=True)
    print(args.output / "cost.csv", flush=True)


def table(rows: list[dict[str, Any]]) -> str:
    """The rows as Markdown."""
    columns = ("", "cells", "ours [µs/cell]", "dolfinx, UFL", "ratio", "insertion alone", "ratio")
    out = []
    for row in rows:
        ours, stock, bound = (float(row[f"{who}_us"] or "nan") for who in ("ours", "stock", "insertion"))
        out.append(
            (
                f"{row['element']}, {row['state']}: {row['quantity']}",
                row["cells"],
                f"{ours:.2f}",
                _or_dash(stock, ".2f"),
                _or_dash(ours / stock, ".2f"),
                _or_dash(bound, ".2f"),
                _or_dash(ours / bound, ".2f"),
            )
        )
    return aligned(columns, out)


def _or_dash(value: float, form: str) -> str:
    return format(value, form) if value == value else ""


def measure(degree: int, cell_size: float, repetitions: int) -> list[dict[str, Any]]:
    """Microseconds per cell of each quantity in each state, for elements of that degree."""
    from mpi4py import MPI

    from extremal import forms, meshes

    data = meshes.generate("box", size=[1.0, 1.0, 1.0], cell_size=cell_size)
    domain = meshes.distribute(MPI.COMM_SELF, data)
    material = forms.Material(forms.law("neo_hookean", 3), {"young_modulus": 1.0, "poisson_ratio": 0.45})
    body = forms.ElasticProblem(
        domain,
        dict.fromkeys(domain.region_names, material),
        degree=degree,
        prescribed=[forms.Prescribed(boundary=("left",), components=(0, 1, 2))],
    )
    cells = body.space.cells
    insertion = _best(_insertion(body), repetitions) / cells * 1e6
    rows = []
    for state in STATES:
        _put(body, state)
        equations = body.equations
        x = equations.vector.duplicate()
        x.array[:] = body.motion.u[: equations.owned]
        out = equations.vector.duplicate()
        ours: dict[str, Callable[[], object]] = {
            "energy": partial(equations.energy, x),
            "residual": partial(equations.residual, x, out),
            "projected tangent": partial(equations.tangent, x, equations.matrix, True),
        }
        equations.set(x)
        stock = _stock(body)
        for quantity, ours_now in ours.items():
            seconds = _best(ours_now, repetitions)
            peer = _best(stock[quantity], repetitions)
            rows.append(
                {
                    "element": f"P{degree}",
                    "state": state,
                    "cells": cells,
                    "quantity": quantity,
                    "ours_us": f"{seconds / cells * 1e6:.4f}",
                    "stock_us": f"{peer / cells * 1e6:.4f}",
                    "insertion_us": f"{insertion:.4f}" if "tangent" in quantity else "",
                    "svd_skipped": f"{body.laws.skipped / body.space.point_of.size:.3f}",
                }
            )
    return rows


def _put(body: ElasticProblem, state: str) -> None:
    """Scattered at random, or moved smoothly by a hundredth of the body's size."""
    import numpy as np

    body.start("scatter", amplitude=1.0, seed=1)
    if state == "near rest":
        u, x = body.motion.u, body.space.positions
        u[:] = (0.01 * np.sin(3 * x[:, [1, 2, 0]]) * x[:, :1]).ravel()


def _best(action: Callable[[], object], repetitions: int) -> float:
    action()
    times = []
    for _ in range(repetitions):
        began = time.process_time()
        action()
        times.append(time.process_time() - began)
    return min(times)


def _insertion(body: ElasticProblem) -> Callable[[], object]:
    """Assembly of ∫ ∇u:∇v dX, whose element matrices cost next to nothing."""
    import ufl

    from extremal.forms import compat

    space = body.space
    du, v = ufl.TrialFunction(space.vectors), ufl.TestFunction(space.vectors)
    form = compat.form(ufl.inner(ufl.grad(du), ufl.grad(v)) * space.dx)
    matrix = body.equations.matrix

    def insert() -> None:
        matrix.zeroEntries()
        compat.add_matrix(matrix, form, [])
        matrix.assemble()

    return insert


def _stock(body: ElasticProblem) -> dict[str, Callable[[], object]]:
    """Ψ = μ/2 (I1 - 3) - μ ln J + λ/2 (ln J)² as dolfinx's users write it; without value where J < 0."""
    import ufl
    from dolfinx import fem

    from extremal.forms import compat
    from extremal.forms.material import lame_parameters

    space, u = body.space, body.space.u
    mu, lam = (fem.Constant(space.mesh, float(value)) for value in lame_parameters(1.0, 0.45))
    du, v = ufl.TrialFunction(space.vectors), ufl.TestFunction(space.vectors)
    F = ufl.variable(ufl.Identity(3) + ufl.grad(u))
    J = ufl.det(F)
    Ψ = mu / 2 * (ufl.tr(F.T * F) - 3) - mu * ufl.ln(J) + lam / 2 * ufl.ln(J) ** 2
    residual = ufl.inner(ufl.diff(Ψ, F), ufl.grad(v)) * space.dx
    energy_form, residual_form = compat.form(Ψ * space.dx), compat.form(residual)
    tangent_form = compat.form(ufl.derivative(residual, u, du))
    vector, matrix = body.equations.vector.duplicate(), body.equations.matrix
    conditions = body.constraints.conditions

    def assemble_residual() -> None:
        with vector.localForm() as local:
            local.set(0.0)
        compat.add_vector(vector, residual_form)

    def assemble_tangent() -> None:
        matrix.zeroEntries()
        compat.add_matrix(matrix, tangent_form, conditions)
        matrix.assemble()

    return {
        "energy": lambda: fem.assemble_scalar(energy_form),
        "residual": assemble_residual,
        "projected tangent": assemble_tangent,
    }
