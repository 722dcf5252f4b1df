"""A scene of networks becomes tables, the same on any number of ranks, and can be gone on with."""

import csv
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI

from extremal.app import cli
from extremal.app.hawkes import build, simulated
from extremal.app.results import read_table
from extremal.app.scene import validate

Launch = Callable[..., subprocess.CompletedProcess[str]]

SIMULATED = {
    "part": "hawkes",
    "network": {"agents": 5},
    "simulation": {"count": 300, "incomplete": 120},
    "output": {"summary": False},
}
ESTIMATION = {"estimation": {"rounds": 12}, "output": {"summary": False, "checkpoint_every": 3}}
CASES = {
    "(3.5)": {},
    "(3.6)": {"method": {"p": 1}},
    "hybrid": {"method": {"hybrid": 0.5}},
    "(3.4)": {"method": {"functional": "normalised"}, "simulation": {"count": 40, "incomplete": 5}},
    "gibbs": {"method": {"probabilities": "gibbs", "samples": 20}},
    "exact": {"method": {"probabilities": "exact"}, "simulation": {"count": 60, "incomplete": 6}},
    "no probabilities": {"method": {"probabilities": "none"}},
    "both unknown": {"simulation": {"count": 100, "incomplete": 40, "missing": "both"}},
    "under-reported": {"simulation": {"duration": 2000.0, "incomplete": 50, "unreported": 0.3}},
    "estimation": ESTIMATION,
    "per pair": ESTIMATION | {"estimation": {"rounds": 4, "per_pair": True}},
    "nothing incomplete": {"simulation": {"count": 50, "incomplete": 0}},
}


def toml(table: dict) -> str:
    """A scene of tables of plain values."""
    plain = {k: v for k, v in table.items() if not isinstance(v, dict)}
    parts = {"": plain} | {k: v for k, v in table.items() if isinstance(v, dict)}
    lines = []
    for name, part in parts.items():
        lines += [f"[{name}]"] * bool(name) + [f"{key} = {json.dumps(value)}" for key, value in part.items()]
    return "\n".join(lines) + "\n"


def write(folder: Path, table: dict) -> Path:
    """The scene's file."""
    path = folder / "scene.toml"
    path.write_text(toml(table))
    return path


