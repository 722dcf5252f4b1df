"""Gibbs sampling: every move from the exact conditional distribution, hence the posterior in the mean."""

import numpy as np
import pytest
from hawkes_problems import build, events, network, problems
from hawkes_reference import hidden, thinned
from hypothesis import assume, given, settings
from mpi4py import MPI

from extremal.hawkes.enumeration import scores_by_enumeration
from extremal.hawkes.events import Events, Network
from extremal.hawkes.gibbs import Sampler, annealing, gibbs
from extremal.hawkes.meanfield import mean_field

SELF = MPI.COMM_SELF


@settings(max_examples=60)
@given(problems())
def test_each_move_is_drawn_from_the_exact_conditional_distribution(problem):
    """Of the last incomplete event: after a sweep all others are where they were when it moved."""
    net, known = problem
    slots = build(SELF, problem)
    # without background an event may have nowhere to go; the sampler is given a floor under it by `gibbs`
    assume(slots.count > 1 and (net.background[net.active] > 0).all())
    sampler, ignored = Sampler(slots, np.random.default_rng(0)), np.zeros(len(slots))
    sampler.sweep(net, ignored, 0.3)
    for _ in range(3):
        mean = np.zeros(len(slots))
        sampler.sweep(net, mean)
        last = slots.event[-1]
        people = known.participants.copy()
        people[slots.event[:-1]] = net.pairs[sampler.pair[slots.event[:-1]]]
        rest = build(SELF, (net, Events(known.time, people, known.duration)))
        exact = scores_by_enumeration(rest, compensator=True)
        mine = exact[rest.column == np.searchsorted(rest.event, last)]
        assert np.allclose(mean[slots.start[-2] :], mine, rtol=0, atol=1e-10)  # sums of a hundred logarithms


@pytest.mark.parametrize("mode", ["heterogeneous", "ties", "some inactive"])
def test_posterior_agrees_with_enumeration(mode):
    net = network(4, seed=1)
    full = thinned(net, 500.0, 1)
    time, people = full.time, hidden(full, 8, 1).participants
    if mode == "ties":
        time = np.floor(time / 20) * 20
    if mode == "some inactive":
        quiet = np.bincount(net.number(*full.participants.T), minlength=6).argmin()
        people = people[net.number(*people.T) != quiet]
        time = time[: len(people)]
        parameters = [net.background.copy(), net.branching.copy(), net.decay]
        parameters[0][quiet] = parameters[1][quiet] = 0
        net = net.with_parameters(*parameters)
    slots = build(SELF, (net, Events(time, people, 500.0)))
    exact = scores_by_enumeration(slots, compensator=True)
    found = gibbs(slots, sweeps=4000, seed=3)
    # 16,000 draws: 0.004 were they independent and merely counted; neighbours in a chain are not quite independent
    assert np.abs(found - exact).max() < 0.015
    assert np.abs(found - exact).mean() < 0.003


def test_clusters_find_their_pair_although_events_move_one_by_one():
    """Strong excitation, everything incomplete: the chain starts loose, and agrees with the mean field on most."""
    net = network(6, background=0.001, branching=0.8, decay=1.0)
    full = thinned(net, 4000.0, 2)
    problem = (net, hidden(full, len(full), 2))
    slots = build(SELF, problem)
    truth = net.number(*full.participants.T)[slots.column] == slots.pair
    sampled, field = gibbs(slots, sweeps=50), mean_field(build(SELF, problem, complete=True))
    assert sampled[truth].mean() > 0.75
    assert sampled[truth].mean() > field[truth].mean() - 0.05


def test_annealing_ends_at_the_posterior():
    powers = annealing(50)
    assert (np.diff(powers) >= 0).all() and powers[0] < 0.2 and (powers[-10:] == 1).all()
    assert len(annealing(0)) == 0


def test_complete_events_and_single_candidates_stay_where_they_are():
    net = Network(("a", "b", "c"), [[0, 1], [0, 2]], 0.1, 0.5, 1.0)
    slots = build(SELF, (net, Events([1.0, 2.0, 3.0], [[0, 2], [1, -1], [0, -1]], 3.0)))
    sampler = Sampler(slots, np.random.default_rng(0))
    for _ in range(20):
        sampler.sweep(net, np.zeros(len(slots)))
        assert sampler.pair[:2].tolist() == [1, 0] and sampler.pair[2] in (0, 1)
    assert gibbs(slots, sweeps=5)[0] == 1


def test_what_nothing_explains_is_left_out():
    net = Network(("a", "b", "c", "d"), [[0, 1], [2, 3]], [0.1, 0.0], [0.5, 0.0], 1.0)
    slots = build(SELF, (net, Events([1.0, 2.0, 3.0], [[2, -1], [2, 3], [-1, -1]], 3.0)))
    assert gibbs(slots, sweeps=5).tolist() == [1.0]
    assert len(gibbs(build(SELF, (net, Events([], np.empty((0, 2)), 1.0))), sweeps=5)) == 0


@pytest.mark.hard
@pytest.mark.parametrize("θ", [0.0, 0.999, 50.0])
@pytest.mark.parametrize("scale", [1e-12, 1e-6, 1.0, 1e6, 1e12])
def test_hard_scales_stay_finite(θ, scale):
    net = network(5, seed=4)
    net = net.with_parameters(np.where(np.arange(10) < 5, 0, net.background), np.full(10, θ), net.decay)
    known = events(net, 60, 0.6, seed=4)
    time = scale * np.repeat(known.time[::2], 2)  # ties
    slots = build(SELF, (net, Events(time, known.participants, time[-1])))
    found = gibbs(slots, sweeps=5)
    assert np.isfinite(found).all()
    assert np.allclose(slots.columns(found, np.ones(len(found))), 1, atol=1e-12)


def test_epoch_seconds_change_nothing():
    """Gaps of 1e9 between clusters, decay of hours: what is far has no effect, and no digit is lost on the way."""
    net = network(4, background=1e-9, decay=1e-4)
    near = np.cumsum(np.random.default_rng(0).exponential(3e3, 30))
    people = events(net, 60, 0.3, seed=1).participants
    slots = build(SELF, (net, Events(np.r_[near, 1e9 + near], people, 1e9 + near[-1])))
    late = build(SELF, (net, Events(near, people[30:], near[-1])))
    exact = gibbs(late, sweeps=2000)
    assert np.abs(gibbs(slots, sweeps=2000)[-len(late) :] - exact).max() < 0.05  # two samples of 8,000


def test_a_state_goes_on_as_if_nothing_had_been():
    net = network(5, seed=6)
    slots = build(SELF, (net, events(net, 80, 0.5, seed=6)))
    kept, other = (Sampler(slots, np.random.Generator(np.random.Philox(seed))) for seed in (1, 2))
    unused = np.zeros(len(slots))
    kept.sweep(net, unused)
    other.restore(*kept.state())
    for _ in range(3):
        kept.sweep(net, unused)
        other.sweep(net, unused)
        assert np.array_equal(kept.pair, other.pair)


@pytest.mark.mpi
def test_same_seed_same_answer_on_any_number_of_ranks(comm):
    problem = (net := network(6, seed=7), events(net, 100, 0.5, seed=7, both=0.2))
    here, alone = build(comm, problem), build(SELF, problem)
    found = here.gather(gibbs(here, sweeps=20, seed=5, chains=5))
    expected = gibbs(alone, sweeps=20, seed=5, chains=5)
    assert found is None or np.array_equal(found, expected)
    assert not np.array_equal(expected, gibbs(alone, sweeps=20, seed=6, chains=5))
