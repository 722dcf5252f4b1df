"""The picture of snow is drawn for every kind of run, light where snow is and dark where it throws a shadow."""

from pathlib import Path

import matplotlib.image
import numpy as np
import pytest

from extremal.app import cli
from extremal.app.snow_picture import draw_plane, draw_space
from extremal.app.view import choose_view
from extremal.obstacles.colliders import Rigid
from extremal.obstacles.shapes import HalfSpace, Sphere

UP = np.array([0.0, 0.0, 1.0])
PLANE = """
part = "snow"
[grid]
cell_size = 0.05
dimension = 2
[[body]]
shape = "box"
low = [0, 0.02]
high = [0.2, 0.2]
[[collider]]
shape = "half_space"
point = [0, 0]
normal = [0, 1]
[gravity]
acceleration = [0, -9.81]
[analysis]
end_time = 0.01
time_step = 1e-3
"""
SPACE = """
part = "snow"
[grid]
cell_size = 0.05
[[body]]
shape = "box"
low = [0, 0, 0]
high = [0.1, 0.1, 0.1]
[analysis]
end_time = 0.01
beta = 0
"""


def ball(radius: float = 0.5, spacing: float = 0.05) -> np.ndarray:
    axis = np.arange(-radius, radius + spacing, spacing)
    points = np.stack(np.meshgrid(axis, axis, axis), axis=-1).reshape(-1, 3)
    return points[np.linalg.norm(points, axis=1) < radius]


def test_a_ball_on_the_ground_is_light_before_the_sky_and_its_shadow_is_dark() -> None:
    points, floor = ball(), Rigid(HalfSpace([0, 0, -0.5], [0, 0, 1]))
    view = choose_view(np.array([[-0.5] * 3, [0.5] * 3]), [floor], [0.0], UP, 1.0)
    image = draw_space(points, 0.05, [floor], 0.0, view, (120, 120))
    assert image.shape == (120, 120, 3) and image.min() >= 0 and image.max() <= 1
    grey = image.mean(axis=2)
    snow = grey[45:75, 45:75].mean()
    assert snow > 2 * grey[:15].mean()
    bare = draw_space(points + [0, 0, 100.0], 0.05, [floor], 0.0, view, (120, 120)).mean(axis=2)
    darker = grey < 0.8 * bare
    assert darker[80:].any() and not darker[:40].any()


def test_the_eye_is_outside_of_obstacles_and_sees_past_them() -> None:
    bounds = np.array([[-0.5] * 3, [0.5] * 3])
    free = choose_view(bounds, [], [0.0], UP, 1.0)
    wall = Rigid(Sphere(free.eye, 0.5))
    moved = choose_view(bounds, [wall], [0.0], UP, 1.0)
    assert wall.distance(moved.eye[None], 0.0)[0] > 0
    assert not np.allclose(moved.eye, free.eye)


@pytest.mark.parametrize("up", [[0, 0, 1], [0, 1, 0], [1, 0, 0], [0, 0, -1], [0.3, 0, 0.95]])
def test_up_is_up_whatever_gravity_says(up: list[float]) -> None:
    unit = np.array(up) / np.linalg.norm(up)
    view = choose_view(np.array([[-0.5] * 3, [0.5] * 3]), [], [0.0], unit, 1.0)
    assert view.axes @ view.axes.T == pytest.approx(np.eye(3))
    assert view.axes[2] @ unit > 0.9


def test_the_plane_is_drawn_as_it_stands() -> None:
    points = np.random.default_rng(0).uniform(0, 1, (4000, 2))
    floor = Rigid(HalfSpace([0, 0], [0, 1]))
    image = draw_plane(points, 1 / 60, [floor], 0.0, np.array([[-0.5, -0.5], [1.5, 1.5]]), (100, 100))
    grey = image.mean(axis=2)
    # middle: snow; left: sky; below: ground
    assert grey[40:60, 40:60].mean() > 1.5 * max(grey[40:60, :20].mean(), grey[85:].mean())


@pytest.mark.parametrize("text", [PLANE, SPACE])
def test_a_summary_is_drawn(text: str, tmp_path: Path) -> None:
    path = tmp_path / "scene.toml"
    path.write_text(text)
    assert cli.main(["snow", str(path), "-o", str(tmp_path / "out"), "--quiet"]) == 0
    picture = tmp_path / "out" / "summary.png"
    assert picture.read_bytes().startswith(b"\x89PNG") and picture.stat().st_size > 20_000
    assert cli.main(["render", str(tmp_path / "out"), "--size", "64x48"]) == 0
    frames = sorted((tmp_path / "out" / "pictures").iterdir())
    assert [frame.name for frame in frames] == ["frame_00000.png", "frame_00001.png"]
    assert matplotlib.image.imread(frames[0]).shape[:2] == (48, 64)


def test_a_summary_is_drawn_of_a_run_that_failed_at_once(tmp_path: Path) -> None:
    path = tmp_path / "scene.toml"
    fast = SPACE.replace("beta = 0", "beta = 1\nadaptive = false")
    path.write_text(fast.replace("[analysis]", "velocity = [1e6, 0, 0]\n[analysis]"))
    assert cli.main(["snow", str(path), "-o", str(tmp_path / "out"), "--quiet"]) == 3
    assert (tmp_path / "out" / "summary.png").exists()
