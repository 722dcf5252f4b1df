"""Likelihood (3.1), and the methods (3.1) and (3.7) as scores by (3.26): every allocation counts once."""

import numpy as np
import pytest
from hawkes_problems import build, events, network, problems
from hawkes_reference import allocations, energy_sums, filled, posterior
from hawkes_reference import log_likelihood as written_out
from hypothesis import assume, given, settings
from mpi4py import MPI
from scipy.integrate import quad

from extremal.hawkes.energy import Energy
from extremal.hawkes.enumeration import energy_scores, scores_by_enumeration
from extremal.hawkes.events import DataError, Events, Network
from extremal.hawkes.likelihood import log_likelihood

SELF = MPI.COMM_SELF
ROUNDING = 1e-10  # sums of at most some thousand terms, exponentials of sums of some hundred


def small(problem, most=3000):
    """Slots of a problem that can be enumerated in a blink."""
    slots = build(SELF, problem)
    assume(0 < slots.count <= 6 and allocations(slots) <= most)
    return slots


@pytest.mark.parametrize("compensator", [False, True])
def test_likelihood_is_the_product_of_intensities(compensator):
    net, known = network(5, seed=1), events(network(5), 60, 0.0, seed=1)
    pair = net.number(*known.participants.T)
    expected = written_out(net, known.time, pair, known.duration, compensator)
    assert log_likelihood(net, known, compensator=compensator) == pytest.approx(expected, rel=1e-12)


def test_compensator_is_the_integral_of_the_intensity():
    net = Network.complete(2, 0.3, 0.6, 1.7)
    time = np.array([0.4, 1.0, 1.1])

    def intensity(t):
        return 0.3 + 0.6 * 1.7 * np.exp(-1.7 * (t - time[time < t])).sum()

    integral = sum(quad(intensity, a, b)[0] for a, b in ((0, 0.4), (0.4, 1), (1, 1.1), (1.1, 3)))
    known = Events(time, np.tile([0, 1], (3, 1)), 3.0)
    less = log_likelihood(net, known) - log_likelihood(net, known, compensator=True)
    assert less == pytest.approx(integral, rel=1e-9)  # of the quadrature


def test_what_cannot_have_happened_has_likelihood_zero():
    net = Network(("a", "b", "c"), [[0, 1], [0, 2]], [0.0, 0.0], [0.5, 0.0], [1.0, 1.0])
    people = np.array([[0, 1], [0, 1]])
    assert log_likelihood(net, Events([1.0, 2.0], people, 3.0)) == -np.inf  # nothing to trigger the first
    assert log_likelihood(net, Events([1.0], [[0, 2]], 3.0)) == -np.inf  # inactive
    assert log_likelihood(net, Events([1.0], [[1, 2]], 3.0)) == -np.inf  # no pair
    assert log_likelihood(net, Events([], np.empty((0, 2)), 3.0)) == 0


@pytest.mark.hard
def test_events_at_equal_times_are_the_limit_of_ever_closer_ones_in_any_order():
    net = network(3, seed=2)

    def likelihood(gap, order):
        people = net.pairs[[0, 0, 1, 0]][order]
        return log_likelihood(net, Events([5.0, 5 + gap, 5 + 2 * gap, 5 + 3 * gap], people, 9.0))

    at_once = likelihood(0, [0, 1, 2, 3])
    for order in ([1, 3, 0, 2], [2, 0, 1, 3], [3, 2, 1, 0]):
        assert likelihood(0, order) == pytest.approx(at_once, rel=1e-14)
        assert likelihood(1e-9, order) == pytest.approx(at_once, abs=1e-8)


@settings(max_examples=60)
@given(problems())
def test_scores_are_sums_over_all_allocations(problem):
    slots = small(problem)
    for compensator in (False, True):
        expected = posterior(slots, compensator)
        found = scores_by_enumeration(slots, compensator=compensator)
        assert np.allclose(slots.columns(found, np.ones(len(slots))), 1, atol=ROUNDING)
        if expected is not None:
            assert np.allclose(found, expected, rtol=0, atol=ROUNDING)


@settings(max_examples=60)
@given(problems())
def test_method_37_needs_no_enumeration(problem):
    """Σ Λ over the allocations with event j on pair i is, but for a constant of j, their number times g_ij."""
    slots = small(problem)
    rows = np.diff(slots.start)
    shared = allocations(slots) / np.repeat(rows, rows)
    rest = energy_sums(slots) / shared - energy_scores(slots)
    low, high = (np.repeat(f.reduceat(rest, slots.start[:-1]), rows) for f in (np.minimum, np.maximum))
    scale = max(1.0, float(np.abs(rest).max()), float(energy_scores(slots).max()))
    assert np.abs(high - low).max() <= ROUNDING * scale


