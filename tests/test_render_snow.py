"""Path-traced snow obeys the laws of light that can be written down, and looks like snow on the ground."""

from collections.abc import Callable

import numpy as np
import pytest

pytest.importorskip("mitsuba")

from extremal.app import path_tracing as tracing  # noqa: E402
from extremal.app.particles_output import grid_density  # noqa: E402
from extremal.app.scenery import Scenery, Surface  # noqa: E402
from extremal.app.view import choose_view, view_from  # noqa: E402
from extremal.obstacles.colliders import Rigid  # noqa: E402
from extremal.obstacles.shapes import HalfSpace  # noqa: E402

UP = np.array([0.0, 0.0, 1.0])
H = 0.05
Radiance = Callable[..., np.ndarray]


@pytest.fixture
def radiance(monkeypatch: pytest.MonkeyPatch) -> Radiance:
    """Pictures of light itself, not as a screen shows it, under a sky that is 1 everywhere and no sun."""
    monkeypatch.setattr(tracing, "developed", lambda light: light)
    monkeypatch.setattr(tracing, "SUN", np.full(3, 1e-9))
    monkeypatch.setattr(tracing, "ZENITH", np.ones(3))
    monkeypatch.setattr(tracing, "HORIZON", np.ones(3))
    return tracing.trace


def slab(share: float, cells: int) -> tracing.Cloud:
    """A wide slab across y, `cells` thick, of a density that does not change."""
    density = np.zeros((44, cells + 6, 44))
    density[2:-2, 3:-3, 2:-2] = 400 * share
    return tracing.Cloud(density, np.array([-22, -(cells // 2) - 3, -22]), H)


def through(radiance: Radiance, share: float, cells: int) -> np.ndarray:
    """Light (3,) that comes straight through the middle of a slab which absorbs all it meets."""
    # a free path is 2.5 cells where the share is 1
    optics = tracing.Optics(400.0, extinction=0.4 / H, albedo=(0.0, 0.0, 0.0))
    view = view_from(-90.0, 0.0, np.array([[-1.0, -0.5, -1.0], [1.0, 0.5, 1.0]]), UP, 1.0)
    image = radiance(slab(share, cells), optics, [], view, (32, 32), 256)
    return np.asarray(image[14:18, 14:18].mean(axis=(0, 1)))


def test_light_that_is_not_scattered_dies_out_by_beers_law(radiance: Radiance) -> None:
    # 16 pixels of 256 paths each of chance p: standard error sqrt(p (1 - p) / 4096) < 0.008; to three of them
    for share, cells in ((0.25, 10), (0.5, 10), (0.25, 20)):
        # what is interpolated from nodes has a ramp on both sides that holds as much as the nodes do
        expected = np.exp(-0.4 * share * cells)
        assert through(radiance, share, cells) == pytest.approx(np.full(3, expected), abs=0.024)


def test_light_passes_the_seams_between_boxes_of_snow_like_snow(radiance: Radiance) -> None:
    # cells so small that a ray meets the seams of many boxes, at a slant, where it begins a little off each
    h, cells = 0.01, 30
    density = np.zeros((150, cells + 6, 150))
    density[2:-2, 3:-3, 2:-2] = 400
    cloud = tracing.Cloud(density, np.array([-75, -(cells // 2) - 3, -75]), h)
    optics = tracing.Optics(400.0, extinction=1.5 / (cells * h), albedo=(0.0, 0.0, 0.0))
    view = view_from(-62.0, 16.0, np.array([[-1.0, -0.5, -1.0], [1.0, 0.5, 1.0]]), UP, 1.0)
    image = radiance(cloud, optics, [], view, (32, 32), 256)[14:18, 14:18]
    across = abs(view.axes[1][1])
    assert image.mean() == pytest.approx(np.exp(-1.5 / across), abs=0.024)


def test_snow_that_absorbs_nothing_cannot_be_seen_in_a_white_sky(
    radiance: Radiance, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tracing, "DEEPEST", 2000)
    optics = tracing.Optics(400.0, extinction=0.8 / H, albedo=(0.5, 1.0, 1.0))
    view = view_from(-60.0, 20.0, np.full((2, 3), [[-0.6], [0.6]]), UP, 1.0)
    image = radiance(slab(1.0, 10), optics, [], view, (24, 24), 32)
    # the channels that scatter all see the sky everywhere, up to what Monte Carlo leaves
    assert image[..., 1:].mean() == pytest.approx(1.0, abs=0.02)
    assert image[8:16, 8:16, 0].mean() < 0.5


def test_a_ball_of_snow_is_brighter_than_the_ground_and_that_than_its_shadow() -> None:
    rng = np.random.default_rng(3)
    points = rng.uniform(-0.4, 0.4, (30000, 3))
    points = points[np.linalg.norm(points, axis=1) < 0.4] + [0, 0, 0.4]
    mass = np.full(len(points), 400 * 4 / 3 * np.pi * 0.4**3 / len(points))
    floor = [Rigid(HalfSpace([0, 0, 0], [0, 0, 1]))]
    view = choose_view(np.array([[-0.5, -0.5, 0.0], [0.5, 0.5, 0.8]]), floor, [0.0], UP, 4 / 3)
    surfaces: list[Surface] = Scenery(floor, np.array([[-4.0] * 3, [4.0] * 3])).at(0.0)
    ball = tracing.Cloud(*grid_density(points, mass, H), H)
    none = tracing.Cloud(np.zeros((2, 2, 2)), np.zeros(3), H)
    size, told = (64, 48), []
    image = tracing.trace(ball, tracing.Optics(400.0), surfaces, view, size, 12, told.append).mean(axis=2)
    bare = tracing.trace(none, tracing.Optics(400.0), surfaces, view, size, 12).mean(axis=2)
    assert told == [8 / 12, 1.0]
    snow, ground = image[18:28, 26:38].mean(), bare[40:].mean()
    shadow = (image < 0.75 * bare)[28:]
    assert snow > 1.3 * ground
    assert shadow.sum() > 40 and image[28:][shadow].mean() < 0.7 * ground
    assert (image < 0.75 * bare)[:10].sum() == 0  # the sky has none
