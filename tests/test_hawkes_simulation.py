"""Simulated events have the distribution of (2.3), and are the same for the same seed."""

import numpy as np
import pytest
from scipy import stats

from extremal.hawkes.events import UNKNOWN, DataError, Events, Network
from extremal.hawkes.simulate import hide, simulate, under_report

FIRST_TIMES = [10.620540045852739, 22.241019701435295, 22.66267634179127, 26.77430481735417, 43.27816110077659]
FIRST_PARTICIPANTS = [[1, 3], [0, 3], [1, 3], [1, 3], [0, 1]]


def many(count, μ, θ, ω):
    """`count` pairs, which share no agent as far as the process is concerned, with the same parameters."""
    agents = 2
    while agents * (agents - 1) // 2 < count:
        agents += 1
    pairs = np.column_stack(np.triu_indices(agents, 1))[:count]
    return Network(tuple(map(str, range(agents))), pairs, μ, θ, ω)


def counts(network, events):
    return np.bincount(network.number(*events.participants.T), minlength=len(network))


def mean_count(μ, θ, ω, T):
    """E N(T) from an empty history: E λ(t) = μ/(1-θ) (1 - θ e^{-ω(1-θ)t}), integrated."""
    κ = ω * (1 - θ)
    return μ / (1 - θ) * (T - θ * -np.expm1(-κ * T) / κ)


@pytest.mark.parametrize(("θ", "ω", "T"), [(0.5, 0.1, 40.0), (0.9, 1.0, 100.0), (0.0, 1.0, 100.0), (0.99, 0.01, 50.0)])
def test_mean_number_of_events_is_the_closed_form(θ, ω, T):
    network = many(20000, 0.05, θ, ω)
    found = counts(network, simulate(network, duration=T, seed=3))
    error = found.std() / np.sqrt(len(found))
    assert abs(found.mean() - mean_count(0.05, θ, ω, T)) < 4 * error


def test_variance_of_a_long_stationary_count_is_the_closed_form():
    μ, θ, ω, T = 0.1, 0.5, 1.0, 2000.0
    network = many(4000, μ, θ, ω)
    found = counts(network, simulate(network, duration=T, seed=4))
    expected = μ * T / (1 - θ) ** 3
    assert abs(found.var() / expected - 1) < 4 * np.sqrt(2 / len(found))  # of a sample variance


def residuals(times, μ, θ, ω):
    """∫λ between events, standard exponential variates if λ is right."""
    excess, out = 0.0, []
    for wait in np.diff(times, prepend=0.0):
        out.append(μ * wait - excess * np.expm1(-ω * wait) / ω)
        excess = excess * np.exp(-ω * wait) + θ * ω
    return np.array(out)


@pytest.mark.parametrize("how", [{"count": 30000}, {"duration": 20000.0}])
def test_rescaled_waiting_times_are_exponential_in_every_pair(how):
    μ, θ, ω = np.array([0.5, 0.1, 0.02]), np.array([0.3, 0.8, 0.0]), np.array([0.1, 5.0, 1.0])
    network = Network(("a", "b", "c"), np.array([[0, 1], [0, 2], [1, 2]]), μ, θ, ω)
    events = simulate(network, seed=5, **how)
    number = network.number(*events.participants.T)
    for k in range(3):
        assert stats.kstest(residuals(events.time[number == k], μ[k], θ[k], ω[k]), "expon").pvalue > 0.01


def test_explosive_process_is_exact_too():
    events = simulate(many(1, 1.0, 1.5, 2.0), count=4000, seed=6)
    assert stats.kstest(residuals(events.time[:2000], 1.0, 1.5, 2.0), "expon").pvalue > 0.01


def test_same_seed_same_events_and_fewer_are_the_first_of_more():
    network = Network.complete(9, 0.01, 0.5, 0.1)
    first, again = (simulate(network, count=200_000, seed=7) for _ in range(2))
    np.testing.assert_array_equal(first.time, again.time)
    np.testing.assert_array_equal(first.participants, again.participants)
    fewer = simulate(network, count=1000, seed=7)
    np.testing.assert_array_equal(fewer.time, first.time[:1000])
    assert fewer.duration == first.time[999]
    within = simulate(network, duration=fewer.duration, seed=7)
    np.testing.assert_array_equal(within.participants, fewer.participants)
    assert simulate(network, count=10, seed=8).time[0] != first.time[0]