def test_energy_scores_are_the_gradient_at_equal_shares():
    slots = build(SELF, (net := network(5, seed=3), events(net, 50, 0.5, both=0.5)))
    uniform = slots.uniform() ** 2
    assert np.allclose(energy_scores(slots), Energy(slots).gradient(uniform), rtol=1e-14)


@pytest.mark.hard
def test_example_1_without_background_is_settled_by_the_time_scale():
    """Section 3.2.1: Σ over the pair of the second event of θω e^{-ωΔt}; the first one's background is a limit."""
    ω = np.array([0.01, 0.1, 1.0])
    net = Network.complete(3, 0.0, 1.0, 1.0).with_parameters(np.zeros(3), np.ones(3), ω)
    slots = build(SELF, (net, Events([0.0, 10.0], np.full((2, 2), -1), 10.0)))
    expected = ω * np.exp(-10 * ω)
    found = scores_by_enumeration(slots).reshape(2, 3)
    assert np.allclose(found, expected / expected.sum(), rtol=0, atol=1e-8)  # of the floor under the background


def test_example_2_a_single_event_follows_the_backgrounds():
    net = network(4, seed=4)
    slots = build(SELF, (net, Events([3.0], [[-1, -1]], 5.0)))
    expected = net.background / net.background.sum()
    assert np.allclose(scores_by_enumeration(slots), expected, rtol=1e-12)


def test_impossible_allocations_have_score_zero():
    net = Network(("a", "b", "c"), [[0, 1], [0, 2]], [0.0, 0.1], [0.5, 0.5], [1.0, 1.0])
    slots = build(SELF, (net, Events([1.0, 2.0], [[0, -1], [0, -1]], 2.0)))
    first, second = scores_by_enumeration(slots).reshape(2, 2)
    assert first.tolist() == [0, 1] and second.tolist() == [0, 1]


@pytest.mark.hard
def test_one_candidate_and_no_incomplete_event():
    net = Network.complete(2, 0.1, 0.5, 1.0)
    slots = build(SELF, (net, Events([1.0, 2.0], [[0, -1], [0, 1]], 2.0)))
    assert scores_by_enumeration(slots).tolist() == [1.0]
    assert len(scores_by_enumeration(build(SELF, (net, Events([1.0], [[0, 1]], 2.0))))) == 0


@pytest.mark.hard
@pytest.mark.parametrize("θ", [0.0, 0.999, 50.0])
@pytest.mark.parametrize("scale", [1e-12, 1e-3, 1e3, 1e9, 1e12])
def test_scales_of_time_do_not_matter(θ, scale, figures):
    """ω Δt from 1e-12 to 1e12: finite, and the same whatever the unit of time."""
    net = network(4, seed=5)
    net = net.with_parameters(net.background, np.full(len(net), θ), net.decay)
    known = events(net, 20, 0.4, seed=5)
    stretched = Events(scale * known.time, known.participants, scale * known.duration)
    other = net.with_parameters(1e6 * net.background, net.branching, 1e6 * net.decay)
    short = Events(1e-6 * stretched.time, known.participants, 1e-6 * stretched.duration)
    found, same = (scores_by_enumeration(build(SELF, p), compensator=True) for p in ((net, stretched), (other, short)))
    figures(difference=np.abs(found - same).max())
    assert np.allclose(found, same, rtol=0, atol=1e-9)  # rounding of ω Δt in its exponential
    assert np.isfinite(found).all() and found.min() >= 0


def test_too_many_events_are_refused():
    net = network(6)
    slots = build(SELF, (net, events(net, 60, 0.9)))
    with pytest.raises(DataError, match=r"\d+ incomplete events on 15 pairs are too many"):
        scores_by_enumeration(slots)


@pytest.mark.mpi
def test_same_scores_on_any_number_of_ranks(comm):
    problem = (net := network(5, seed=6), events(net, 30, 0.25, seed=6))
    here, alone = build(comm, problem), build(SELF, problem)
    for score in (scores_by_enumeration, energy_scores):
        found = here.gather(score(here))
        assert found is None or np.allclose(found, score(alone), rtol=1e-13)


def test_reference_fills_in_every_way_once():
    slots = build(SELF, (net := network(4), events(net, 8, 0.5, seed=7)))
    ways = {tuple(chosen) for chosen, _, _ in filled(slots)}
    assert len(ways) == allocations(slots)
