"""Method (3.5) by TAO: the examples and the theorem of chapter 3, every solver, any number of ranks."""

import numpy as np
import pytest
from hawkes_problems import build, events, network, problems, unit_columns
from hypothesis import given, settings
from mpi4py import MPI
from petsc4py import PETSc

from extremal.hawkes.energy import Energy
from extremal.hawkes.events import DataError, Events, Network
from extremal.hawkes.reconstruct import ReconstructionError, check_options, reconstruct

WORLD, SELF = MPI.COMM_WORLD, MPI.COMM_SELF


@pytest.fixture
def option():
    """Set a PETSc option for one test."""
    given_ = []

    def put(name, value):
        PETSc.Options().setValue(name, value)
        given_.append(name)

    yield put
    for name in given_:
        PETSc.Options().delValue(name)


def two_events(decay, apart):
    """Example 1 of section 3.2: μ = 0, θ = 1, both events incomplete."""
    net = Network.complete(3, 0.0, 1.0, 1.0).with_parameters(np.zeros(3), np.ones(3), decay)
    return build(SELF, (net, Events(np.array([0.0, apart]), np.full((2, 2), -1), apart)))


@pytest.mark.hard
@pytest.mark.parametrize("apart", [0.3, 2.0, 8.0, 20.0])
@pytest.mark.parametrize("start", [None, 0, 1, 2])
def test_example_1_finds_the_pair_of_the_nearest_time_scale_from_any_start(apart, start, figures):
    """(3.11); every pair is a stationary point in x, one alone is the maximum."""
    decay = np.array([0.05, 0.5, 3.0])
    begin = None if start is None else np.tile(np.eye(3)[start], 2)
    found = reconstruct(two_events(decay, apart), start=begin, gap=1e-10)
    expected = decay * np.exp(-decay * apart)
    figures(relative_gap=found.relative_gap, iterations=found.iterations)
    assert found.energy == pytest.approx(expected.max(), rel=1e-9)
    assert found.weights.reshape(2, 3).argmax(axis=1).tolist() == [expected.argmax()] * 2


@pytest.mark.hard
def test_a_stationary_point_that_is_no_maximum_is_not_certified():
    decay = np.array([0.05, 0.5, 3.0])
    slots = two_events(decay, 2.0)
    wrong = np.tile(np.eye(3)[2], 2)
    energy = Energy(slots)
    assert np.abs(energy.gradient(wrong)[[0, 1, 3, 4]]).max() == 0  # stationary in x
    # here the bound is the truth, up to rounding
    assert energy.gap(wrong) >= (0.5 * np.exp(-1) - energy.value(wrong)) * (1 - 1e-14)


def test_example_2_gives_weights_in_proportion_to_the_background():
    """(3.16)"""
    μ = np.array([0.01, 0.04, 0.2])
    net = Network.complete(3, 0.1, 0.5, 0.1).with_parameters(μ, np.full(3, 0.5), np.full(3, 0.1))
    found = reconstruct(build(SELF, (net, Events(np.zeros(1), np.array([[-1, -1]]), 1.0))), gap=1e-14)
    assert np.abs(found.weights - μ / np.linalg.norm(μ)).max() < 1e-14


def test_theorem_331_one_maximiser_from_any_start():
    """With all b > 0 the maximiser is unique."""
    slots = build(SELF, (net := network(6, seed=1), events(net, 150, 0.6, both=0.5)))
    assert (slots.linear > 0).all()
    rng = np.random.default_rng(0)
    found = []
    for _ in range(4):
        x = rng.random(len(slots)) ** 8
        x /= np.repeat(np.sqrt(slots.columns(x, x)), np.diff(slots.start))
        found.append(reconstruct(slots, start=x, sweeps=0, gap=1e-13).weights)
    assert max(np.abs(other - found[0]).max() for other in found) < 1e-5  # a gap of 1e-13 is its square


def test_theorem_331_the_energy_is_concave_in_the_squares_of_the_weights():
    """(3.22)-(3.25)"""
    slots = build(SELF, (net := network(5, seed=4), events(net, 60, 1.0, both=0.5)))
    energy, rng = Energy(slots), np.random.default_rng(2)
    length = np.diff(slots.start)

    def point():
        y = rng.random(len(slots)) ** 4
        return y / np.repeat(slots.columns(y, np.ones(len(y))), length)

    for _ in range(50):
        a, b, t = point(), point(), rng.random()
        between = energy.value(np.sqrt(t * a + (1 - t) * b))
        assert between >= t * energy.value(np.sqrt(a)) + (1 - t) * energy.value(np.sqrt(b))


def test_a_solver_without_bounds_is_refused(option):
    option("hawkes_tao_type", "owlqn")
    with pytest.raises(DataError, match="-hawkes_tao_type owlqn: must be one of blmvm, .* which keep bounds"):
        check_options()


