"""Mean field: probabilities, near the posterior, from one recursion over slots."""

import numpy as np
import pytest
from hawkes_problems import build, events, network, problems
from hawkes_reference import hidden, thinned
from hypothesis import given, settings
from mpi4py import MPI

from extremal.hawkes.enumeration import scores_by_enumeration
from extremal.hawkes.events import Events, Network
from extremal.hawkes.meanfield import mean_field, of_all, of_incomplete
from extremal.hawkes.reconstruct import reconstruct

SELF = MPI.COMM_SELF


def both(problem, comm=SELF):
    """Slots of all events, and of the incomplete ones."""
    return build(comm, problem, complete=True), build(comm, problem)


def log_loss(slots, full, values):
    """Mean of -ln of what the true pairs were given."""
    truth = slots.network.number(*full.participants[slots.event].T)[slots.column]
    return -np.log(values[slots.pair == truth]).mean()


def written_out(slots, sweeps):
    """The formula of `mean_field` with the whole logarithm, for slots of all events."""
    net, T, time = slots.network, slots.events.duration, slots.events.time[slots.event][slots.column]
    θ, ω = net.branching[slots.pair], net.decay[slots.pair]
    later = (slots.column[None, :] > slots.column[:, None]) & (slots.pair[None, :] == slots.pair[:, None])
    k = np.where(later, (θ * ω)[:, None] * np.exp(-ω[:, None] * np.abs(time[None, :] - time[:, None])), 0.0)
    q = 1 / slots.candidates[slots.column].astype(float)
    for sweep in range(sweeps):
        λ = net.background[slots.pair] + k.T @ q
        s = np.log(λ) + np.log1p(k / (λ[None, :] - q[:, None] * k)) @ q - θ * (1 - np.exp(-ω * (T - time)))
        e = np.exp(s - s.max())
        q += (1.0 if 2 * sweep < sweeps else 0.5) * (e / np.bincount(slots.column, weights=e)[slots.column] - q)
    return q


@settings(max_examples=100)
@given(problems())
def test_probabilities_sum_to_one_and_complete_events_are_certain(problem):
    everything = build(SELF, problem, complete=True)
    q = mean_field(everything)
    assert np.isfinite(q).all() and (q >= 0).all()
    assert np.allclose(everything.columns(q, np.ones(len(q))), 1, atol=1e-12)
    certain = ~everything.events.incomplete[everything.event][everything.column]
    assert np.allclose(q[certain], 1, atol=1e-15)


def test_last_event_has_its_exact_posterior():
    """No later event, hence nothing to approximate: q is λ e^{-θ(1 - e^{-ω(T-t)})}, normalised."""
    net, known = network(6, seed=1), events(network(6), 80, 0.0, seed=1)
    people = known.participants.copy()
    people[-1, 1] = -1
    everything, slots = both((net, Events(known.time, people, known.duration + 7)))
    found = of_incomplete(everything, slots, mean_field(everything, sweeps=2))
    # the later half of two sweeps goes half way, from where the first has been
    assert np.allclose(found, scores_by_enumeration(slots, compensator=True), rtol=0, atol=1e-12)


