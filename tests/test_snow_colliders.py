"""Obstacles: exact distances, motion and its velocity, and the three answers of 7.7."""

import time

import numpy as np
import pytest

from extremal.mpm.bodies import BodyError, Box, Cylinder, HeightField, Sphere, Text, Wedge, seed
from extremal.mpm.colliders import collide
from extremal.obstacles.colliders import Contact, Rigid
from extremal.obstacles.gear import Gear
from extremal.obstacles.hollow import Bowl, Tube
from extremal.obstacles.motion import RigidMotion
from extremal.obstacles.shapes import HalfSpace

SHAPES = {
    "plane": HalfSpace((0, 0, 0.1), (0, 1, 2)),
    "line": HalfSpace((0, 0.1), (1, 2)),
    "box": Box((-0.3, -0.5, -0.2), (0.4, 0.1, 0.9)),
    "rectangle": Box((-0.3, -0.5), (0.4, 0.1)),
    "sphere": Sphere((0.1, 0, -0.2), 0.5),
    "disc": Sphere((0.1, 0), 0.5),
    "cylinder": Cylinder((0.1, 0.2, 0.3), 0.4, 0.9, (1, 2, -1)),
    "tube": Tube((0.1, 0.0, -0.1), 0.2, 0.15, 0.6, (1, 2, -1), flare=0.15),
    "pipe": Tube((0.1, 0.0, -0.1), 0.2, 0.08, 0.6),
    "channel": Tube((0.1, -0.1), 0.2, 0.08, 0.6, (1, 0), flare=0.1),
    "bowl": Bowl((0.1, 0, 0.2), 0.5, 0.1),
    "dish": Bowl((0.1, 0.2), 0.4, 0.2),
    "gear": Gear((0.1, 0, -0.1), 0.5, 8, 0.12, 0.6, (1, 2, -1)),
    "cog": Gear((0.1, 0.2), 0.6, 11, 0.15),
    "wedge": Wedge((0, 0, 0.3), 0.5, 0.4, 0.8, up=(1, 0, 2)),
    "triangle": Wedge((0, 0.3), 0.5, 0.4),
}


def cloud(dim, n=3000, seed=0):
    return np.random.default_rng(seed).uniform(-1.2, 1.2, (n, dim))


def around(shape):
    """Points in and near the shape, or within reach of a plane."""
    low, high = (np.nan_to_num(corner, posinf=1.0, neginf=-1.0) for corner in shape.bounds())
    return low - 0.4 + np.random.default_rng(0).random((4000, len(low))) * (high - low + 0.8)


# ---- shapes


@pytest.mark.parametrize("name", SHAPES)
def test_distance_is_exact(name):
    """With unit gradient, and the point at distance φ down the gradient on the surface, φ is the distance."""
    shape = SHAPES[name]
    x = around(shape)
    phi, n = shape.distance(x), shape.normal(x)
    assert np.abs(np.linalg.norm(n, axis=1) - 1).max() < 1e-14
    assert np.abs(shape.distance(x - phi[:, None] * n)).max() < 1e-14
    assert np.array_equal(shape.inside(x), phi <= 0)
    assert (phi > 0).sum() > 100 and (phi < 0).sum() > 100


@pytest.mark.parametrize("name", SHAPES)
def test_normal_is_the_gradient_of_distance(name):
    shape = SHAPES[name]
    x, step = around(shape), 1e-6
    ahead = step * np.eye(x.shape[1])
    gradient = np.stack([(shape.distance(x + e) - shape.distance(x - e)) / (2 * step) for e in ahead], axis=1)
    assert np.abs(gradient - shape.normal(x)).max() < 1e-8


@pytest.mark.parametrize("name", SHAPES)
def test_bounds_enclose_the_shape(name):
    shape = SHAPES[name]
    x = around(shape)
    low, high = shape.bounds()
    held = x[shape.inside(x)]
    assert (held >= low).all() and (held <= high).all()


@pytest.mark.parametrize("name", [k for k in SHAPES if k not in ("plane", "line")])
def test_normals_have_unit_length_even_where_the_distance_has_a_kink(name):
    shape = SHAPES[name]
    low, high = shape.bounds()
    x = np.stack([(low + high) / 2, low, high, *([shape.center] if hasattr(shape, "center") else [])])
    if isinstance(shape, Wedge):
        x = np.concatenate([x, shape.apex[None]])
    with np.errstate(all="raise"):
        assert np.allclose(np.linalg.norm(shape.normal(x), axis=1), 1)


