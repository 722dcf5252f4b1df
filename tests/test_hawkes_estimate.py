"""Parameters from incomplete events: stochastic EM finds them, plain EM and complete events alone do not."""

import numpy as np
import pytest
from hawkes_problems import events, network
from hawkes_reference import hidden, log_likelihood, thinned
from mpi4py import MPI
from scipy.optimize import minimize

from extremal.hawkes.estimate import Estimation, maximum, rough_guess
from extremal.hawkes.events import DataError, Events, Network
from extremal.hawkes.likelihood import Statistics

SELF = MPI.COMM_SELF
TRUTH = np.array([0.01, 0.5, 0.1])


def parameters(net):
    return np.stack([net.background, net.branching, net.decay])


def estimated(net, known, rounds, **options):
    found = Estimation(SELF, rough_guess(net, known), known, **options)
    for _ in range(rounds):
        found.step()
    return found


def errors(found):
    return np.stack(list(found.standard_errors().values()))


@pytest.fixture(scope="module")
def half_known():
    """36 pairs with the same parameters, some 4,300 events, half of them incomplete."""
    net = Network.complete(9, *TRUTH)
    full = thinned(net, 6000.0, 1)
    return net, full, hidden(full, len(full) // 2, 1)


@pytest.fixture(scope="module")
def stochastic(half_known):
    net, _, known = half_known
    return estimated(net, known, 50, chains=2)


def test_score_and_curvature_are_the_derivatives_of_the_likelihood():
    net, known = network(4, seed=1), events(network(4), 80, 0.0, seed=1)
    pair = net.number(*known.participants.T)

    def logarithm(shift, k):
        moved = parameters(net)
        moved[:, k] *= np.exp(shift)
        return log_likelihood(net.with_parameters(*moved), known.time, pair, known.duration, True)

    found = Statistics.of(net, known.time, pair, known.duration)
    h = 1e-3 * np.eye(3)
    for k in range(len(net)):
        slope = [(logarithm(d, k) - logarithm(-d, k)) / 2e-3 for d in h]
        assert np.allclose(found.score[:, k], slope, rtol=1e-5, atol=1e-4)  # h² of central differences
        bend = [
            [(logarithm(a + b, k) - logarithm(a - b, k) - logarithm(b - a, k) + logarithm(-a - b, k)) / 4e-6 for a in h]
            for b in h
        ]
        assert np.allclose(found.curvature[:, :, k], bend, rtol=1e-4, atol=1e-3)


def test_rounds_on_complete_events_climb_to_the_maximum_likelihood():
    net = Network.complete(4, *TRUTH)
    full = thinned(net, 3000.0, 2)
    pair = net.number(*full.participants.T)
    ones = np.ones(6)

    def loss(logarithms):
        now = Statistics.of(net.with_parameters(*np.exp(logarithms)[:, None] * ones), full.time, pair, full.duration)
        return -(now.log_likelihood - now.compensator).sum()

    found = Estimation(SELF, rough_guess(net, full), full, method="complete")
    losses = []
    for _ in range(100):
        found.step()
        losses.append(loss(np.log(parameters(found.network)[:, 0])))
    best = minimize(loss, np.log(TRUTH), method="BFGS")
    assert (np.diff(losses) <= 1e-9).all()
    assert np.allclose(np.log(parameters(found.network)[:, 0]), best.x, rtol=0, atol=1e-4)  # of BFGS
    assert found.drift < 1e-4


def test_stochastic_em_recovers_the_parameters_from_half_of_the_participants(stochastic):
    assert np.allclose(parameters(stochastic.network)[:, 0], TRUTH, rtol=0.1, atol=0)
    assert stochastic.history.shape == (50, 3)
    assert stochastic.drift < 0.05
    assert not len(stochastic.supercritical)


@pytest.mark.parametrize("method", ["soft", "complete"])
def test_plain_em_and_complete_events_alone_are_biased(half_known, method):
    net, _, known = half_known
    found = estimated(net, known, 50, method=method)
    μ, θ, _ = parameters(found.network)[:, 0] / TRUTH
    assert found.drift < 1e-3  # where they stand is where they stay
    assert μ < 0.9
    assert θ > 1.1 if method == "soft" else θ < 0.9


def test_missing_participants_cost_precision(half_known, stochastic):
    net, full, _ = half_known
    whole = estimated(net, full, 50, method="complete")
    with_all, with_half = errors(whole)[:, 0], errors(stochastic)[:, 0]
    assert (with_half > 1.1 * with_all).all()
    assert (with_half < 2 * with_all).all()


def test_standard_errors_of_complete_events_are_the_inverse_curvature(half_known):
    net, full, _ = half_known
    found = estimated(net, full, 50, method="complete")
    at = found.network
    sums = Statistics.of(at, full.time, at.number(*full.participants.T), full.duration)
    expected = np.sqrt(np.diag(np.linalg.inv(-sums.curvature.sum(axis=2)))) * parameters(at)[:, 0]
    assert np.allclose(errors(found)[:, 0], expected, rtol=1e-10)


def test_standard_errors_are_what_estimates_scatter_by():
    """Over 24 data sets: errors in units of the standard error have unit variance, within what 24 can tell."""
    net = Network.complete(5, *TRUTH)
    scores = []
    for seed in range(24):
        full = thinned(net, 2000.0, seed)
        found = estimated(net, hidden(full, len(full) // 2, seed), 24, chains=2, seed=seed)
        at = parameters(found.network)[:, 0]
        scores.append(np.log(at / TRUTH) / (errors(found)[:, 0] / at))
    spread = np.sqrt(np.mean(np.square(scores), axis=0))
    assert (0.65 < spread).all() and (spread < 1.4).all()  # 1 ± 0.43: three standard errors of a deviation from 24
    assert (np.abs(scores) < 1.96).mean() > 0.85


def test_parameters_per_pair_lie_between_the_pair_and_the_rest():
    rng = np.random.default_rng(3)
    spread = 10 ** rng.normal(0, 0.2, (3, 15))
    net = Network.complete(6, *TRUTH).with_parameters(*(TRUTH * [1, 0.8, 1])[:, None] * spread)
    full = thinned(net, 4000.0, 3)
    known = hidden(full, len(full) // 3, 3)

    def error(**options):
        found = estimated(net, known, 30, chains=2, **options)
        return np.sqrt(np.mean(np.log(parameters(found.network) / parameters(net)) ** 2)), found

    shrunk, found = error(per_pair=True)
    assert shrunk < error(per_pair=True, strength=0.01)[0]
    assert shrunk < error(per_pair=False)[0]
    assert errors(found).shape == (3, 15)
    at = parameters(found.network)
    assert (np.abs(np.log(at / parameters(net))) < 1.96 * errors(found) / at).mean() > 0.85


def test_strength_leads_from_own_to_common_parameters():
    sums = np.array([[4.0, 8.0], [2.0, 6.0], [20.0, 30.0], [5.0, 13.0], [1.0, 2.0]])
    old = np.ones((3, 2))
    common = maximum(sums, 100.0, old, np.inf)
    assert np.allclose(common[:, 0], [12 / 200, 8 / 18, 8 / (50 + 3 * 8 / 18)])
    assert np.allclose(common[:, 0], common[:, 1])
    assert np.allclose(maximum(sums, 100.0, old, 1e12), common, rtol=1e-9)
    θ = sums[1] / sums[3]
    own = [sums[0] / 100, θ, sums[1] / (sums[2] + θ * sums[4])]
    assert np.allclose(maximum(sums, 100.0, old, 0.0), own)
    nothing = maximum(np.zeros((5, 2)), 100.0, old, 0.0)
    assert np.isfinite(nothing).all() and (nothing[2] == 1).all()


def test_branching_of_one_or_more_is_flagged():
    net = Network.complete(3, 0.01, 1.6, 0.1)
    full = thinned(net, 120.0, 5)
    assert len(full) > 100
    found = estimated(net, hidden(full, len(full) // 4, 5), 30)
    assert found.supercritical.tolist() == [0, 1, 2]
    assert np.isfinite(parameters(found.network)).all()


def test_inactive_pairs_stay_so_and_have_no_error():
    net = Network.complete(5, *TRUTH)
    idle = np.arange(10) < 3
    net = net.with_parameters(np.where(idle, 0, net.background), np.where(idle, 0, net.branching), net.decay)
    full = thinned(net, 2000.0, 6)
    for per_pair in (False, True):
        found = estimated(net, hidden(full, len(full) // 2, 6), 10, per_pair=per_pair)
        assert found.network.active.tolist() == (~idle).tolist()
        assert (errors(found)[:, idle] == 0).all() and (errors(found)[:, ~idle] > 0).all()


@pytest.mark.parametrize("method", ["stochastic", "soft", "complete"])
@pytest.mark.parametrize("per_pair", [False, True])
def test_little_or_strange_data_leave_parameters_finite(method, per_pair):
    net = network(4)
    one = Events([2.0], [[0, 1]], 10.0)
    ties = Events(np.repeat([1.0, 1e9, 2e9], 4), np.tile([[0, 1], [2, 3]], (6, 1)), 2e9)
    for known in (one, ties):
        found = estimated(net, known, 5, method=method, per_pair=per_pair)
        now = parameters(found.network)
        assert np.isfinite(now).all() and (now >= 0).all() and found.network.active.all()
        if method != "soft":
            assert not np.isnan(errors(found)).any()


def test_nothing_to_estimate_from_is_refused():
    net = network(3)
    for known in (Events([], np.empty((0, 2)), 5.0), Events([0.0], [[0, 1]], 0.0)):
        with pytest.raises(DataError, match="no events, or no time"):
            Estimation(SELF, net, known)
    with pytest.raises(DataError, match="no events"):
        Estimation(SELF, net, Events([1.0], [[-1, -1]], 5.0), method="complete")


def test_restored_estimation_goes_on_as_before():
    net = network(5, seed=9)
    known = hidden(thinned(net, 500.0, 9), 40, 9)
    straight = estimated(net, known, 6, chains=2)
    begun, resumed = estimated(net, known, 3, chains=2), Estimation(SELF, net, known, chains=2)
    resumed.restore(begun.state())
    for _ in range(3):
        resumed.step()
    assert np.array_equal(resumed.history, straight.history)


@pytest.mark.mpi
@pytest.mark.parametrize("method", ["stochastic", "soft"])
def test_same_estimates_on_any_number_of_ranks(comm, method):
    net = network(5, seed=8)
    known = hidden(thinned(net, 500.0, 8), 40, 8)
    found = [Estimation(c, net, known, method=method, chains=3, per_pair=True) for c in (comm, SELF)]
    for _ in range(3):
        for one in found:
            one.step()
    here, alone = (parameters(one.network) for one in found)
    assert np.allclose(here, alone, rtol=1e-10, atol=0)
    if method == "stochastic":
        assert np.array_equal(here, alone)
        assert np.allclose(errors(found[0]), errors(found[1]), rtol=1e-12)
