"""Every scene of app/scenes is a regression test: it says what it shows, and keeps what its [expect] promises."""

import json
import re
import tomllib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI

from extremal.app import cli
from extremal.app.results import read_table
from extremal.app.scene import read_scene

ROOT = Path(__file__).resolve().parent.parent
SCENES = {path.stem: path for path in sorted((ROOT / "app" / "scenes").glob("*.toml"))}
GALLERY = ROOT / "docs" / "gallery.md"
COST = re.compile(r"About (\d+) seconds? on one core")
LONG = 10  # [s] said to be needed, above which a scene is not part of `make test`
# All of snow: its particles wander from rank to rank. The first two of these leave ranks without an element; the other
# elastic ones and networks show little new on several ranks, and are run there by `make test-long`.
PARALLEL = {
    "pulled_tetrahedron", "three_triangles", "scattered_cube", "stretched_bar_corotated", "cantilever",
}  # fmt: skip

SCALE = re.compile(r"`--scale ([\d.]+)` has the ([\d.e]+) particles of table 7\.3")
TABLE_7_3 = {
    "snowball_drop": 3.0e5, "snowball_smash": 3.0e5, "snowball_smash_sticky": 3.0e5, "double_smash": 6.0e5,
    "snowplow": 3.9e6, "rolling_snowball": 7.2e6, "words": 7.5e5, "castle": 1.6e6,
}  # fmt: skip

History = dict[str, np.ndarray]


def header(path: Path) -> str:
    """The comment at the top of a scene."""
    lines = path.read_text(encoding="utf-8").splitlines()
    count = next(i for i, line in enumerate(lines) if not line.startswith("#"))
    return "\n".join(line.lstrip("# ") for line in lines[:count])


def part(path: Path) -> str:
    """The command that runs a scene."""
    return tomllib.loads(path.read_text(encoding="utf-8"))["part"]


def command(name: str) -> str:
    """What a user types to run a scene."""
    return f"extremal {part(SCENES[name])} app/scenes/{name}.toml"


def cost(path: Path) -> int:
    """What a scene says it takes [s]."""
    found = COST.search(header(path))
    return int(found[1]) if found else 0


def marked() -> list:
    """Every scene, marked `long` by the cost it states, on several ranks also where these matter little."""
    shown = PARALLEL | {name for name, path in SCENES.items() if part(path) == "snow"}
    if MPI.COMM_WORLD.size == 1:
        shown = set(SCENES)
    return [
        pytest.param(name, marks=[pytest.mark.mpi, *[pytest.mark.long] * (cost(path) > LONG or name not in shown)])
        for name, path in SCENES.items()
    ]


def grade(exit_code: int, folder: Path) -> str:
    """"finished", or what became of the run instead: failed and why, or the expectations it missed."""
    record = json.loads((folder / "run.json").read_text())
    if record["status"] != "finished":
        return f"{record['status']}: {record['reason']}"
    missed = [f"{e['name']} {e['wanted']}, found {e['found']}" for e in record["expect"] if not e["met"]]
    if missed:
        return "missed: " + "; ".join(missed)
    return "finished" if exit_code == 0 else f"exit code {exit_code}"


# ------------------------------------------------------------- what no final figure can tell


def one_triangle_is_inverted_for_a_while(history: History) -> None:
    inverted = history["inverted"]
    assert (inverted[0], inverted.max(), inverted[-1]) == (0, 1, 0)


def energy_goes_to_and_fro_and_stays(history: History) -> None:
    # the midpoint rule keeps linear invariants; energy only to second order in the step
    assert np.all(np.abs(history["energy"] / history["energy"][0] - 1) < 0.01)
    moving = history["kinetic_energy"] / history["energy"]
    assert moving[0] == pytest.approx(1)
    assert moving.min() < 0.1
    assert moving[np.argmin(moving) :].max() > 0.9


def law_thins_by_poisson_ratio_times_stretch(history: History) -> None:
    # height 1 m, pulled by 2 m until t = 1: σ2 = σ3 = 1 - ν (σ1 - 1)
    assert history["smallest_stretch"] == pytest.approx(1 - 0.45 * 2.0 * history["time"], abs=1e-6)


