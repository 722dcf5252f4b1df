"""A scene of snow is read with the defaults of table 7.2; a bad one is refused with a plain line for each error."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from bad_scenes import cases, keys, refusal

from extremal.app import cli
from extremal.app.scene import read_scene, validate
from extremal.app.snow_scene import SnowScene

# what a case does not give itself
TABLES = {
    "[grid]": "[grid]\ncell_size = 0.1\n",
    "[[body]]": '[[body]]\nshape = "sphere"\ncenter = [0, 0, 0]\nradius = 0.5\n',
    "[analysis]": "[analysis]\nend_time = 1\n",
}
CASES = cases("bad_snow_scenes.txt")

FULL = """
title = "everything at once"
part = "snow"
scale = 2
[grid]
cell_size = 0.1
spline = "quadratic"
volumes = "seeded"
[material]
young_modulus = 5e4
hardening = 5
[[body]]
shape = "sphere"
center = [0, 0, 1]
radius = 0.5
per_cell = 10
seed = 3
velocity = [1, 0, 0]
spin = [0, 0, 6.28]
shell = { thickness = 0.1, stiffness = 3, density = 1.5 }
noise = { size = 0.2, stiffness = 0.7, seed = 4 }
[[body]]
shape = "height_field"
low = [-1, -1, -0.5]
high = [1, 1, 0.5]
surface = "0.1*sin(x)"
[body.material]
law = "fixed_corotated"
density = 100
[[collider]]
shape = "half_space"
point = [0, 0, -0.5]
normal = [0, 0, 1]
friction = 0.5
[[collider]]
shape = "wedge"
apex = [0, 0, 0]
width = 0.1
height = 0.2
length = 1
sticky = true
keyframes = [{ time = 0 }, { time = 1, translation = [0, 0, 1], rotation = [0, 0, 3], center = [0, 0, 0] }]
[gravity]
acceleration = [0, 0, -9.81]
[analysis]
end_time = 2
beta = 0.5
[output]
fields = ["velocity", "plastic_gradient"]
vdb = true
[petsc]
snow_ksp_rtol = 1e-4
[expect]
status = "finished"
particles = { above = 100 }
"""


@pytest.mark.parametrize("case", CASES, ids=[case[0] for case in CASES])
def test_bad_snow_is_refused_in_plain_words(case: list[str], tmp_path: Path) -> None:
    text, *messages = case
    missing = (table for heading, table in TABLES.items() if heading not in text)
    lines = refusal(tmp_path / "scene.toml", "\n".join(['part = "snow"', text, *missing]))
    assert lines == [message.replace("{here}", str(tmp_path)) for message in messages]


def test_there_are_many_distinct_messages() -> None:
    assert len({message for case in CASES for message in case[1:]}) >= 50


@pytest.mark.parametrize("heading", TABLES)
def test_a_missing_table_is_named(heading: str, tmp_path: Path) -> None:
    text = 'part = "snow"\n' + "\n".join(table for name, table in TABLES.items() if name != heading)
    (line,) = refusal(tmp_path / "scene.toml", text)
    assert line.startswith(f"[{heading.strip('[]')}]: is missing; ")


@pytest.fixture
def full(tmp_path: Path) -> SnowScene:
    path = tmp_path / "full.toml"
    path.write_text(FULL)
    return read_scene(path)


def test_every_key_is_read(full: SnowScene) -> None:
    assert isinstance(full, SnowScene)
    assert (full.cell_size, full.grid.volumes) == (0.05, "seeded")
    ball, ground = full.body
    assert ball.shell is not None and ball.shell.density == 1.5
    assert ball.noise is not None and (ball.noise.size, ball.noise.stiffness, ball.noise.seed) == (0.2, 0.7, 4)
    assert full.material_of(ball) == full.material
    assert ground.surface == "0.1*sin(x)"
    assert full.collider[1].sticky and full.collider[1].keyframes is not None
    assert full.collider[1].keyframes[1].rotation == (0, 0, 3)
    assert (full.analysis.beta, full.analysis.time_step, full.analysis.largest_step) == (0.5, 5e-4, 5e-4)
    assert full.output.vdb and full.output.fields == ("velocity", "plastic_gradient")
    assert json.loads(full.model_dump_json())["body"][0]["spin"] == [0, 0, 6.28]


def test_defaults_are_those_of_table_7_2() -> None:
    tables = {"part": "snow", "grid": {"cell_size": 0.1}, "analysis": {"end_time": 1e-4}}
    body = {"shape": "box", "low": [0, 0, 0], "high": [1, 1, 1]}
    scene = validate({**tables, "body": [body]})
    snow = scene.material_of(scene.body[0])
    assert (snow.law, snow.critical_compression, snow.critical_stretch) == ("snow", 2.5e-2, 7.5e-3)
    assert (snow.hardening, snow.density, snow.young_modulus, snow.poisson_ratio) == (10, 400, 1.4e5, 0.2)
    assert (scene.analysis.beta, scene.analysis.flip) == (1, 0.95)
    assert (scene.grid.spline, scene.grid.volumes) == ("cubic", "measured")
    assert scene.analysis.time_step == 1e-4  # no longer than the run


def test_a_body_overrides_what_it_names_and_an_elastic_one_forgets_plasticity(full: SnowScene) -> None:
    ground = full.material_of(full.body[1])
    assert (ground.law, ground.density, ground.young_modulus) == ("fixed_corotated", 100, 5e4)
    assert "hardening" not in ground.model_fields_set


def test_every_key_says_its_meaning() -> None:
    assert [key for key, meaning in keys(SnowScene) if not meaning] == []


def test_check_says_what_a_scene_asks_for(full: SnowScene, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["check", str(full.path)]) == 0
    assert capsys.readouterr().out == (
        f"{full.path}: good: snow 3D, cells of 0.05 m, snow/fixed_corotated, 2 bodies, 2 colliders, "
        "implicit with beta 0.5, gravity, 2 expected\n"
    )


def test_checking_snow_loads_no_heavy_library(full: SnowScene) -> None:
    program = (
        "import json, sys; from extremal.app import scene; scene.read_scene(sys.argv[1]);"
        "print(json.dumps(sorted({m.split('.')[0] for m in sys.modules})))"
    )
    text = FULL.replace("0.1*sin(x)", "0.1")
    assert full.path is not None
    full.path.write_text(text)
    words = [sys.executable, "-c", program, str(full.path)]
    done = subprocess.run(words, capture_output=True, text=True, check=True, env=os.environ)
    heavy = {"dolfinx", "gmsh", "matplotlib", "petsc4py", "sympy", "h5py", "meshio", "scipy"}
    assert not set(json.loads(done.stdout)) & heavy
