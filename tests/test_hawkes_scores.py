"""Scores of predictions, against cases counted by hand and the probabilities they estimate."""

import numpy as np
import pytest
from mpi4py import MPI

from extremal.hawkes import scores
from extremal.hawkes.events import UNKNOWN, Events, Network
from extremal.hawkes.simulate import hide, simulate
from extremal.hawkes.slots import Slots


@pytest.fixture
def three(comm):
    """Four events, each of which any of three pairs could explain."""
    network = Network.complete(3, 0.1, 0.5, 1.0)
    return Slots.build(comm, network, Events([1.0, 2.0, 3.0, 4.0], np.full((4, 2), UNKNOWN), 4.0))


def share_of(slots, whole):
    """This rank's part of values (n, K)."""
    return np.ascontiguousarray(np.asarray(whole, float)[slots.column, slots.first_pair + slots.pair])


@pytest.mark.mpi
def test_rank_of_the_truth_counts_larger_values(three):
    values = share_of(three, [[0.5, 0.3, 0.2], [0.2, 0.5, 0.3], [1, 2, 3], [1, 2, 3]])
    assert scores.ranks_of_truth(three, values, np.array([0, 0, 1, -1]), seed=1).tolist() == [1, 3, 2, 0]


@pytest.mark.mpi
def test_a_truth_that_is_no_candidate_comes_after_all(comm):
    network = Network(("a", "b", "c"), np.array([[0, 1], [0, 2], [1, 2]]), np.array([0.1, 0.1, 0.1]), 0.5, 1.0)
    slots = Slots.build(comm, network, Events([1.0], np.array([[0, UNKNOWN]]), 1.0))
    assert scores.ranks_of_truth(slots, slots.uniform(), np.array([2]), seed=1).tolist() == [3]


@pytest.mark.mpi
def test_ties_stand_in_random_order_the_same_on_any_number_of_ranks(comm):
    network = Network.complete(3, 0.1, 0.5, 1.0)
    n = 3000
    events = Events(np.arange(n, dtype=float), np.full((n, 2), UNKNOWN), float(n))
    values = np.tile([0.4, 0.4 * (1 + 1e-14), 0.2], (n, 1))
    slots, alone = Slots.build(comm, network, events), Slots.build(MPI.COMM_SELF, network, events)
    truth = np.zeros(n, dtype=int)
    ranks = scores.ranks_of_truth(slots, share_of(slots, values), truth, seed=4)
    np.testing.assert_array_equal(ranks, scores.ranks_of_truth(alone, share_of(alone, values), truth, seed=4))
    assert set(ranks) == {1, 2}
    assert abs((ranks == 1).mean() - 0.5) < 4 * np.sqrt(0.25 / n)


def test_wilson_interval_is_that_of_the_literature():
    """Newcombe (1998), table I."""
    literature = ((81, 263, 0.2553, 0.3662), (15, 148, 0.0624, 0.1605), (0, 20, 0, 0.1611), (1, 29, 0.0061, 0.1718))
    for hits, n, low, high in literature:
        np.testing.assert_allclose(scores.wilson(hits / n, n), (low, high), atol=5e-5)


def test_share_within_the_first_k():
    share = scores.top(np.array([1, 2, 2, 3, 0]), 2)
    assert (share.share, share.events) == (0.75, 4)
    assert (share.low, share.high) == scores.wilson(0.75, 4)
    assert np.isnan(scores.top(np.zeros(3), 1).share)


@pytest.mark.parametrize("correlated", [False, True])
def test_interval_of_runs_covers_the_truth_in_95_percent(correlated):
    """Events of one run that all share their luck; the plain interval covers 37% then (1.96/sqrt(16) deviations)."""
    random = np.random.default_rng(1)
    runs = np.repeat(np.arange(100), 16)
    covered = 0
    for _ in range(500):
        luck = np.repeat(random.random(100), 16) if correlated else random.random(1600)
        share = scores.top(np.where(luck < 0.3, 1, 2), 1, runs)
        covered += share.low <= 0.3 <= share.high
    assert abs(covered / 500 - 0.95) < 4 * np.sqrt(0.95 * 0.05 / 500)


def test_runs_that_never_vary_do_not_make_an_interval_vanish():
    share = scores.top(np.ones(100), 1, np.repeat(np.arange(10), 10))
    assert share.share == 1.0
    assert share.high > 1 - 1e-12
    assert share.low == scores.wilson(1.0, 10)[0] < 0.75


@pytest.mark.mpi
def test_log_loss_is_the_mean_of_minus_log_p(three):
    p = share_of(three, [[0.5, 0.3, 0.2], [0.2, 0.5, 0.3], [0, 0.5, 0.5], [1, 0, 0]])
    found = scores.log_loss(three, p, np.array([0, 2, 1, -1]))
    np.testing.assert_allclose(found, -np.log([0.5, 0.3, 0.5]).mean(), rtol=1e-14)
    assert scores.log_loss(three, p, np.array([0, 2, 0, -1])) == np.inf


@pytest.mark.mpi
def test_calibration_counts_slots_by_their_probability(three):
    p = share_of(three, [[0.5, 0.3, 0.2], [0.2, 0.5, 0.3], [0.0, 0.5, 0.5], [1, 0, 0]])
    table = scores.calibration(three, p, np.array([0, 2, 1, 0]), bins=4)
    assert table.count.tolist() == [5, 2, 4, 1]  # [0, 1/4), ..., [3/4, 1]
    np.testing.assert_allclose(table.predicted, [0.08, 0.3, 0.5, 1.0])
    np.testing.assert_allclose(table.observed, [0.0, 0.5, 0.5, 1.0])


@pytest.mark.mpi
def test_baselines_are_probabilities_and_do_what_their_names_say(comm):
    network = Network.complete(5, 0.01, 0.5, 0.1)
    whole = simulate(network, count=400, seed=1)
    truth = network.number(*whole.participants.T)
    slots = Slots.build(comm, network, hide(whole, 100, seed=1))
    for method in (scores.guessing, scores.most_frequent, scores.linear):
        p = method(slots)
        np.testing.assert_allclose(slots.columns(p, np.ones(len(p))), 1.0, rtol=1e-12)
    np.testing.assert_allclose(scores.log_loss(slots, scores.guessing(slots), truth), np.log(4), rtol=1e-12)
    complete = truth[~slots.events.incomplete]
    expected = 1.0 + np.bincount(complete, minlength=len(network))[slots.first_pair + slots.pair]
    ratio = scores.most_frequent(slots) / expected
    np.testing.assert_allclose(ratio * slots.columns(expected, np.ones(len(expected)))[slots.column], 1.0)
    best = scores.top(scores.ranks_of_truth(slots, scores.linear(slots), truth, seed=1), 1)
    assert best.low > 0.25  # better than guessing one of four


@pytest.mark.mpi
def test_complete_events_do_not_count(comm):
    network = Network.complete(4, 0.01, 0.5, 0.1)
    whole = simulate(network, count=40, seed=1)
    slots = Slots.build(comm, network, hide(whole, 10, seed=1), complete=True)
    ranks = scores.ranks_of_truth(slots, slots.uniform(), network.number(*whole.participants.T), seed=1)
    assert (len(ranks), (ranks > 0).sum()) == (40, 10)
