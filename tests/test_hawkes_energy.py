"""The energy of (3.5): recursions against the sums written out, sweeps, and the proof of optimality."""

import numpy as np
import pytest
from hawkes_problems import build, dense, events, network, problems, unit_columns
from hypothesis import given, settings
from mpi4py import MPI

from extremal.hawkes.energy import Energy
from extremal.hawkes.events import DataError, Events, Network
from extremal.hawkes.slots import Slots

WORLD, SELF = MPI.COMM_WORLD, MPI.COMM_SELF


@settings(max_examples=60, deadline=None)
@given(problems())
def test_the_recursions_give_the_sums_of_the_source(problem):
    slots = build(SELF, problem)
    A, b = dense(slots)
    x = np.random.default_rng(1).random(len(slots))
    energy = Energy(slots)
    scale = max(1.0, float(np.abs(b).max(initial=0)))
    assert np.abs(slots.linear - b).max(initial=0) <= 1e-13 * scale
    assert np.abs(energy.gradient(x) - (b + 2 * A @ x)).max(initial=0) <= 1e-12 * scale
    assert energy.value(x) == pytest.approx(x @ A @ x + b @ x, rel=1e-12, abs=1e-300)


@settings(max_examples=60, deadline=None)
@given(problems())
def test_the_energy_never_falls_in_a_sweep_and_weights_stay_on_the_sphere(problem):
    slots = build(SELF, problem)
    energy, x = Energy(slots), slots.uniform()
    before = energy.value(x)
    for _ in range(4):
        x = energy.sweep(x)
        after = energy.value(x)
        assert after >= before * (1 - 1e-14)
        assert (x >= 0).all() and unit_columns(slots, x) < 1e-14
        before = after


@settings(max_examples=60, deadline=None)
@given(problems())
def test_no_point_is_further_from_the_maximum_than_the_certificate_says(problem):
    slots = build(SELF, problem)
    energy, x = Energy(slots), slots.uniform()
    best = energy.value(energy.sweep(x, 400))
    for times in (0, 1, 2, 5, 10):
        at = energy.sweep(x, times)
        assert best - energy.value(at) <= energy.gap(at) + 1e-12 * best


def test_the_second_order_certificate_is_within_three_times_the_truth():
    slots = build(SELF, (net := network(9), events(net, 400, 0.5)))
    energy, x = Energy(slots), slots.uniform()
    best = energy.value(energy.sweep(x, 300))
    near = energy.sweep(x, 8)
    assert 0 < energy.gap(near) < 3 * (best - energy.value(near))


@pytest.mark.mpi
def test_slots_gradient_sweep_and_gap_are_those_of_one_rank():
    problem = (net := network(7, seed=3), events(net, 300, 0.6, both=0.2))
    shared, alone = build(WORLD, problem), build(SELF, problem)
    x = Energy(alone).sweep(alone.uniform(), 2)
    mine = shared.scatter(x if WORLD.rank == 0 else None)
    for ours, theirs in (
        (Energy(shared).gradient(mine), Energy(alone).gradient(x)),
        (Energy(shared).sweep(mine, 3), Energy(alone).sweep(x, 3)),
        (shared.uniform(), alone.uniform()),
    ):
        gathered = shared.gather(ours)
        if gathered is not None:
            assert np.abs(gathered - theirs).max() < 1e-14
    assert Energy(shared).gap(mine) == pytest.approx(Energy(alone).gap(x), rel=1e-9)
    assert (shared.candidates == alone.candidates).all()


def test_time_may_be_shifted_and_reversed():
    """(3.3) does not know the direction of time."""
    net = network(5, seed=2)
    given_ = events(net, 80, 0.5)
    shifted = Events(given_.time + 1e9, given_.participants, given_.duration + 1e9)
    back = Events(given_.duration - given_.time[::-1], given_.participants[::-1], given_.duration)
    slots, later, mirrored = (build(SELF, (net, e)) for e in (given_, shifted, back))
    x = np.random.default_rng(0).random(len(slots))
    g = Energy(slots).gradient(x)
    # times of 1e9 days are known to 1e-7 days
    assert np.abs(Energy(later).gradient(x) - g).max() < 1e-7 * np.abs(g).max() * net.decay.max() * 10
    rows = np.concatenate([np.arange(a, b) for a, b in reversed(list(zip(slots.start, slots.start[1:], strict=False)))])
    assert np.abs(Energy(mirrored).gradient(x[rows]) - g[rows]).max() < 1e-12