def table(path: Path) -> list[dict[str, str]]:
    """Rows of a table."""
    with open(path, newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def record(folder: Path) -> dict:
    """run.json."""
    return json.loads((folder / "run.json").read_text())


# ------------------------------------------------------------- results


def answer(tables: dict, comm: MPI.Comm) -> dict[str, dict]:
    """The tables of a run; {} on ranks other than 0."""
    scene = validate(tables)
    run = build(scene, comm)
    while run.time < scene.analysis.end_time:
        run.advance(1.0)
        run.time += 1
    return run.tables()


def assert_same(first: dict[str, dict], second: dict[str, dict]) -> None:
    """The same pairs in the same order, and numbers that differ by rounding only."""
    assert set(first) == set(second)
    for file in {"predictions.csv", "parameters.csv", "scores.csv"} & set(first):
        assert list(first[file]) == list(second[file])
        for column, values in first[file].items():
            if column == "certificate":  # a bound that nearly vanishes: rounding is all there is to it
                continue
            if any(isinstance(value, str) for value in values):
                assert list(values) == list(second[file][column]), (file, column)
            else:
                # sampling and estimation use the same random numbers on any number of ranks
                pair = (np.array(t[file][column], dtype=float) for t in (first, second))
                np.testing.assert_allclose(*pair, rtol=0, atol=1e-10, err_msg=f"{file}: {column}")


@pytest.mark.mpi
@pytest.mark.parametrize("name", CASES)
def test_answers_are_those_of_one_rank(name: str, comm: MPI.Intracomm) -> None:
    tables = SIMULATED | CASES[name]
    together, alone = answer(tables, comm), answer(tables, MPI.COMM_SELF)
    if comm.rank == 0:
        assert_same(together, alone)


def test_the_command_gives_equal_predictions_on_one_two_and_three_ranks(tmp_path: Path, launch: Launch) -> None:
    scene = write(tmp_path, SIMULATED)
    runs = []
    for ranks in (0, 2, 3):
        folder = tmp_path / f"ranks{ranks}"
        done = launch(ranks, "-m", "extremal.app", "hawkes", scene, "-o", folder, "--quiet")
        assert done.returncode == 0, done.stderr
        runs.append(table(folder / "predictions.csv"))
    for rows in runs[1:]:
        assert len(rows) == len(runs[0])
        for row, its in zip(runs[0], rows):
            assert [row[k] for k in ("event", "first", "second")] == [its[k] for k in ("event", "first", "second")]
            for key in ("weight", "probability"):
                assert float(row[key]) == pytest.approx(float(its[key]), abs=1e-10)


def test_predictions_rank_the_pairs_of_each_incomplete_event(tmp_path: Path) -> None:
    scene = write(tmp_path, SIMULATED | {"output": {"candidates": 3, "summary": False}})
    assert cli.main(["hawkes", str(scene), "-o", str(tmp_path / "r"), "--quiet"]) == 0
    rows, events = table(tmp_path / "r" / "predictions.csv"), table(tmp_path / "r" / "events.csv")
    incomplete = {row["event"]: row for row in events if not (row["first"] and row["second"])}
    assert len(incomplete) == 120 and len(rows) == 3 * 120
    for k in range(0, len(rows), 3):
        some = rows[k : k + 3]
        event = incomplete[some[0]["event"]]
        assert [row["rank"] for row in some] == ["1", "2", "3"]
        weights = [float(row["weight"]) for row in some]
        assert weights == sorted(weights, reverse=True)
        known = event["first"] or event["second"]
        for row in some:
            assert known in (row["first"], row["second"])
            truth = {event["true_first"], event["true_second"]} == {row["first"], row["second"]}
            assert row["true"] == str(int(truth))
            assert 0 < float(row["probability"]) < 1 and float(row["certificate"]) <= 1e-8


def test_all_candidates_together_have_weights_of_length_one_and_probabilities_of_sum_one(tmp_path: Path) -> None:
    scene = write(tmp_path, SIMULATED)
    assert cli.main(["hawkes", str(scene), "-o", str(tmp_path / "r"), "--quiet"]) == 0
    rows = table(tmp_path / "r" / "predictions.csv")
    event = np.array([int(row["event"]) for row in rows])
    for column, power in (("weight", 2), ("probability", 1)):
        values = np.array([float(row[column]) for row in rows]) ** power
        # written with 12 decimals
        assert np.bincount(event, weights=values)[np.unique(event)] == pytest.approx(1, abs=1e-11)


def test_expected_numbers_of_events_are_those_of_the_data(tmp_path: Path) -> None:
    scene = write(tmp_path, SIMULATED)
    assert cli.main(["hawkes", str(scene), "-o", str(tmp_path / "r"), "--quiet"]) == 0
    rows = table(tmp_path / "r" / "parameters.csv")
    assert sum(int(row["complete"]) for row in rows) == 180
    assert sum(float(row["attributed"]) for row in rows) == pytest.approx(120, abs=1e-4)


def test_scores_are_diagnostics_and_a_table(tmp_path: Path) -> None:
    scene = write(tmp_path, SIMULATED)
    assert cli.main(["hawkes", str(scene), "-o", str(tmp_path / "r"), "--quiet"]) == 0
    found = record(tmp_path / "r")["diagnostics"]
    scores = {row["answer"]: row for row in table(tmp_path / "r" / "scores.csv")}
    assert set(scores) == {"weights", "probabilities", "guessing", "frequent", "linear"}
    assert float(scores["weights"]["top1"]) == found["top1"]
    assert found["top1_low"] < found["top1"] < found["top1_high"]
    assert found["top1"] <= found["top2"] <= found["top3"]
    assert found["log_loss_guessing"] == pytest.approx(np.log(4))  # one of two is known: four pairs are left
    assert found["log_loss"] < found["log_loss_guessing"]


@pytest.mark.hard
def test_events_that_no_pair_explains_are_listed(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "network.csv").write_text("first,second,background,branching\nA,B,,\nB,C,,\nD,E,0,0\n")
    rows = ["1,A,B", "2,A,C", "3,,D", "4,D,E", "5,B,", "6,,"]
    (tmp_path / "events.csv").write_text("\n".join(["time,first,second", *rows]) + "\n")
    scene = {"part": "hawkes", "network": {"file": "network.csv"}, "events": {"file": "events.csv"}}
    path = write(tmp_path, scene | {"expect": {"unresolvable": 3, "incomplete": 3}})
    assert cli.main(["hawkes", str(path), "-o", str(tmp_path / "r"), "--quiet"]) == 0
    assert "3 of 6 events are on no active pair: see unresolvable.csv" in capfd.readouterr().out
    listed = [(row["event"], row["reason"]) for row in table(tmp_path / "r" / "unresolvable.csv")]
    assert listed == [
        ("3", "no active pair of the network"),
        ("4", "no active pair could explain it"),
        ("5", "no active pair of the network"),
    ]
    assert {row["event"] for row in table(tmp_path / "r" / "predictions.csv")} == {"6", "7"}
    assert (tmp_path / "r" / "summary.png").stat().st_size > 10_000


def test_simulated_events_written_and_read_again_give_the_same_answer(tmp_path: Path) -> None:
    scene = write(tmp_path, SIMULATED)
    assert cli.main(["hawkes", str(scene), "-o", str(tmp_path / "a"), "--quiet"]) == 0
    tables = {"network": {"agents": 5}, "events": {"file": "a/events.csv", "begin": 0}}
    again = write(tmp_path, {"part": "hawkes", **tables, "output": {"summary": False}})
    assert cli.main(["hawkes", str(again), "-o", str(tmp_path / "b"), "--quiet"]) == 0
    first, second = (table(tmp_path / name / "predictions.csv") for name in "ab")
    assert len(first) == len(second)
    for row, its in zip(first, second):
        assert int(its["event"]) == int(row["event"]) + 1  # the line, below the header
        assert [row[k] for k in ("first", "second", "weight")] == [its[k] for k in ("first", "second", "weight")]


def test_effects_are_named_with_their_cost(tmp_path: Path) -> None:
    scene = write(tmp_path, SIMULATED | ESTIMATION)
    assert cli.main(["hawkes", str(scene), "-o", str(tmp_path / "r"), "--quiet"]) == 0
    effects = record(tmp_path / "r")["effects"]
    assert set(effects) == {"reconstruction", "mean_field", "estimation", "simulation"}
    assert all(effect["seconds"] > 0 for effect in effects.values())


# ------------------------------------------------------------- going on


def test_a_killed_estimation_goes_on_to_the_same_end(tmp_path: Path) -> None:
    scene = write(tmp_path, SIMULATED | {**ESTIMATION, "estimation": {"rounds": 40}})
    words = [sys.executable, "-m", "extremal.app", "hawkes", str(scene), "-o"]
    whole, part = tmp_path / "whole", tmp_path / "part"
    subprocess.run([*words, str(whole), "--quiet"], check=True, env=os.environ, capture_output=True)
    run = subprocess.Popen([*words, str(part), "--quiet"], env=os.environ, stdout=subprocess.DEVNULL)
    try:
        deadline = time.monotonic() + 60
        while not list((part / "checkpoints").glob("step_*.h5")) and time.monotonic() < deadline:
            time.sleep(0.005)
        run.send_signal(signal.SIGKILL)
    finally:
        run.wait()
    assert not (part / "predictions.csv").exists()
    done = subprocess.run([*words, str(part), "--restart"], env=os.environ, capture_output=True, text=True)
    assert done.returncode == 0 and "restarted from" in done.stdout
    for file in ("predictions.csv", "parameters.csv", "scores.csv"):
        assert (part / file).read_text() == (whole / file).read_text()
    before, after = (read_table(folder / "history.csv")[1] for folder in (whole, part))
    drop = ("wall",)
    strip = [[{k: v for k, v in row.items() if k not in drop} for row in rows] for rows in (before, after)]
    assert strip[0] == strip[1]


def test_a_run_goes_on_with_another_number_of_ranks(tmp_path: Path, launch: Launch) -> None:
    scene = write(tmp_path, SIMULATED | ESTIMATION)
    folder = tmp_path / "r"
    words = ["-m", "extremal.app", "hawkes", scene, "-o", folder]
    assert launch(0, *words).returncode == 0
    before = table(folder / "predictions.csv")
    checkpoint = folder / "checkpoints" / "step_000012.h5"
    assert checkpoint.exists()
    assert launch(2, *words, "--restart", checkpoint).returncode == 0
    weights = [np.array([float(row["weight"]) for row in rows]) for rows in (before, table(folder / "predictions.csv"))]
    assert weights[0] == pytest.approx(weights[1], abs=1e-10)


def test_other_data_are_refused_at_a_restart(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "network.csv").write_text("first,second\nA,B\nB,C\n")
    (tmp_path / "events.csv").write_text("time,first,second\n1,A,B\n2,B,\n")
    scene = {"part": "hawkes", "network": {"file": "network.csv"}, "events": {"file": "events.csv"}}
    words = ["hawkes", str(write(tmp_path, scene)), "-o", str(tmp_path / "r"), "--quiet"]
    assert cli.main(words) == 0
    (tmp_path / "events.csv").write_text("time,first,second\n1,A,B\n3,B,\n")
    assert cli.main([*words, "--restart"]) == 2
    assert capsys.readouterr().err.endswith("step_000001.h5: network or events have been changed since\n")


# ------------------------------------------------------------- failures


def test_a_gap_out_of_reach_is_a_failure_that_says_where_tao_stands(tmp_path: Path, launch: Launch) -> None:
    scene = write(tmp_path, SIMULATED | {"network": {"agents": 6, "decay": 5.0}})
    folder = tmp_path / "r"
    words = ["-m", "extremal.app", "hawkes", scene, "-o", folder, "--quiet"]
    done = launch(2, *words, "-hawkes_tao_max_it", 1)
    assert done.returncode == 3
    assert "TAO ended with DIVERGED_MAXITS after 3 iterations at a relative gap of" in done.stderr
    assert record(folder)["status"] == "failed" and not (folder / "predictions.csv").exists()
    # the weights reached are kept: what TAO may not finish in one iteration it finishes from there
    done = launch(0, *words, "--restart")
    assert done.returncode == 0, done.stderr
    assert (folder / "predictions.csv").exists()


def test_bad_tables_end_with_status_2_and_one_line(tmp_path: Path, launch: Launch) -> None:
    (tmp_path / "network.csv").write_text("first,second\nA,B\n")
    (tmp_path / "events.csv").write_text("time,first,second\n1,A,X\n")
    scene = {"part": "hawkes", "network": {"file": "network.csv"}, "events": {"file": "events.csv"}}
    done = launch(2, "-m", "extremal.app", "hawkes", write(tmp_path, scene), "-o", tmp_path / "r")
    assert done.returncode == 2
    line = f'extremal: {tmp_path / "events.csv"}: line 2: second = "X": is no agent of the network; known: A, B'
    assert done.stderr.splitlines()[0] == line
    assert not (tmp_path / "r").exists()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"simulation": {"duration": 10.0, "incomplete": 1000}}, "1000 events to become incomplete: must be from 0 to"),
        (
            {"method": {"probabilities": "exact"}, "simulation": {"count": 300, "incomplete": 100}},
            "100 incomplete events on 10 pairs are too many to go through all allocations",
        ),
    ],
)
def test_what_cannot_be_done_is_said_in_a_line(
    changes: dict, message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scene = write(tmp_path, SIMULATED | changes)
    assert cli.main(["hawkes", str(scene), "-o", str(tmp_path / "r"), "--quiet"]) == 2
    err = capsys.readouterr().err
    assert message in err and err.count("\n") == 1


def test_a_solver_that_does_not_fit_is_refused(tmp_path: Path, launch: Launch) -> None:
    scene = write(tmp_path, SIMULATED | {"petsc": {"hawkes_tao_type": "brgn"}})
    done = launch(0, "-m", "extremal.app", "hawkes", scene, "-o", tmp_path / "r")
    assert done.returncode == 2
    assert "-hawkes_tao_type brgn: must be one of blmvm" in done.stderr


HARD = {
    "one event": ("A,B,1,.5,1", "1,,", "", 0, ""),
    "all pairs silent": ("A,B,0,0,1", "1,A,", "", 0, ""),
    "silent pairs, estimated": ("A,B,0,0,1", "1,A,", "[estimation]\nrounds = 2", 2, "there are no events"),
    "no time passes": ("A,B,1,.5,1", "1,A,", "[estimation]\nrounds = 2", 2, "there are no events, or no time"),
    "all at one time": ("A,B,1,.5,1\nB,C,2,.5,1", "1,B,\n1,B,\n1,A,B", "", 0, ""),
    "no background": ("A,B,0,1,1\nB,C,0,1,.1", "1,B,\n2,B,", "", 0, ""),
    "branching of 50": ("A,B,1,50,1\nB,C,1,.999,1", "1,B,\n2,B,\n3,B,", "", 0, ""),
    "decay in 1e-12 and 1e12": ("A,B,1,.5,1e-12\nB,C,1,.5,1e12", "1,B,\n2,B,\n1e30,B,", "", 0, ""),
    "beyond all numbers": ("A,B,1e300,1e300,1e300\nB,C,1,.5,1", "1,B,\n2,B,\n2,B,", "", 3, "the energy overflows"),
    "awkward names": ('"A, $b_",C', '1,"A, $b_",', "", 0, ""),
}


@pytest.mark.hard
@pytest.mark.parametrize("name", HARD)
def test_hard_data_are_solved_or_refused_in_a_line(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pairs, events, more, status, message = HARD[name]
    columns = "first,second,background,branching,decay" if pairs.count(",") > 2 else "first,second"
    (tmp_path / "network.csv").write_text(f"{columns}\n{pairs}\n")
    (tmp_path / "events.csv").write_text(f"time,first,second\n{events}\n")
    tables = '[network]\nfile = "network.csv"\n[events]\nfile = "events.csv"\n'
    (tmp_path / "scene.toml").write_text(f'part = "hawkes"\n{tables}{more}\n')
    assert cli.main(["hawkes", str(tmp_path / "scene.toml"), "-o", str(tmp_path / "r"), "--quiet"]) == status
    err = capsys.readouterr().err
    assert message in err and err.count("\n") == (status > 0)
    if status == 0:
        rows = table(tmp_path / "r" / "predictions.csv")
        numbers = [float(row[key]) for row in rows for key in ("weight", "probability", "certificate")]
        assert np.isfinite(numbers).all()
        assert all(float(row["certificate"]) <= 1e-8 for row in rows)


# ------------------------------------------------------------- what is loaded


def loaded(folder: Path, scene: Path, *wanted: str) -> set[str]:
    """Which of the modules a run of the scene has loaded."""
    program = (
        "import json, sys; from extremal.app import cli; code = cli.main(sys.argv[3:]); assert code == 0, code;"
        "print(json.dumps([m for m in json.loads(sys.argv[2]) if m in sys.modules]))"
    )
    part = "hawkes" if "hawkes" in scene.read_text() else scene.read_text().split('part = "')[1].split('"')[0]
    words = [sys.executable, "-c", program, "-", json.dumps(wanted), part, str(scene), "-o", str(folder), "--quiet"]
    done = subprocess.run(words, capture_output=True, text=True, env=os.environ, check=True)
    return set(json.loads(done.stdout.splitlines()[-1]))


def test_a_run_on_a_network_loads_neither_dolfinx_nor_gmsh_nor_what_is_not_asked_for(tmp_path: Path) -> None:
    scene = write(tmp_path, SIMULATED)
    strangers = ("dolfinx", "gmsh", "ufl", "sympy", "matplotlib", "meshio", "extremal.mpm", "extremal.forms")
    assert not loaded(tmp_path / "r", scene, *strangers, "extremal.hawkes.estimate")


def test_a_run_of_snow_loads_nothing_of_networks(tmp_path: Path) -> None:
    scene = tmp_path / "snow.toml"
    body = '[[body]]\nshape = "sphere"\ncenter = [0, 0, 0]\nradius = 0.1\n'
    rest = "[analysis]\nend_time = 1e-3\n[output]\nsummary = false\n"
    scene.write_text('part = "snow"\n[grid]\ncell_size = 0.1\n' + body + rest)
    names = ("problem", "slots", "events", "simulate", "kernel")
    assert not loaded(tmp_path / "r", scene, *(f"extremal.hawkes.{name}" for name in names))


@pytest.mark.mpi
def test_every_rank_simulates_the_same(comm: MPI.Intracomm) -> None:
    data = simulated(validate(SIMULATED), comm)
    everyone = comm.allgather((data.events.time.tobytes(), data.events.participants.tobytes()))
    assert len(set(everyone)) == 1
