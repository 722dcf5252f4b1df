"""Obstacles given by keyframes of a level set: the formula of 7.7."""

import numpy as np
import pytest

from extremal.mpm.colliders import collide
from extremal.obstacles.colliders import Contact
from extremal.obstacles.deforming import DeformingLevelSet
from extremal.obstacles.geometry import BodyError


def points(dim, n):
    return np.random.default_rng(0).uniform(-0.7, 0.7, (n, dim))


def keyframes(dim, n=17):
    """A ball of radius 0.3 + 0.1 t whose centre moves with (0.2, 0, ...), on a grid over [-1, 1]^dim."""
    nodes = np.stack(np.meshgrid(*[np.linspace(-1, 1, n)] * dim, indexing="ij"), axis=-1)
    times = np.array([0.0, 0.5, 1.5])
    arms = [nodes - np.eye(dim)[0] * 0.2 * t for t in times]
    sizes = [np.linalg.norm(arm, axis=-1) for arm in arms]
    phi = [size - 0.3 - 0.1 * t for size, t in zip(sizes, times)]
    v = [0.2 * np.eye(dim)[0] + 0.1 * a / np.maximum(s, 0.1)[..., None] for a, s in zip(arms, sizes)]
    return times, np.array(phi), np.array(v), np.full(dim, -1.0), 2 / (n - 1)


@pytest.mark.parametrize("dim", [2, 3])
def test_a_deforming_obstacle_is_interpolated_by_the_formula_of_7_7(dim):
    times, phi, v, origin, h = keyframes(dim)
    body = DeformingLevelSet(times, phi, v, origin, h)
    frames = [DeformingLevelSet(times[k : k + 1], phi[k : k + 1], v[k : k + 1], origin, h) for k in range(3)]
    fields = [[DeformingLevelSet([0], v[k][None, ..., a], v[k][None], origin, h) for a in range(dim)] for k in range(3)]
    x = points(dim, 200)

    def sampled(k):
        return np.stack([one.distance(x, 0) for one in fields[k]], axis=1)

    for k, t in ((0, 0.2), (1, 1.25)):
        step = times[k + 1] - times[k]
        g = (t - times[k]) / step
        v_co = (1 - g) * sampled(k) + g * sampled(k + 1)
        expected = (1 - g) * frames[k].distance(x - g * step * v_co, 0)
        expected += g * frames[k + 1].distance(x + (1 - g) * step * v_co, 0)
        assert np.allclose(body.velocity(x, t), v_co, atol=1e-14)
        assert np.allclose(body.distance(x, t), expected, atol=1e-14)


def test_a_deforming_obstacle_is_the_body_it_samples():
    body = DeformingLevelSet(*keyframes(3, 65))
    x = points(3, 3000)
    for t in (0.0, 0.3, 0.5, 1.2):
        arm = x - [0.2 * t, 0, 0]
        size = np.linalg.norm(arm, axis=1)
        near = (size > 0.2) & (size < 0.8)
        assert np.abs(body.distance(x, t) - (size - 0.3 - 0.1 * t))[near].max() < 2e-3  # h²/8r of linear sampling
        assert np.abs(body.normal(x, t) - arm / size[:, None])[near].max() < 0.03


def test_a_growing_ball_pushes_outwards_with_its_own_velocity():
    body = DeformingLevelSet(*keyframes(2, 65), contact=Contact(0.0))
    x = np.array([[0.05, 0.32], [0.05, -0.32]])
    out, hit = collide([body], x, np.zeros_like(x), 0.25)
    assert hit.all() and np.allclose(out[:, 1], [0.1, -0.1], atol=2e-3)


def test_a_deforming_obstacle_rests_outside_its_keyframes_and_is_far_outside_its_grid():
    body = DeformingLevelSet(*keyframes(2))
    x = points(2, 20)
    for t in (-1.0, 1.5, 7.0):
        assert not body.velocity(x, t).any()
    assert np.allclose(body.distance(x, -1.0), body.distance(x, 0.0))
    assert body.distance(np.array([[4.0, 0.0]]), 0.2)[0] > 3


def test_keyframes_of_a_level_set_come_from_a_file(tmp_path):
    names = ("times", "phi", "velocity", "origin", "spacing")
    arrays = dict(zip(names, keyframes(2)))
    np.savez(tmp_path / "ball.npz", **arrays)
    body, x = DeformingLevelSet.read(tmp_path / "ball.npz", Contact(0.3)), points(2, 20)
    assert body.contact.friction == 0.3
    assert np.array_equal(body.distance(x, 0.7), DeformingLevelSet(*arrays.values()).distance(x, 0.7))
    arrays.pop("phi")
    np.savez(tmp_path / "less.npz", **arrays)
    (tmp_path / "junk.npz").write_text("hello")
    for name, message in (("less", "lacks phi"), ("junk", "cannot be read"), ("none", "cannot be read")):
        with pytest.raises(BodyError, match=f"{name}.npz: {message}") as caught:
            DeformingLevelSet.read(tmp_path / f"{name}.npz")
        assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "change", [{"times": [0, 0, 1]}, {"phi": np.zeros((3, 17))}, {"velocity": np.zeros((3, 17, 17))}]
)
def test_arrays_that_do_not_fit_are_refused(change):
    arrays = dict(zip(("times", "phi", "velocity", "origin", "spacing"), keyframes(2)))
    with pytest.raises(BodyError, match=f"level set: {next(iter(change))} must"):
        DeformingLevelSet(**{**arrays, **change})