@pytest.mark.mpi
def test_ranks_simulate_the_same(comm):
    events = hide(simulate(Network.complete(5, 0.01, 0.5, 0.1), count=100, seed=1), 20, seed=1)
    for time, people in comm.allgather((events.time, events.participants)):
        np.testing.assert_array_equal(time, events.time)
        np.testing.assert_array_equal(people, events.participants)


def test_the_first_events_of_a_seed_never_change():
    """Published tables must be reproducible: times to the accuracy of the C library's logarithm."""
    events = simulate(Network.complete(4, 0.01, 0.5, 0.1), count=5, seed=1)
    np.testing.assert_allclose(events.time, FIRST_TIMES, rtol=1e-12)
    np.testing.assert_array_equal(events.participants, FIRST_PARTICIPANTS)


def test_hard_cases():
    one = Network.complete(2, 0.1, 0.5, 1.0)
    nothing = simulate(one, count=0, seed=1)
    assert (len(nothing), nothing.duration) == (0, 0.0)
    assert len(simulate(one, count=1, seed=1)) == 1
    assert len(simulate(one, duration=0.0, seed=1)) == 0
    # a pair without background has no event however strongly an event would excite it
    some = many(3, np.array([0.0, 0.1, 0.0]), np.array([0.9, 0.5, 0.0]), 1.0)
    assert set(some.number(*simulate(some, count=100, seed=1).participants.T)) == {1}
    silent = many(3, 0.0, 0.5, 1.0)
    assert len(simulate(silent, duration=100.0, seed=1)) == 0
    with pytest.raises(DataError, match="no pair has a background rate"):
        simulate(silent, count=1, seed=1)
    for ω in (1e-12, 1e12):
        assert (np.diff(simulate(many(3, 1e-3, 0.9, ω), count=500, seed=2).time) >= 0).all()


def test_an_explosive_duration_is_refused():
    with pytest.raises(DataError, match=r"more than 10000 events.*branching reaches 1\.5"):
        simulate(many(2, 0.1, 1.5, 1.0), duration=1000.0, seed=1, limit=10_000)
    with pytest.raises(DataError, match="duration of the simulation"):
        simulate(many(2, 0.1, 0.5, 1.0), duration=np.inf, seed=1)


def test_hidden_events_are_chosen_uniformly_and_a_coin_decides_who_is_kept():
    network = Network.complete(4, 0.01, 0.5, 0.1)
    events = simulate(network, count=10, seed=1)
    chosen, first = np.zeros(10), 0
    for seed in range(4000):
        hidden = hide(events, 3, seed=seed).participants == UNKNOWN
        assert hidden.sum() == 3
        chosen += hidden.any(axis=1)
        first += hidden[:, 0].sum()
    # each event in 30% of 4000 draws; 12000 coins
    assert np.abs(chosen - 1200).max() < 4 * np.sqrt(4000 * 0.3 * 0.7)
    assert abs(first - 6000) < 4 * np.sqrt(12000 / 4)


def test_hidden_participants_are_all_that_changes():
    events = simulate(Network.complete(4, 0.01, 0.5, 0.1), count=50, seed=1)
    for mode, lost in (("one", 1), ("both", 2)):
        hidden = hide(events, 50, mode=mode, seed=2)
        assert ((hidden.participants == UNKNOWN).sum(axis=1) == lost).all()
        kept = hidden.participants != UNKNOWN
        np.testing.assert_array_equal(hidden.participants[kept], events.participants[kept])
    some = hide(events, 10, seed=1)
    assert hide(some, 40, seed=1).incomplete.all()
    with pytest.raises(DataError, match="from 0 to 40"):
        hide(some, 41, seed=1)
    assert len(hide(Events([], np.empty((0, 2)), 0.0), 0, seed=1)) == 0


def test_unreported_events_are_lost_independently():
    events = simulate(Network.complete(4, 0.01, 0.5, 0.1), count=20000, seed=1)
    kept = under_report(events, 0.4, seed=2)
    assert abs(len(kept) - 12000) < 4 * np.sqrt(20000 * 0.24)
    assert np.isin(kept.time, events.time).all()
    assert len(under_report(events, 1.0, seed=2)) == 0
    assert len(under_report(events, 0.0, seed=2)) == len(events)
    with pytest.raises(DataError, match="from 0 to 1"):
        under_report(events, 1.1, seed=2)