@pytest.mark.parametrize(
    "kind", ["blmvm", "tron", "bncg", "bqnls", "bqnkls", "bqnktr", "bqnktl", "bntr", "bntl", "bnls"]
)
def test_every_bound_constrained_solver_of_tao_reaches_the_same_maximum(kind, option):
    option("hawkes_tao_type", kind)
    slots = build(SELF, (net := network(8, seed=5), events(net, 300, 0.7)))
    found = reconstruct(slots, gap=1e-11, sweeps=0)
    best = Energy(slots).sweep(slots.uniform(), 1000)
    assert found.iterations > 0 and found.relative_gap <= 1e-11
    assert found.energy == pytest.approx(Energy(slots).value(best), rel=1e-10)


@pytest.mark.parametrize("held", [False, True])
def test_gradient_and_hessian_in_z_are_derivatives(held):
    from extremal.hawkes.reconstruct import _Solver

    slots = build(SELF, (net := network(5, seed=6), events(net, 60, 0.7)))
    solver = _Solver(Energy(slots), 1e-8, None)
    solver._held, solver._radius, solver._stiffness = held, np.full(slots.count, 1.3), np.full(slots.count, 0.7)
    rng, h = np.random.default_rng(0), 1e-5
    z, v = rng.random(len(slots)) + 0.1, rng.normal(size=len(slots))

    def at(point):
        vector = PETSc.Vec().createWithArray(point, comm=SELF)
        out = vector.duplicate()
        value = solver._objective_gradient(None, vector, out)
        gradient = out.array.copy()
        for used in (vector, out):
            used.destroy()
        return value, gradient

    (above, g_above), (below, g_below), (_, g) = at(z + h * v), at(z - h * v), at(z)
    product = solver.product(v)
    solver.destroy()
    assert (above - below) / (2 * h) == pytest.approx(g @ v, rel=1e-7)
    assert np.abs((g_above - g_below) / (2 * h) - product).max() < 1e-7 * np.abs(product).max()


@pytest.mark.mpi
@pytest.mark.parametrize("kind", ["blmvm", "tron"])
def test_the_same_answer_on_any_number_of_ranks(kind, option):
    option("hawkes_tao_type", kind)
    problem = (net := network(9, seed=7), events(net, 500, 0.6, both=0.1))
    shared, alone = build(WORLD, problem), build(SELF, problem)
    together, by_itself = (reconstruct(slots, sweeps=1, gap=1e-10) for slots in (shared, alone))
    weights = shared.gather(together.weights)
    if weights is not None:
        assert np.abs(weights - by_itself.weights).max() < 1e-10
    assert together.energy == pytest.approx(by_itself.energy, rel=1e-12)
    assert together.iterations == by_itself.iterations > 0


@settings(max_examples=40, deadline=None)
@given(problems())
def test_any_problem_is_solved_to_a_certified_gap_from_the_sphere_on(problem):
    slots = build(SELF, problem)
    found = reconstruct(slots, gap=1e-7)
    assert (found.weights >= 0).all() and unit_columns(slots, found.weights) < 1e-12
    swept = Energy(slots).value(Energy(slots).sweep(slots.uniform(), 50))
    assert found.energy >= swept * (1 - 1e-7) and found.gap <= 1e-7 * found.energy


def test_agents_may_be_numbered_otherwise():
    net = network(6, seed=8)
    known = events(net, 100, 0.6)
    turn = np.random.default_rng(3).permutation(6).astype(np.int32)
    pairs = np.sort(turn[net.pairs], axis=1)
    other = Network(net.agents, pairs, net.background, net.branching, net.decay)
    people = np.where(known.participants < 0, -1, turn[known.participants])
    found = reconstruct(build(SELF, (net, known)), gap=1e-13)
    again = reconstruct(build(SELF, (other, Events(known.time, people, known.duration))), gap=1e-13)
    assert again.energy == pytest.approx(found.energy, rel=1e-12)


def test_sweeps_alone_do_where_events_are_loosely_coupled():
    slots = build(SELF, (net := network(6, seed=9), events(net, 200, 0.1)))
    found = reconstruct(slots)
    assert found.iterations == 0 and found.relative_gap <= 1e-8


@pytest.mark.hard
@pytest.mark.parametrize("count", [0, 1])
def test_no_event_and_one_event(count):
    net = network(4)
    found = reconstruct(build(SELF, (net, Events(np.zeros(count), np.full((count, 2), -1), 1.0))))
    assert found.gap <= 1e-14 and len(found.weights) == 6 * count


def test_a_gap_out_of_reach_is_told(option):
    option("hawkes_tao_max_it", 1)
    slots = build(SELF, (net := network(6, seed=9), events(net, 200, 1.0)))
    with pytest.raises(ReconstructionError, match=r"TAO ended with .* at a relative gap of .*, above 1e-15"):
        reconstruct(slots, gap=1e-15, sweeps=0)


def test_the_monitor_sees_every_iteration():
    rows = []
    slots = build(SELF, (net := network(8, seed=5), events(net, 300, 0.7)))
    found = reconstruct(slots, gap=1e-10, sweeps=0, monitor=rows.append)
    assert [row["iteration"] for row in rows] == list(range(found.iterations + 1))
    assert rows[-1]["energy"] == pytest.approx(found.energy, rel=1e-12) and rows[-1]["gap"] == found.gap