def test_letters_push_outwards():
    plate = Text("I", 1.0, 0.2, (0, 0, 0))
    x = np.array([[plate.size[0] / 2 - 0.01, 0, 0], [0, 0.09, 0], [0, -0.09, 0]])
    assert np.allclose(plate.distance(x), -0.01, atol=2e-3)
    assert np.allclose(plate.normal(x), [[1, 0, 0], [0, 1, 0], [0, -1, 0]], atol=1e-6)


def test_a_slope_given_by_heights_is_the_plane_it_stands_for():
    slope = HeightField(lambda q: 1.0 - 0.3 * q[:, 0], (-2, -2), (2, 2), base=-2)
    plane = HalfSpace((0, 0, 1), (0.3, 0, 1))
    x = cloud(3) * [1, 1, 0.2] + [0, 0, 1]
    assert np.allclose(slope.distance(x), plane.distance(x), atol=1e-12)
    assert np.allclose(slope.normal(x), plane.normal(x), atol=1e-10)


# ---- motion


def tumbling():
    return RigidMotion(
        [0, 1, 2.5],
        [[0, 0, 0], [1, 0, 0], [1, 2, 0]],
        [[0, 0, 0], [1, 5, -2], [2, 0, 9]],
        [[0.1, 0.2, 0.3], [0, 0, 1], [0, 2, 0]],
        dimension=3,
    )


@pytest.mark.parametrize("t", [1e-4, 0.3, 0.999, 1.7, 2.4])
def test_velocity_is_the_time_derivative_of_the_motion(t):
    motion, X, dt = tumbling(), cloud(3, 20), 1e-5
    x = motion.at(t).to_world(X)
    moved = (motion.at(t + dt).to_world(X) - motion.at(t - dt).to_world(X)) / (2 * dt)
    assert np.abs(motion.at(t).velocity(x) - moved).max() < 2e-7  # dt² times the third derivative
    assert np.abs(motion.at(t).to_body(x) - X).max() < 1e-14


def test_a_rotating_body_moves_with_its_angular_velocity_about_its_centre():
    omega, centre = np.array([0.3, -1.2, 2.0]), np.array([0.5, 0.1, -0.2])
    motion = RigidMotion([0, 10], rotations=[0 * omega, 10 * omega], centers=centre, dimension=3)
    x = cloud(3, 50)
    assert np.allclose(motion.at(7.3).velocity(x), np.cross(omega, x - centre), atol=1e-13)
    plane = RigidMotion([0, 10], rotations=[0, 20], centers=centre[:2], dimension=2)
    arm = x[:, :2] - centre[:2]
    assert np.allclose(plane.at(7.3).velocity(x[:, :2]), 2 * np.stack([-arm[:, 1], arm[:, 0]], axis=1), atol=1e-13)


def test_a_quarter_turn_is_a_quarter_turn():
    now = RigidMotion([0, 1], [[0, 0], [1, 0]], [0, np.pi], [0.5, 0], dimension=2).at(0.5)
    assert np.allclose(now.to_world(np.array([[1.5, 0.0], [0.5, 0]])), [[1, 1], [1, 0]])


def test_a_body_rests_before_its_first_and_from_its_last_keyframe():
    motion, x = tumbling(), cloud(3, 5)
    for t in (-1.0, -1e-9, 2.5, 99.0):
        assert not motion.at(t).velocity(x).any()
    assert motion.at(0.0).velocity(x).any()
    assert np.allclose(motion.at(99).to_world(x), motion.at(2.5 - 1e-12).to_world(x))


def test_spin_has_no_jump_where_series_takes_over():
    turn = np.array([0.6, -0.8, 0.0])
    for size in (1e-2 * (1 - 1e-9), 1e-2 * (1 + 1e-9)):
        motion = RigidMotion([0, 1], rotations=[(size - 1e-3) * turn, (size + 1e-3) * turn + [0, 0, 1e-3]], dimension=3)
        R, dt = motion.at(0.5).rotation, 1e-4
        change = (motion.at(0.5 + dt).rotation - motion.at(0.5 - dt).rotation) / (2 * dt) @ R.T
        assert np.abs(motion.at(0.5).spin - [change[2, 1], change[0, 2], change[1, 0]]).max() < 1e-12
        assert np.abs(R @ R.T - np.eye(3)).max() < 1e-15


@pytest.mark.parametrize("name", [k for k in SHAPES if len(SHAPES[k].bounds()[0]) == 3])
def test_a_moving_obstacle_carries_distance_normal_and_bounds_along(name):
    shape, motion, X, t = SHAPES[name], tumbling(), cloud(3), 1.3
    moving, x = Rigid(shape, motion=motion), motion.at(1.3).to_world(X)
    assert np.allclose(moving.distance(x, t), shape.distance(X), atol=1e-13)
    assert np.allclose(moving.normal(x, t), shape.normal(X) @ motion.at(t).rotation.T, atol=1e-12)
    low, high = moving.bounds(t)
    held = x[shape.inside(X)]
    assert (held >= low).all() and (held <= high).all()


