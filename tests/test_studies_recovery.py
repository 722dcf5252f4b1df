"""The recovery study: what it runs, what it keeps, what it says."""

import argparse
import csv

import pytest

from extremal.app.errors import InputError
from extremal.app.studies import recovery
from extremal.app.studies._recovery_picture import sentences

SMALL = ["--starts", "scatter_1", "--poisson-ratios", "0.499", "--cell-size", "0.34"]


def arguments(*words):
    parser = argparse.ArgumentParser(exit_on_error=False)
    recovery.add_arguments(parser)
    return parser.parse_args([str(word) for word in words])


def rows_of(folder):
    with open(folder / "recovery.csv", newline="") as file:
        return list(csv.DictReader(file))


def study(folder, comm, *words):
    assert recovery.run(arguments(*SMALL, "-o", folder, *words), comm) == 0
    return rows_of(folder)


@pytest.fixture
def folder(tmp_path, comm):
    return comm.bcast(tmp_path)


@pytest.mark.mpi
def test_continuation_recovers_nearly_incompressible_scattered_cubes(folder, comm):
    rows = study(folder, comm, "--models", "c2_staged", "--seeds", 3)
    assert sorted(int(row["seed"]) for row in rows) == [1, 2, 3]
    assert {row["outcome"] for row in rows} == {"recovered"}
    assert all(int(row["newton"]) <= recovery.ITERATIONS for row in rows)
    assert (folder / "recovery.png").stat().st_size > 0


def test_finished_runs_are_not_run_again(folder, comm):
    first = study(folder, comm, "--models", "c2_staged", "--seeds", 1)
    again = study(folder, comm, "--models", "c2_staged", "--seeds", 2)
    assert again[0] == first[0]
    assert [row["seed"] for row in again] == ["1", "2"]


def test_models_without_extension_and_energy_end_in_a_row_of_their_own(folder, comm):
    rows = study(folder, comm, "--models", "ife,corotated", "--seeds", 1)
    assert {row["model"] for row in rows} == {"ife", "corotated"}
    assert all(row["outcome"] in ("recovered", "untangled", "tangled", "failed") for row in rows)
    assert all((row["end"] == "converged") == (row["krylov"] != "") for row in rows)


def test_a_start_without_random_numbers_is_run_once():
    args = arguments("--models", "c2", "--starts", "point,noisy_point", "--poisson-ratios", "0.3", "--seeds", 3)
    assert [case[1] for case in recovery.cases(args)] == ["point"] + ["noisy_point"] * 3


def test_the_whole_map_is_the_default():
    args = arguments()
    assert len(list(recovery.cases(args))) == 6 * 6 * (4 * 5 + 1)


def test_sentences_count_what_recovered():
    good = {"model": "c2", "outcome": "recovered", "newton": "30", "seconds": "1.5", "end": "converged"}
    bad = {**good, "outcome": "tangled", "newton": "3", "end": "SNES DIVERGED_LINE_SEARCH, KSP CONVERGED_RTOL"}
    assert sentences([good, bad, bad]) == [
        "C2 Neo-Hookean: recovers in 1 of 3 runs, with 30 Newton iterations in 1.5 s (median), at most 30 and 1.5 s; "
        "2 stay tangled (2 stopped in the line search)."
    ]


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--models", "c3"], "c3: unknown"),
        (["--starts", "scatter"], "scatter: unknown"),
        (["--poisson-ratios", "0.5"], "0.5: each must be above -1 and below 0.5"),
        (["--poisson-ratios", "soft"], "soft: not a number"),
        (["--seeds", "1.5"], "1.5: must be a whole number, 1 or more"),
        (["--cell-size", "0"], "0: must be a number above 0"),
    ],
)
def test_bad_arguments_are_named(words, message):
    with pytest.raises(argparse.ArgumentError) as error:
        arguments(*words)
    assert message in str(error.value)


def test_a_table_of_something_else_is_not_touched(folder, comm):
    path = folder / "recovery.csv"
    path.write_text("time,energy\n0,1\n")
    with pytest.raises(InputError, match="its columns are not of this study"):
        recovery.run(arguments(*SMALL, "-o", folder), comm)
    assert path.read_text() == "time,energy\n0,1\n"