def test_recursion_stands_for_the_whole_logarithm():
    for seed in range(4):
        net = network(5, seed=seed)
        everything = build(SELF, (net, hidden(full := thinned(net, 800.0, seed), len(full) // 2, seed)), complete=True)
        # the logarithm interpolated by a parabola in e^{-ωΔt}, and a first-order term: not exact, but near
        assert np.abs(mean_field(everything) - written_out(everything, 10)).mean() < 5e-3


def test_mean_field_is_nearer_to_the_posterior_than_squared_weights():
    distance = np.zeros(2)
    for seed in range(20):
        net = network(4, seed=seed)
        everything, slots = both((net, hidden(thinned(net, 600.0, seed), 8, seed)))
        exact = scores_by_enumeration(slots, compensator=True)
        squares = reconstruct(slots).weights ** 2
        found = of_incomplete(everything, slots, mean_field(everything))
        distance += np.abs(found - exact).mean(), np.abs(squares - exact).mean()
    assert distance[0] < 0.5 * distance[1]
    assert distance[0] / 20 < 0.02


def test_log_loss_is_below_that_of_squared_weights():
    losses = []
    for seed in range(5):
        net = network(9, seed=seed)
        full = thinned(net, 600.0, seed)
        everything, slots = both((net, hidden(full, len(full) // 2, seed)))
        found = of_incomplete(everything, slots, mean_field(everything))
        losses.append([log_loss(slots, full, v) for v in (found, reconstruct(slots).weights ** 2)])
    better, worse = np.mean(losses, axis=0)
    assert better < worse - 0.05


def test_compensator_counts_offspring_that_never_came():
    """Two pairs with equal backgrounds, one event long ago: it was the barren pair's."""
    net = Network(("a", "b", "c"), [[0, 1], [0, 2]], [0.1, 0.1], [0.0, 2.0], [1.0, 1.0])
    everything = build(SELF, (net, Events([1.0], [[0, -1]], 50.0)), complete=True)
    assert mean_field(everything) == pytest.approx(np.array([1, np.exp(-2)]) / (1 + np.exp(-2)), rel=1e-12)
    assert mean_field(everything, compensator=False) == pytest.approx([0.5, 0.5])


def test_start_does_not_matter_where_excitation_is_moderate():
    everything, slots = both((net := network(6, background=0.02, branching=0.3), events(net, 120, 0.5, seed=2)))
    start = of_all(everything, slots, reconstruct(slots).weights ** 2)
    near = mean_field(everything, sweeps=60, start=start)
    assert np.allclose(mean_field(everything, sweeps=60), near, rtol=0, atol=1e-9)  # half steps: 2^-30


def test_shift_of_time_and_names_do_not_matter():
    net, known = network(5, seed=3), events(network(5), 60, 0.5, seed=3, both=0.3)
    q = mean_field(build(SELF, (net, known), complete=True))
    shifted = Events(known.time + 1e9, known.participants, known.duration + 1e9)
    assert np.allclose(mean_field(build(SELF, (net, shifted), complete=True)), q, rtol=0, atol=1e-4)  # 1e9 + t rounded
    order = np.random.default_rng(0).permutation(len(net))
    parameters = (getattr(net, name)[order] for name in ("background", "branching", "decay"))
    other = build(SELF, (Network(net.agents, net.pairs[order], *parameters), known), complete=True)
    table = np.zeros((other.count, len(net)))
    table[other.column, order[other.pair]] = mean_field(other)
    mine = build(SELF, (net, known), complete=True)
    assert np.allclose(table[mine.column, mine.pair], q, rtol=0, atol=1e-13)


@pytest.mark.hard
@pytest.mark.parametrize("θ", [0.0, 0.999, 50.0])
@pytest.mark.parametrize("scale", [1e-12, 1e-6, 1.0, 1e6, 1e12])
def test_hard_scales_stay_finite(θ, scale):
    net = network(5, seed=4)
    net = net.with_parameters(np.where(np.arange(10) < 5, 0, net.background), np.full(10, θ), net.decay)
    known = events(net, 60, 0.6, seed=4)
    time = scale * np.repeat(known.time[::2], 2)  # ties
    q = mean_field(everything := build(SELF, (net, Events(time, known.participants, time[-1])), complete=True))
    assert np.isfinite(q).all()
    assert np.allclose(everything.columns(q, np.ones(len(q))), 1, atol=1e-12)


@pytest.mark.mpi
def test_same_probabilities_on_any_number_of_ranks(comm):
    problem = (net := network(7, seed=5), events(net, 200, 0.5, seed=5, both=0.2))
    here, alone = build(comm, problem, complete=True), build(SELF, problem, complete=True)
    found = here.gather(mean_field(here))
    assert found is None or np.allclose(found, mean_field(alone), rtol=0, atol=1e-13)


@pytest.mark.mpi
def test_slots_of_all_events_and_of_incomplete_ones_map_to_each_other(comm):
    problem = (net := network(6, seed=6), events(net, 90, 0.4, seed=6, both=0.2))
    everything, slots = both(problem, comm)
    label = 1000.0 * slots.column + slots.pair + slots.first_pair
    back = of_incomplete(everything, slots, of_all(everything, slots, label))
    assert np.array_equal(back, label)
    filled = of_all(everything, slots, label)
    certain = ~everything.events.incomplete[everything.event][everything.column]
    assert (filled[certain] == 1).all()
    assert np.array_equal(filled[~certain] % 1000, (everything.pair + everything.first_pair)[~certain])
