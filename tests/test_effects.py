"""Only the effects a scene calls for: what is absent has no event, library or array; each alone adds only its own."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from effects_runs import PLAIN, WITH

from extremal.app.effects import EFFECTS, Effect, effect

# what runs in every scene of a part
ALWAYS = {"elastic": ("elasticity",), "snow": ("snow",), "hawkes": ("reconstruction", "simulation")}
# an effect that cannot be had without others
NEEDS = {
    "damping": ("inertia",),
    "hardening": ("plasticity",),
    "continuation": ("extension",),
    "solid": ("elastic elasticity", "elastic inertia"),
}
# packages of which an effect may load any module
PACKAGES = {"solid": ("extremal.forms.", "extremal.meshes.")}
# libraries that a scene without pictures, meshes from gmsh or volumes has no need of
HEAVY = {"elastic": ("gmsh", "matplotlib", "pyopenvdb"), "snow": ("dolfinx", "gmsh", "matplotlib", "scipy", "sympy")}
HEAVY["hawkes"] = (*HEAVY["snow"], "meshio")
# other packages of ours, and what belongs to another part
OTHERS = {"elastic": ("mpm", "hawkes"), "snow": ("forms", "meshes", "hawkes"), "hawkes": ("forms", "meshes", "mpm")}
CASES = [(part, name) for part, effects in WITH.items() for name in effects]
Runs = dict[str, dict[str, Any]]


@pytest.fixture(scope="module")
def found(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Runs]:
    """What the runs of a part tell, made once; PETSc is not the one that this process has started."""
    made: dict[str, Runs] = {}

    def of(part: str) -> Runs:
        if part not in made:
            command = [sys.executable, str(Path(__file__).with_name("effects_runs.py")), part]
            done = subprocess.run(command, capture_output=True, text=True, timeout=240, env=dict(os.environ))
            assert done.returncode == 0, done.stderr
            made[part] = json.loads(done.stdout.splitlines()[-1])
        return made[part]

    return of


def own(part: str, name: str) -> list[Effect]:
    found = [effect(part, name)]
    for each in NEEDS.get(name, ()):
        *other, plain = each.split()
        found.append(effect(*other or [part], plain))
    return found


@pytest.mark.parametrize("part", PLAIN)
def test_in_a_minimal_scene_what_is_absent_costs_nothing(found: Callable[[str], Runs], part: str) -> None:
    plain = found(part)["plain"]
    always = [effect(part, name) for name in (*ALWAYS[part], "output", "checkpoint")]
    # a body that is at rest needs no tangent
    expected = {event for each in always for event in each.events} - {"elastic:elasticity:tangent"}
    assert plain["code"] == 0
    assert set(plain["events"]) == expected
    assert set(plain["effects"]) == set(ALWAYS[part])
    others = [each for each in EFFECTS if each.part in (part, "any") and each not in always]
    brought = {library for each in others for library in each.brings} - set(always[0].brings)
    assert not set(plain["libraries"]) & (brought | set(HEAVY[part]))
    assert not [m for m in plain["libraries"] if m.startswith(tuple(f"extremal.{other}." for other in OTHERS[part]))]


@pytest.mark.parametrize(("part", "name"), CASES, ids=[" ".join(case) for case in CASES])
def test_an_effect_alone_adds_its_own_events_and_libraries_only(
    found: Callable[[str], Runs], part: str, name: str
) -> None:
    plain, run = found(part)["plain"], found(part)[name]
    mine = own(part, name)
    assert run["code"] == 0
    added = set(run["events"]) - set(plain["events"]) - {"elastic:elasticity:tangent"}
    assert added == {event for each in mine for event in each.events} - {"elastic:elasticity:tangent"}
    assert set(plain["events"]) - set(run["events"]) <= {"elastic:elasticity:energy"}  # follower loads have none
    listed = {each.name for each in mine if each.where[0].split(".")[0] != "app"}
    assert set(run["effects"]) - set(plain["effects"]) <= listed
    ours = {library for library in run["libraries"] if library.startswith("extremal.")}
    ours = {library for library in ours if not library.startswith(PACKAGES.get(name, ("nothing",)))}
    assert ours <= {library for each in mine for library in each.brings} | SAME_PICTURE.get((part, name), set())
    here = [each for each in EFFECTS if each.part in (part, "any")]
    heavy = set(run["libraries"]) & {library for each in here for library in each.brings}
    assert heavy <= {library for each in mine for library in each.brings}


SAME_PICTURE = {
    ("elastic", "summary"): {"extremal.app.summary"},
    ("snow", "summary"): {
        *(f"extremal.app.{name}" for name in ("snow_summary", "snow_picture", "scenery", "view")),
        "extremal.obstacles.isosurface",
    },
    ("hawkes", "summary"): {"extremal.app.hawkes_summary", "extremal.app.hawkes_picture"},
}


@pytest.mark.parametrize(
    ("part", "name", "arrays"),
    [("snow", "gradients", {"elastic_gradient", "plastic_gradient"}), ("hawkes", "mean_field", {"probabilities"})],
)
def test_arrays_of_an_effect_are_there_with_it_only(
    found: Callable[[str], Runs], part: str, name: str, arrays: set[str]
) -> None:
    runs = found(part)
    assert set(runs[name]["arrays"]) - set(runs["plain"]["arrays"]) == arrays
    others = [run for each, run in runs.items() if each not in (name, "gibbs", "exact")]
    assert not [run for run in others if arrays & set(run["arrays"])]


def test_every_effect_that_run_json_can_list_is_in_the_ledger_and_every_event_too(
    found: Callable[[str], Runs],
) -> None:
    for part in PLAIN:
        names = {e.name for e in EFFECTS if e.part == part}
        events = {event for e in EFFECTS for event in e.events}
        for run in found(part).values():
            assert set(run["effects"]) <= names
            assert set(run["events"]) <= events


def line(each: Effect) -> str:
    """The row of docs/effects.md about an effect."""
    names = (", ".join(f"`{name}`" for name in names) for names in (each.where, each.events, each.brings))
    return " | ".join((f"| {each.name}", f"`{each.keys}`", each.work, *names)) + " |"


@pytest.mark.parametrize("each", EFFECTS, ids=lambda each: f"{each.part} {each.name}")
def test_the_guide_has_the_ledger(each: Effect) -> None:
    guide = Path(__file__).resolve().parent.parent / "docs" / "effects.md"
    assert line(each) in guide.read_text().splitlines()


def test_the_ledger_names_modules_that_exist() -> None:
    import importlib.util

    missing = [m for e in EFFECTS for m in e.where if importlib.util.find_spec(f"extremal.{m}") is None]
    assert not missing
