"""A scene of networks is read with the source's parameters; a bad one is refused with a plain line for each error."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from bad_scenes import cases, keys, refusal

from extremal.app import cli
from extremal.app.hawkes_scene import HawkesScene
from extremal.app.scene import read_scene, validate

# what a case does not give itself
NETWORK = "[network]\nagents = 6\n"
SIMULATION = "[simulation]\ncount = 400\nincomplete = 100\n"
CASES = cases("bad_hawkes_scenes.txt")

FULL = """
title = "everything at once"
part = "hawkes"
[network]
file = "network.csv"
background = 0.02
[events]
file = "events.csv"
unit = "hours"
begin = 2024-01-01
end = "2024-03-01T12:00"
[estimation]
rounds = 30
per_pair = true
shrinkage = 3
[method]
sweeps = 2
gap = 1e-6
probabilities = "gibbs"
samples = 50
[output]
candidates = 3
[petsc]
hawkes_tao_type = "tron"
[expect]
status = "finished"
drift = { below = 0.1 }
"""


@pytest.mark.parametrize("case", CASES, ids=[case[0] for case in CASES])
def test_bad_networks_are_refused_in_plain_words(case: list[str], tmp_path: Path) -> None:
    text, *messages = case
    network = "" if "network" in text else NETWORK
    simulation = "" if "[events]" in text or "[simulation]" in text else SIMULATION
    lines = refusal(tmp_path / "scene.toml", "\n".join(['part = "hawkes"', text, network, simulation]))
    assert lines == [message.replace("{here}", str(tmp_path)) for message in messages]


def test_there_are_many_distinct_messages() -> None:
    assert len({message for case in CASES for message in case[1:]}) >= 50


def test_a_missing_table_is_named(tmp_path: Path) -> None:
    (line,) = refusal(tmp_path / "scene.toml", 'part = "hawkes"\n' + SIMULATION)
    assert line == "[network]: is missing; who may have an event with whom"
    (line,) = refusal(tmp_path / "scene.toml", 'part = "hawkes"\n' + NETWORK)
    assert line == "[events]: is missing; give [events] with a file, or [simulation]"


@pytest.fixture
def full(tmp_path: Path) -> HawkesScene:
    (tmp_path / "network.csv").write_text("first,second\nA,B\nB,C\n")
    (tmp_path / "events.csv").write_text("time,first,second\n2024-01-05,A,\n2024-01-04,B,C\n")
    path = tmp_path / "full.toml"
    path.write_text(FULL)
    return read_scene(path)


def test_every_key_is_read(full: HawkesScene) -> None:
    assert isinstance(full, HawkesScene)
    assert full.events is not None and (full.events.unit, full.events.begin) == ("hours", "2024-01-01")
    assert full.estimation is not None and full.estimation.shrinkage == 3
    assert (full.method.sweeps, full.method.probabilities, full.method.samples) == (2, "gibbs", 50)
    assert (full.output.candidates, full.network.background) == (3, 0.02)
    assert (full.analysis.end_time, full.analysis.adaptive) == (31, False)  # rounds, and the reconstruction
    assert json.loads(full.model_dump_json())["events"]["end"] == "2024-03-01T12:00"


def test_defaults_are_those_of_section_3_4() -> None:
    tables = {"part": "hawkes", "network": {"agents": 6}, "simulation": {"count": 400, "incomplete": 100}}
    scene = validate(tables)
    assert (scene.network.background, scene.network.branching, scene.network.decay) == (0.01, 0.5, 0.1)
    assert scene.simulation.missing == "one"
    assert scene.method.is_default and scene.method.gap == 1e-8
    assert scene.method.probabilities == "mean_field"
    assert scene.analysis.end_time == 1


def test_every_key_says_its_meaning() -> None:
    assert [key for key, meaning in keys(HawkesScene) if not meaning] == []


def test_check_reads_the_tables_and_says_what_is_in_them(
    full: HawkesScene, capsys: pytest.CaptureFixture[str]
) -> None:
    assert full.path is not None
    assert cli.main(["check", str(full.path)]) == 0
    events = full.path.parent / "events.csv"
    assert capsys.readouterr().out == (
        f"{full.path}: good: hawkes, 3 agents, 2 pairs, 2 events of which 1 are incomplete, parameters estimated in 30 "
        f"rounds, {events}: 1 of 2 events are earlier than the one before: sorted, 2 expected\n"
    )


def test_check_reports_errors_in_the_tables(full: HawkesScene, capsys: pytest.CaptureFixture[str]) -> None:
    assert full.path is not None
    events = full.path.parent / "events.csv"
    events.write_text("time,first,second\n2024-01-05,A,D\n")
    assert cli.main(["check", str(full.path)]) == 2
    assert f'{events}: line 2: second = "D": is no agent of the network' in capsys.readouterr().err


def test_checking_networks_loads_no_heavy_library(full: HawkesScene) -> None:
    program = (
        "import json, sys; from extremal.app import cli; assert cli.main(['check', sys.argv[1]]) == 0;"
        "print(json.dumps(sorted({m.split('.')[0] for m in sys.modules})))"
    )
    words = [sys.executable, "-c", program, str(full.path)]
    done = subprocess.run(words, capture_output=True, text=True, check=True, env=os.environ)
    heavy = {"dolfinx", "gmsh", "matplotlib", "petsc4py", "sympy", "h5py", "meshio", "scipy"}
    assert not set(json.loads(done.stdout.splitlines()[-1])) & heavy