@pytest.mark.hard
@pytest.mark.parametrize("scale", [1e-12, 1e-6, 1e6, 1e12])
def test_extreme_time_scales_stay_finite_and_certified(scale, figures):
    net = network(5, decay=0.1 * scale)
    slots = build(SELF, (net, events(net, 60, 1.0, duration=100.0)))
    energy = Energy(slots)
    x = energy.sweep(slots.uniform(), 200)
    g = energy.gradient(x)
    assert np.isfinite(g).all() and (g >= 0).all()
    figures(relative_gap=energy.gap(x, g) / energy.value(x, g))
    assert energy.gap(x, g) <= 1e-9 * energy.value(x, g)


@pytest.mark.hard
@pytest.mark.parametrize("branching", [0.999, 5.0, 50.0])
def test_strong_excitation_is_solved_and_certified(branching, figures):
    net = network(5, branching=branching)
    slots = build(SELF, (net, events(net, 80, 1.0)))
    energy = Energy(slots)
    x = energy.sweep(slots.uniform(), 4000)
    figures(relative_gap=energy.gap(x) / energy.value(x))
    assert energy.gap(x) <= 1e-6 * energy.value(x)


@pytest.mark.hard
def test_events_at_one_time_count_each_other_once():
    net = Network.complete(2, 0.1, 0.5, 2.0)
    slots = build(SELF, (net, Events(np.zeros(3), np.array([[0, 1], [0, -1], [-1, -1]]), 1.0)))
    # b = μ + θω from the complete event; 2A = θω between the two incomplete ones
    assert slots.linear.tolist() == [1.1, 1.1]
    assert Energy(slots).couple(np.ones(2)).tolist() == [1.0, 1.0]


@pytest.mark.hard
def test_events_without_an_admissible_active_pair_are_listed_and_the_rest_have_slots():
    net = network(4)
    idle = np.arange(len(net)) == 0  # agents 1 and 2
    net = Network(net.agents, net.pairs[1:], net.background[1:], net.branching[1:], net.decay[1:])
    lonely = Network(
        (*net.agents, "hermit"), net.pairs, net.background, net.branching, net.decay
    )  # an agent without a pair
    found = Slots.build(SELF, lonely, Events(np.arange(3.0), np.array([[4, -1], [0, -1], [-1, -1]]), 3.0))
    assert idle[0] and found.unresolvable.tolist() == [0]
    assert found.candidates.tolist() == [2, 5]


def test_inactive_pairs_have_no_slots():
    net = network(4).with_parameters(np.array([0, 1, 1, 1, 1, 1.0]), np.array([0, 0, 1, 1, 1, 1.0]), np.ones(6))
    slots = build(SELF, (net, Events(np.zeros(1), np.array([[-1, -1]]), 1.0)))
    assert slots.pair.tolist() == [1, 2, 3, 4, 5]


@pytest.mark.hard
@pytest.mark.mpi
def test_ranks_without_a_timeline_take_part():
    problem = (net := Network.complete(2, 0.1, 0.5, 1.0), events(net, 10, 1.0, duration=10.0))
    slots = build(WORLD, problem)
    energy = Energy(slots)
    x = energy.sweep(slots.uniform())
    assert energy.value(x) == pytest.approx(Energy(build(SELF, problem)).value(np.ones(10)), rel=1e-13)
    assert energy.gap(x) < 1e-13


@pytest.mark.parametrize(
    ("parameters", "words"),
    [
        ((-0.1, 0.5, 0.1), "background of 1 - 2 is -0.1: must be 0 or more"),
        ((0.1, np.nan, 0.1), "branching of 1 - 2 is nan: must be 0 or more"),
        ((0.1, 0.5, 0.0), "decay of 1 - 2 is 0: must be above 0"),
        ((0.1, np.inf, 0.1), "branching of 1 - 2 is inf: must be 0 or more"),
    ],
)
def test_parameters_without_meaning_are_refused(parameters, words):
    with pytest.raises(DataError, match=words):
        Network.complete(3, *parameters)


@pytest.mark.parametrize(
    "time", [[0.0, np.nan], [1.0, 0.5], [-1.0, 0.0], [0.0, 2.0], [0.0, np.inf]], ids=str
)
def test_times_without_meaning_are_refused(time):
    with pytest.raises(DataError):
        Events(np.array(time), np.full((2, 2), -1), 1.5)
