"""The studies of cost run and tell what they measured; no time is tested."""

import argparse
import csv

from petsc4py import PETSc

from extremal.app.studies import _table, cost, solvers


def arguments(study, *words):
    parser = argparse.ArgumentParser()
    study.add_arguments(parser)
    return parser.parse_args([str(word) for word in words])


def rows_of(path):
    with open(path, newline="") as file:
        return list(csv.DictReader(file))


def test_cost_measures_every_quantity_in_both_states_and_degrees(tmp_path, comm, capsys):
    args = arguments(cost, "-o", tmp_path, "--cell-size", 0.5, "--repetitions", 1)
    assert cost.run(args, comm) == 0
    rows = rows_of(tmp_path / "cost.csv")
    assert len({(row["element"], row["state"], row["quantity"]) for row in rows}) == 2 * 2 * 3
    assert all(float(row["ours_us"]) > 0 and float(row["stock_us"]) > 0 for row in rows)
    assert all((row["insertion_us"] != "") == ("tangent" in row["quantity"]) for row in rows)
    assert "P1, near rest: energy" in capsys.readouterr().out


def test_near_rest_no_stretches_are_needed_and_scattered_they_are(tmp_path, comm):
    cost.run(arguments(cost, "-o", tmp_path, "--quick"), comm)
    rows = [row for row in rows_of(tmp_path / "cost.csv") if row["quantity"] == "residual"]
    skipped = {row["state"]: float(row["svd_skipped"]) for row in rows}
    assert skipped["near rest"] > 0.9
    assert skipped["scattered"] < 0.9


def test_solver_options_last_for_one_run_only():
    options = PETSc.Options("elastic_")
    options.setValue("pc_type", "jacobi")
    try:
        with _table.petsc_options("elastic_", {"pc_type": "lu", "ksp_type": "preonly"}):
            assert (options.getString("pc_type"), options.getString("ksp_type")) == ("lu", "preonly")
        assert options.getString("pc_type") == "jacobi"
        assert not options.hasName("ksp_type")
    finally:
        options.delValue("pc_type")


def test_a_failed_solver_has_its_place_in_the_table():
    row = {"problem": "tangled", "element": "P1", "cells": "5", "seconds": "1.0", "newton": "2", "krylov": "3"}
    good, bad = {**row, "solver": "Cholesky", "outcome": "solved"}, {**row, "solver": "GAMG", "outcome": "failed"}
    text = solvers.table([good, bad])
    assert "1.0 s (2 / 3)" in text
    assert "failed, 1.0 s" in text


def test_every_solver_unties_a_small_cube(tmp_path, comm):
    from extremal import meshes

    data = meshes.generate("box", size=[1.0, 1.0, 1.0], cell_size=0.5)
    domain = meshes.distribute(comm, data)
    for solver in ("pbjacobi", "Cholesky"):
        row = solvers.solve(domain, 1, "tangled, ν 0.499", solver)
        assert (row["outcome"], row["end"]) == ("solved", "converged")


def test_every_mesh_of_the_study_of_solvers_can_be_made():
    """The longest bar has the largest cells, and none may be larger than the cross section."""
    from extremal.app.studies.solvers import KINDS, MESHES, QUICK

    longest = max(kind.length for kind in KINDS.values())
    assert max(size for _, size in MESHES + QUICK) * longest ** (1 / 3) <= 1