@pytest.mark.parametrize(
    "wrong, message",
    [
        (lambda: RigidMotion([0, 0], dimension=2), "times must ascend"),
        (lambda: RigidMotion([0, 1], [[0, 0, 0]], dimension=3), "translations must be 3 finite numbers for each of 2"),
        (lambda: RigidMotion([0], rotations=[[1, 0, 0]], dimension=2), "in 2D a rotation is about the z axis"),
        (lambda: Rigid(SHAPES["disc"], motion=tumbling()), "keyframes for 3D move a shape in 2D"),
        (lambda: Contact(-0.1), "friction must be a finite number, 0 or above, got -0.1"),
        (lambda: Gear((0, 0), 0.5, 5, 0.05), "gear: depth must be above 0.0887 m, for 5 teeth, and below the radius"),
        (lambda: Bowl((0, 0, 0), 1.0, -0.1), "bowl: thickness must be a finite number above 0, got -0.1"),
        (lambda: Tube((0, 0, 0), 1.0, 0.1, 1.0, flare=-1), "tube: flare must be a finite number, 0 or above, got -1"),
        (lambda: HalfSpace((0, 0), (0, 0)), "half_space: normal must not be zero"),
    ],
)
def test_a_wrong_value_is_named(wrong, message):
    with pytest.raises(BodyError, match=message):
        wrong()


# ---- contact (7.7)

FLOOR = HalfSpace((0, 0, 0), (0, 0, 1))
DOWN = np.array([[3.0, 4.0, -10.0]])  # |v_t| = 5, v_n = -10


def after(contact, v, x=(0, 0, -0.1), shape=FLOOR, motion=None):
    v_after, hit = collide([Rigid(shape, contact, motion)], np.atleast_2d(np.array(x, dtype=float)), v, 0.5)
    return v_after[0], bool(hit[0])


def test_what_separates_is_left_alone():
    for friction in (0.0, 5.0):
        v, hit = after(Contact(friction), -DOWN)
        assert not hit and np.array_equal(v, -DOWN[0])
    v, hit = after(Contact(1.0), np.array([[1.0, 0.0, 0.0]]))
    assert not hit and np.array_equal(v, [1, 0, 0])


def test_without_friction_only_the_normal_velocity_goes():
    v, hit = after(Contact(0.0), DOWN)
    assert hit and np.allclose(v, [3, 4, 0], atol=1e-15)


def test_sliding_loses_friction_times_the_normal_impulse():
    v, hit = after(Contact(0.2), DOWN)
    assert hit and np.allclose(v, [3 * 0.6, 4 * 0.6, 0], atol=1e-15)  # 5 - 0.2·10 = 3 of 5


@pytest.mark.parametrize("friction", [0.5, 0.7, 100.0])
def test_friction_that_could_reverse_the_sliding_stops_it(friction):
    v, hit = after(Contact(friction), DOWN)
    assert hit and np.array_equal(v, [0, 0, 0])


def test_what_falls_straight_down_stops_without_friction():
    v, hit = after(Contact(0.0), np.array([[0.0, 0.0, -1.0]]))
    assert hit and np.array_equal(v, [0, 0, 0])


def test_a_sticky_obstacle_holds_even_what_separates():
    for v in (DOWN, -DOWN):
        held, hit = after(Contact(0.0, sticky=True), v)
        assert hit and np.array_equal(held, [0, 0, 0])


def test_friction_is_relative_to_the_moving_obstacle():
    motion = RigidMotion([0, 1], [[0, 0, 0], [1, 2, 0]], dimension=3)
    v, hit = after(Contact(0.2), DOWN + [1, 2, 0], motion=motion)
    assert hit and np.allclose(v, [1 + 1.8, 2 + 2.4, 0], atol=1e-14)
    assert after(Contact(sticky=True), DOWN, motion=motion)[0].tolist() == [1, 2, 0]
    rising = RigidMotion([0, 1], [[0, 0, -1], [0, 0, 1]], dimension=3)
    v, hit = after(Contact(0.0), np.array([[1.0, 0, 0]]), motion=rising)  # a floor that rises by 2 m/s
    assert hit and np.allclose(v, [1, 0, 2])


def test_outside_nothing_happens_and_the_surface_belongs_to_the_obstacle():
    assert not after(Contact(), DOWN, (0, 0, 1e-12))[1]
    assert after(Contact(), DOWN, (0, 0, 0))[1]


