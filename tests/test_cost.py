"""`extremal check --cost` is right to a factor of three, and names what is dearest."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

from extremal.app import cli
from extremal.app.cost import Cost, estimate
from extremal.app.effects import EFFECTS
from extremal.app.scene import read_scene

SCENES = Path(__file__).resolve().parent.parent / "app" / "scenes"
FACTOR = 3.0  # what the estimate promises: iterations of a step cannot be known before


def estimated_and_found(name: str, launch: Callable[..., subprocess.CompletedProcess[str]], out: Path) -> tuple:
    """The estimate for a shipped scene, and run.json of its run."""
    path = SCENES / f"{name}.toml"
    scene = read_scene(path)
    done = launch(0, "-m", "extremal.app", scene.part, path, "-o", out, "--quiet")
    assert done.returncode == 0, done.stderr
    return estimate(scene), json.loads((out / "run.json").read_text())


@pytest.mark.parametrize("name", ["scattered_cube", "falling_block", "estimate"])
def test_memory_of_a_shipped_scene_is_right_to_a_factor_of_three(
    name: str, launch: Callable[..., subprocess.CompletedProcess[str]], tmp_path: Path
) -> None:
    expected, found = estimated_and_found(name, launch, tmp_path / "out")
    assert 1 / FACTOR < expected.bytes / found["peak_memory_bytes"][0] < FACTOR


@pytest.mark.long  # seconds mean something on a machine that has nothing else to do
@pytest.mark.parametrize("name", ["scattered_cube", "falling_block", "estimate", "twist"])
def test_seconds_of_a_shipped_scene_are_right_to_a_factor_of_three(
    name: str, launch: Callable[..., subprocess.CompletedProcess[str]], tmp_path: Path
) -> None:
    expected, found = estimated_and_found(name, launch, tmp_path / "out")
    seconds = found["run_cpu_seconds"][0] / found["steps"]
    assert 1 / FACTOR < expected.seconds_per_step / seconds < FACTOR


@pytest.mark.parametrize(
    ("name", "dearest"),
    [("snowball_drop", "implicit"), ("heterogeneous", "gibbs"), ("incidents", "estimation"), ("twist", "elasticity")],
)
def test_the_dearest_effect_is_named(name: str, dearest: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["check", "--cost", str(SCENES / f"{name}.toml")]) == 0
    told = capsys.readouterr().out.splitlines()
    assert len(told) == 2 and f"most goes to {dearest} (" in told[1]


def test_what_is_estimated_is_in_the_ledger() -> None:
    costs: dict[str, Cost] = {}
    for name in ("bounce", "recovery", "collapsed_cube", "snowball_drop", "complete6", "heterogeneous", "estimate"):
        scene = read_scene(SCENES / f"{name}.toml")
        costs[name] = estimate(scene)
        names = {effect.name for effect in EFFECTS if effect.part in (scene.part, "any")}
        assert set(costs[name].shares) <= names
        assert all(seconds > 0 for seconds in costs[name].shares.values())


def test_a_mesh_that_cannot_be_made_is_told_by_check(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text = (SCENES / "twist.toml").read_text()
    (tmp_path / "fine.toml").write_text(text.replace("cell_size = ", "cell_size = 1e-9 # "))
    assert cli.main(["check", "--cost", str(tmp_path / "fine.toml")]) == 2
    assert "cells; at most 2e+07 are accepted" in capsys.readouterr().err
