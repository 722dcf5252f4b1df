"""`extremal study locking`: how much too stiff elements are in bending as Poisson's ratio comes near 1/2.

A bar of 4 m x 1 m x 1 m is held at one end and pulled sideways at the other, so that its tip moves by about half a
metre. Elements of first (P1) and second (P2) degree on ever finer regular meshes are compared with P2 on a mesh finer
than all of them. Each row is solved with the defaults of a scene.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..errors import EXIT_FINISHED
from ..parallel import on_root
from ..results import atomic
from ._table import aligned, make_folder, write_rows

if TYPE_CHECKING:
    from mpi4py import MPI

SIZE = (4.0, 1.0, 1.0)  # [m]
TRACTION = 2e-3  # of Young's modulus
RATIOS = (0.3, 0.49, 0.4999)
MESHES = {1: (2, 4, 8), 2: (1, 2, 4)}  # cells across the bar
REFERENCE = 6
COLUMNS = (
    "poisson_ratio",
    "degree",
    "across",
    "cells",
    "unknowns",
    "deflection",
    "share",
    "newton",
    "seconds",
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the folder of results and a short form."""
    parser.add_argument("-o", "--output", metavar="DIR", type=Path, default=Path("results/locking"))
    parser.add_argument("--quick", action="store_true", help="coarse meshes only")


def run(args: argparse.Namespace, comm: MPI.Comm) -> int:
    """Solve all cases (collective); write locking.csv and locking.png and print the table."""
    on_root(comm, lambda: make_folder(args.output))
    meshes, reference = ({1: (2, 4), 2: (1,)}, 2) if args.quick else (MESHES, REFERENCE)
    rows = []
    for ratio in RATIOS:
        best = bend(comm, ratio, 2, reference)
        for degree, counts in meshes.items():
            for across in counts:
                row = bend(comm, ratio, degree, across)
                rows.append(row | {"share": row["deflection"] / best["deflection"]})
        rows.append(best | {"share": 1.0})
    on_root(comm, lambda: _write(args.output, rows))
    return EXIT_FINISHED


def bend(comm: MPI.Comm, poisson_ratio: float, degree: int, across: int) -> dict[str, Any]:
    """One row: `deflection` is the mean sideways displacement of the free end [m] (collective)."""
    import numpy as np

    from extremal import forms, meshes

    data = None
    if comm.rank == 0:
        data = meshes.generate("bar", size=SIZE, cell_size=1 / across, structured=True)
    domain = meshes.distribute(comm, data)
    material = forms.Material(
        forms.law("neo_hookean", 3), {"young_modulus": 1.0, "poisson_ratio": poisson_ratio}
    )
    start = time.perf_counter()
    problem = forms.ElasticProblem(
        domain,
        {name: material for name in domain.region_names},
        degree=degree,
        prescribed=[forms.Prescribed(boundary=("left",))],
        tractions=[(("right",), lambda x, t: np.tile([0.0, 0.0, TRACTION * t], (len(x), 1)))],
    )
    problem.start()
    figures = problem.advance(1.0)
    seconds = time.perf_counter() - start
    state, geometry = problem.state(), problem.geometry()
    problem.destroy()
    row: dict[str, Any] = {}
    if geometry is not None:
        end = np.isclose(geometry[0][:, 0], SIZE[0])
        row = {
            "poisson_ratio": poisson_ratio,
            "degree": degree,
            "across": across,
            "cells": len(geometry[1]),
            "unknowns": state["u"].size,
            "deflection": float(state["u"][end, 2].mean()),
            "newton": int(figures["newton_iterations"]),
            "seconds": round(seconds, 2),
        }
    return comm.bcast(row)


def table(rows: Sequence[dict[str, Any]]) -> str:
    """The rows as Markdown: part of the reference's deflection for each ν."""
    columns = ("element", "cells across", "unknowns", *(f"ν = {ratio:g}" for ratio in RATIOS))
    kinds = dict.fromkeys((row["degree"], row["across"], row["unknowns"]) for row in rows)
    out = []
    for degree, across, unknowns in sorted(kinds):
        found = {
            row["poisson_ratio"]: row for row in rows if (row["degree"], row["across"]) == (degree, across)
        }
        shares = [f"{found[ratio]['share']:.3f}" for ratio in RATIOS]
        out.append((f"P{degree}", across, unknowns, *shares))
    return aligned(columns, out)


def _write(folder: Path, rows: Sequence[dict[str, Any]]) -> None:
    write_rows(folder / "locking.csv", COLUMNS, rows)
    draw(folder / "locking.png", rows)
    print(table(rows))
    print(folder / "locking.png", flush=True)


def draw(path: Path, rows: Sequence[dict[str, Any]]) -> None:
    """Draw the part of the deflection that each element finds, against the number of unknowns."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7, 4), layout="constrained")
    axes = figure.add_subplot()
    for ratio, colour in zip(RATIOS, ("tab:blue", "tab:orange", "tab:red")):
        for degree, style in ((1, "o--"), (2, "s-")):
            found = [row for row in rows if (row["poisson_ratio"], row["degree"]) == (ratio, degree)]
            unknowns, shares = [row["unknowns"] for row in found], [row["share"] for row in found]
            axes.semilogx(unknowns, shares, style, color=colour, label=f"P{degree}, ν = {ratio:g}")
    axes.axhline(1, color="grey", linewidth=0.8)
    axes.set(xlabel="unknowns", ylabel="deflection / that of the finest P2 mesh", ylim=(0, 1.08))
    axes.legend(loc="center left", bbox_to_anchor=(1.01, 0.5), frameon=False)
    with atomic(path) as partial:
        figure.savefig(partial, format="png", dpi=110)
