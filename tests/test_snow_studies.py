"""The studies of snow run and tell what they measured; no time is tested."""

import argparse
import csv
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

from extremal.app import study_command
from extremal.app.errors import InputError
from extremal.app.studies import snow_cost, snow_effects, snow_iterations
from extremal.app.studies._snow_runs import steps


def arguments(study, *words):
    parser = argparse.ArgumentParser()
    study.add_arguments(parser)
    return parser.parse_args([str(word) for word in words])


def rows_of(path):
    with open(path, newline="") as file:
        return list(csv.DictReader(file))


def test_a_study_is_named_as_people_write_it():
    assert study_command._name("table_3_1") == "table-3.1"
    assert study_command._name("snow_cost") == "snow-cost"
    assert {"snow-cost", "snow-effects", "snow-iterations", "cost"} <= {*study_command.names()}


def test_a_study_is_found_by_its_name():
    assert study_command._module("snow-cost") is snow_cost


def test_snow_cost_tells_every_part_of_a_step_and_what_two_ranks_bring(tmp_path, comm, capsys):
    args = arguments(snow_cost, "--quick", "-o", tmp_path, "--taichi", tmp_path / "python")
    assert snow_cost.run(args, comm) == 0
    rows = {row["quantity"]: row for row in rows_of(tmp_path / "cost.csv")}
    assert set(snow_cost.PARTS.values()) <= {name.removeprefix("- ") for name in rows}
    assert all(float(row["ours_ns"]) > 0 for name, row in rows.items() if name != "- everything else")
    (ranks,) = rows_of(tmp_path / "ranks.csv")
    assert (ranks["step"], ranks["particles"]) == ("explicit", rows["explicit step"]["particles"])
    assert float(ranks["one_rank_ms"]) > 0
    assert "one iteration, single precision" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("python", "reason"),
    [(Path("nowhere/python"), "nowhere/python is not there"), (Path(sys.executable), "No module named 'taichi'")],
)
def test_without_taichi_its_row_says_why(python, reason):
    law = SimpleNamespace(young_modulus=1.0, poisson_ratio=0.2, density=1.0, hardening=10.0)
    law.critical_compression = law.critical_stretch = 0.01
    start = SimpleNamespace(position=[[0.0, 0.0, 0.0]], velocity=[[0.0, 0.0, 0.0]], mass=[1.0])
    seconds, note = snow_cost._taichi(python, start, 1.0, law, 1.0, 1, 0.0)
    assert seconds is None
    assert reason in note


def test_snow_cost_wants_a_core_for_itself():
    with pytest.raises(InputError, match="run it without mpirun"):
        snow_cost.run(argparse.Namespace(), SimpleNamespace(size=2))


@pytest.mark.mpi
def test_a_smaller_tolerance_takes_more_iterations(shared_path, comm):
    assert snow_iterations.run(arguments(snow_iterations, "--quick", "-o", shared_path), comm) == 0
    rows = comm.bcast(rows_of(shared_path / "iterations.csv") if comm.rank == 0 else None)
    runs = {}
    for row in rows:
        assert int(row["full_steps"]) == int(row["steps"]) == 10
        runs.setdefault((row["scene"], row["cell_size"]), []).append(float(row["mean"]))
    assert len(runs) == 4
    assert all(loose < tight for loose, tight in runs.values())


@pytest.mark.mpi
def test_an_effect_that_is_off_does_no_work(shared_path, comm):
    assert snow_effects.run(arguments(snow_effects, "--quick", "-o", shared_path), comm) == 0
    rows = comm.bcast(rows_of(shared_path / "effects.csv") if comm.rank == 0 else None)
    missing = {row["run"]: row["missing"] for row in rows}
    assert missing == {
        "everything": "",
        "no colliders": "snow:colliders",
        "explicit steps": "snow:implicit",
        "no F_E, no F_P": "snow:gradients",
    }
    assert {row["run"]: float(row["krylov"]) > 0 for row in rows}["explicit steps"] is False


@pytest.mark.mpi
def test_gradients_take_memory_only_where_they_are_asked_for(comm):
    rows = [snow_effects.measure(comm, name, snow_effects.COARSE, 2) for name in ("everything", "no F_E, no F_P")]
    with_them, without = (int(row["array_bytes"]) for row in rows)
    assert with_them - without == 2 * 9 * 8


class Stubborn:
    """A problem that never takes a step longer than it likes, and says how long that is only after a failure."""

    def __init__(self, likes):
        self.time, self.likes = 0.0, likes

    def advance(self, dt):
        if dt > self.likes:
            error = ArithmeticError("too long")
            error.wanted_step = self.likes
            raise error
        self.time += dt
        return {"krylov_iterations": 3.0, "wanted_step": self.likes}


def test_steps_are_as_long_as_the_problem_likes_and_end_in_time():
    problem = Stubborn(0.3)
    made = [step.dt for step in steps(problem, 0.5, 1.0)]
    assert made == pytest.approx([0.3, 0.3, 0.3, 0.1])


def test_steps_give_up_where_they_become_a_thousand_times_shorter():
    with pytest.raises(ArithmeticError, match="too long"):
        list(steps(Stubborn(1e-4), 0.5, 1.0))