@pytest.mark.parametrize("dim", [2, 3])
def test_collisions_are_those_of_the_formula_point_by_point(dim):
    rng = np.random.default_rng(dim)
    x, v = cloud(dim, 500), rng.normal(size=(500, dim))
    motion = RigidMotion([0, 1], rng.normal(size=(2, dim)) / 9, [[0, 0, 0], [0, 0, 3]], dimension=dim)
    centre = np.zeros(dim)
    colliders = [
        Rigid(Sphere(centre, 0.8), Contact(0.4), motion),
        Rigid(HalfSpace(centre, np.ones(dim)), Contact(0.9)),
        Rigid(Box(centre, centre + 0.5), Contact(sticky=True), motion),
    ]
    found, hit = collide(colliders, x, v, 0.4)
    for i in range(len(x)):
        point, expected, touched = x[i : i + 1], v[i].copy(), False
        for one in colliders:
            if one.distance(point, 0.4)[0] > 0:
                continue
            n, v_co = one.normal(point, 0.4)[0], one.velocity(point, 0.4)[0]
            relative = expected - v_co
            v_n = relative @ n
            v_t = relative - n * v_n
            if one.contact.sticky:
                relative = 0 * n
            elif v_n >= 0:
                continue
            elif np.linalg.norm(v_t) <= -one.contact.friction * v_n:
                relative = 0 * n
            else:
                relative = v_t + one.contact.friction * v_n * v_t / np.linalg.norm(v_t)
            expected, touched = v_co + relative, True
        assert hit[i] == touched and np.allclose(found[i], expected, atol=1e-13)
    assert 50 < hit.sum() < 450


def test_no_collision_adds_energy_in_the_frame_of_the_obstacle():
    x, v = cloud(3), np.random.default_rng(2).normal(size=(3000, 3))
    for friction in (0.0, 0.3, 10.0):
        out, hit = collide([Rigid(Sphere((0, 0, 0), 1), Contact(friction))], x, v, 0)
        assert (np.linalg.norm(out, axis=1) <= np.linalg.norm(v, axis=1) * (1 + 1e-15)).all()
        n = x[hit] / np.linalg.norm(x[hit], axis=1)[:, None]
        assert np.abs(np.einsum("ni,ni->n", out[hit], n)).max() < 1e-15


def test_a_collider_that_swallows_the_whole_body_gives_finite_velocities():
    x = np.concatenate([cloud(3, 50), np.zeros((1, 3))])
    for shape in (Sphere((0, 0, 0), 9), Box((-9, -9, -9), (9, 9, 9)), Cylinder((0, 0, 0), 9, 18)):
        out, _ = collide([Rigid(shape, Contact(0.5))], x, np.ones_like(x), 0)
        assert np.isfinite(out).all()


def test_velocities_given_are_kept_and_nothing_is_copied_without_need():
    x, v = cloud(3), cloud(3, seed=1)
    before = v.copy()
    collide([Rigid(FLOOR)], x, v, 0)
    assert np.array_equal(v, before)
    for colliders in ([], [Rigid(Sphere((9, 9, 9), 1))]):
        out, hit = collide(colliders, x, v, 0)
        assert out is v and not hit.any()
    out, hit = collide([Rigid(FLOOR)], x[:0], v[:0], 0)
    assert len(out) == len(hit) == 0


def test_what_is_outside_the_bounds_is_never_evaluated():
    asked = []

    class Watched(Sphere):
        def distance(self, x):
            asked.append(len(x))
            return super().distance(x)

    x = seed(Box((0, 0, 0), (1, 1, 1)), 0.05, 8)
    v = np.zeros_like(x)
    collide([Rigid(Watched((0, 0, 0), 0.1)), Rigid(Watched((5, 0, 0), 0.1))], x, v, 0)
    within = (x <= 0.1).all(axis=1).sum()
    assert asked == [within]


def test_distant_obstacles_cost_a_comparison_or_two_a_particle():
    x = seed(Box((0, 0, 0.1), (1, 1, 1.1)), 0.03, 8)
    v, seconds = np.zeros_like(x), []
    colliders = [Rigid(FLOOR), Rigid(Sphere((0, 0, -2), 1)), Rigid(Box((2, 0, 0), (3, 1, 1)), motion=tumbling())]
    for _ in range(5):
        begin = time.process_time()
        collide(colliders, x, v, 0)
        seconds.append(time.process_time() - begin)
    assert min(seconds) / len(x) < 40e-9  # measured 10 ns for the three of them; the rest is room for a busy machine
