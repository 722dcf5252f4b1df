"""The studies of networks: the source's tables and its figure, what accuracy costs."""

import argparse
import csv

import numpy as np
import pytest

from extremal.app.studies import (
    _network_runs,
    _network_table,
    figure_3_3,
    hawkes_accuracy,
    hawkes_cost,
    table_3_1,
    table_3_2,
)
from extremal.hawkes.energy import Energy
from extremal.hawkes.scores import Share


def arguments(study, *words):
    parser = argparse.ArgumentParser(exit_on_error=False)
    study.add_arguments(parser)
    return parser.parse_args([str(word) for word in words])


def rows_of(path):
    with open(path, newline="") as file:
        return list(csv.DictReader(file))


@pytest.mark.mpi
def test_table_3_1_agrees_with_the_source_for_all_methods(comm, shared_path):
    """300 runs: 3 standard deviations of a top 1 are 4.2 points, where guessing is 30 points off."""
    args = arguments(table_3_1, "--runs", 300, "--seed", 2, "-o", shared_path)
    assert table_3_1.run(args, comm) == 0
    rows = rows_of(shared_path / "table_3_1.csv")
    assert len(rows) == 15
    for row in rows:
        deviation = (float(row["high"]) - float(row["low"])) / (2 * 1.96)
        assert abs(float(row["percent"]) - float(row["source"])) < 3 * deviation
        assert row["events"] == "1200"
    assert (shared_path / "table_3_1.png").stat().st_size > 0


@pytest.mark.mpi
def test_any_number_of_ranks_gives_the_same_table(comm):
    from mpi4py import MPI

    assert table_3_1.table(comm, 7, 5) == table_3_1.table(MPI.COMM_SELF, 7, 5)


@pytest.mark.mpi
def test_table_3_2_has_every_row_of_the_source_in_both_readings(comm, shared_path):
    assert table_3_2.run(arguments(table_3_2, "--runs", 2, "--posterior", "-o", shared_path), comm) == 0
    rows = rows_of(shared_path / "table_3_2.csv")
    for method in ("(3.5)", "halved coupling", "mean field", "posterior"):
        assert sum(row["method"] == method for row in rows) == 36
    guessed = {row["case"]: float(row["percent"]) for row in rows if (row["method"], row["top"]) == ("guessing", "1")}
    ours = {row["case"]: float(row["percent"]) for row in rows if (row["method"], row["top"]) == ("(3.5)", "1")}
    assert all(ours[case] > share + 10 for case, share in guessed.items())
    assert "(57" in (shared_path / "table_3_2.md").read_text()


def test_surrogate_is_a_network_like_the_one_described():
    network = table_3_2.surrogate()
    degree = np.bincount(network.pairs.ravel())
    assert (len(network.agents), len(network)) == (29, 69)
    assert degree.min() >= 1
    assert round(degree.mean()) == 5


@pytest.mark.mpi
def test_figure_3_3_is_guessing_without_excitation_and_certain_with_much(comm, shared_path):
    args = arguments(figure_3_3, "--quick", "-o", shared_path)
    assert figure_3_3.run(args, comm) == 0
    rows = rows_of(shared_path / "figure_3_3.csv")
    share = {(float(row["branching"]), float(row["tau"])): float(row["percent"]) for row in rows}
    assert len(share) == 9
    assert share[0.0, 4.0] < 30  # one in five, 400 events
    assert share[1.0, 4.0] > 90
    assert share[1.0, -1.0] < share[1.0, 1.5] < share[1.0, 4.0]
    assert (shared_path / "figure_3_3.png").stat().st_size > 0


def test_accuracy_against_time_has_all_methods_and_proves_the_gaps(comm, tmp_path):
    assert hawkes_accuracy.run(arguments(hawkes_accuracy, "--quick", "-o", tmp_path), comm) == 0
    rows = rows_of(tmp_path / "hawkes_accuracy.csv")
    methods = {row["method"] for row in rows}
    assert {"enumeration (3.1)", "(3.7)", "mean field", "Gibbs", "(3.5), sweeps", "(3.5), TRON"} <= methods
    for row in rows:
        if row["method"].startswith("(3.5)"):
            assert float(row["relative_gap"]) <= 1.01 * float(row["setting"].removeprefix("gap "))  # three digits
    exact = next(row for row in rows if row["method"] == "enumeration (3.1)")
    assert exact["flips"] == "0"
    assert (tmp_path / "hawkes_accuracy.png").stat().st_size > 0


def test_costs_are_measured_without_neighbours_too(comm, tmp_path):
    words = ("--quick", "-o", tmp_path, "--peers", tmp_path / "nowhere")
    assert hawkes_cost.run(arguments(hawkes_cost, *words), comm) == 0
    rows = {row["quantity"]: row for row in rows_of(tmp_path / "hawkes_cost.csv")}
    clarabel = rows["(3.5), 200 slots, 5 sweeps, beside Clarabel"]
    assert (clarabel["theirs"], clarabel["met"]) == ("", "")
    assert "is not there" in clarabel["note"]
    assert any("L-BFGS-B" in name and float(row["theirs"]) > 0 for name, row in rows.items())
    assert [row["met"] for name, row in rows.items() if name.endswith("gap 1e-08: time")] == ["yes"]


def test_matrices_of_the_source_give_the_same_gradient_as_the_recursions():
    slots, _ = _network_runs.Data(_network_runs.complete_network(5), 60, 30).slots(_network_runs.seed_of(1, 0))
    x = np.random.default_rng(1).random(len(slots))
    np.testing.assert_allclose(hawkes_cost.matrices(slots)(x), Energy(slots).couple(x), rtol=1e-12)


def test_half_the_coupling_is_the_gradient_b_plus_a_r():
    slots, _ = _network_runs.Data(_network_runs.complete_network(4), 60, 20).slots(_network_runs.seed_of(1, 0))
    x = _network_runs.halved(slots)
    energy = Energy(slots)
    g = slots.linear + 0.5 * energy.couple(x)
    size = np.repeat(np.sqrt(slots.columns(g, g)), np.diff(slots.start))
    np.testing.assert_allclose(x, g / size, atol=1e-5)  # a gap of 1e-10 leaves its root


def test_a_number_of_the_source_counts_as_within_if_its_rounding_can_reach():
    cell = _network_table.Cell("", "", 1, Share(0.50, 0.49, 0.51, 100), 51.4, 0.5)
    assert cell.within
    assert not _network_table.Cell("", "", 1, cell.found, 51.6, 0.5).within
    assert not _network_table.Cell("", "", 1, cell.found, 48.4, 0.5).within


@pytest.mark.parametrize("words", [("--runs", "0"), ("--runs", "x"), ("--seed", "-1"), ("--points", "0")])
def test_bad_numbers_are_refused(words):
    with pytest.raises(argparse.ArgumentError):
        arguments(figure_3_3, *words)