def more_and_more_elements_invert(history: History) -> None:
    assert history["inverted"][0] == 0
    assert np.all(np.diff(history["inverted"]) >= 0)


def recovery_dissipates(history: History) -> None:
    assert np.all(np.diff(history["energy"]) < 0)


def balls_come_to_rest_with_their_energy_in_store(history: History) -> None:
    start, rest = history["energy"][0], np.argmin(history["kinetic_energy"])
    assert history["kinetic_energy"][rest] < 0.01 * start
    assert history["elastic_energy"][rest] > 0.95 * start


def nothing_ever_crosses(history: History) -> None:
    assert not history["intersections"].any()
    assert (history["smallest_gap"] > 0).all()


def cubes_come_to_rest_and_nothing_crosses(history: History) -> None:
    nothing_ever_crosses(history)
    assert np.all(np.diff(history["energy"]) < 1e-6 * np.ptp(history["energy"]))  # backward Euler dissipates
    assert history["kinetic_energy"].max() > 30


CLAIMS: dict[str, Callable[[History], None]] = {
    "bounce": energy_goes_to_and_fro_and_stays,
    "braid": nothing_ever_crosses,
    "elastic_bounce": balls_come_to_rest_with_their_energy_in_store,
    "gelatin": cubes_come_to_rest_and_nothing_crosses,
    "mattress_corotated": more_and_more_elements_invert,
    "pulled_tetrahedron": law_thins_by_poisson_ratio_times_stretch,
    "recovery": recovery_dissipates,
    "stretched_bar_corotated": more_and_more_elements_invert,
    "three_triangles": one_triangle_is_inverted_for_a_while,
}


@pytest.mark.parametrize("name", marked())
def test_scene_keeps_its_promises(name: str, comm: MPI.Intracomm, shared_path: Path) -> None:
    folder = shared_path / name
    exit_code = cli.main([part(SCENES[name]), str(SCENES[name]), "-o", str(folder), "--quiet"])
    if comm.rank > 0:
        assert exit_code == 0
        return
    assert grade(exit_code, folder) == "finished"
    assert (folder / "summary.png").stat().st_size > 10_000
    if name in CLAIMS:
        columns, rows = read_table(folder / "history.csv")
        CLAIMS[name]({column: np.array([row[column] for row in rows]) for column in columns})


# ------------------------------------------------------------- what a scene says about itself


def test_scenes_pass_the_check(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["check", *map(str, SCENES.values())]) == 0
    assert capsys.readouterr().out.count(": good: ") == len(SCENES)


@pytest.mark.parametrize("name", SCENES)
def test_scene_says_what_it_shows_how_to_run_it_and_what_it_costs(name: str) -> None:
    words = header(SCENES[name])
    assert words.splitlines()[0].endswith("."), "the first line is a sentence"
    assert command(name) in words
    assert COST.search(words), "About N seconds on one core"
    assert read_scene(SCENES[name]).title


@pytest.mark.parametrize("name", TABLE_7_3)
def test_scale_that_a_snow_scene_names_gives_the_particles_of_table_7_3(name: str) -> None:
    """To 10%: the particles of scale 1 are counted, the table's would need gigabytes."""
    from extremal.app.snow import particles

    scale, count = map(float, SCALE.findall(header(SCENES[name]))[0])
    assert count == TABLE_7_3[name]
    assert read_scene(SCENES[name]).scale == 1
    found = len(particles(read_scene(SCENES[name]), MPI.COMM_SELF)) * scale**3
    assert found == pytest.approx(count, rel=0.1)


@pytest.mark.parametrize("name", SCENES)
def test_scene_expects_to_finish_and_something_of_the_result(name: str) -> None:
    expected = read_scene(SCENES[name]).expect
    assert expected["status"].value == "finished"
    assert "inverted" in expected or part(SCENES[name]) != "elastic"
    assert len(expected) > 1


@pytest.mark.parametrize("name", SCENES)
def test_scene_is_in_the_gallery_with_a_picture(name: str) -> None:
    assert f"`{command(name)}`" in GALLERY.read_text(encoding="utf-8")
    assert f"(images/{name}.png)" in GALLERY.read_text(encoding="utf-8")
    assert (ROOT / "docs" / "images" / f"{name}.png").stat().st_size < 150_000
