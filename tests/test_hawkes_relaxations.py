"""Other normalisations of the weights, and (3.4): what section 3.2 says of them."""

import numpy as np
import pytest
from hawkes_problems import build, events, network
from mpi4py import MPI
from scipy.optimize import LinearConstraint, NonlinearConstraint, minimize

from extremal.hawkes.energy import Energy
from extremal.hawkes.events import DataError, Events, Network
from extremal.hawkes.normalised import Functional, normalised
from extremal.hawkes.reconstruct import reconstruct
from extremal.hawkes.relaxations import Hybrid, Power, relax

WORLD, SELF = MPI.COMM_WORLD, MPI.COMM_SELF


def one_event(linear):
    """Slots of one event with these b."""
    net = Network.complete(len(linear), 0.1, 0.0, 1.0)
    K = len(net)
    b = np.zeros(K)
    b[: len(linear)] = linear
    net = net.with_parameters(b, np.zeros(K), np.ones(K))
    return build(SELF, (net, Events(np.zeros(1), np.array([[-1, -1]]), 1.0)))


def left_side(constraint, x):
    x = np.maximum(x, 0)  # a general solver may look outside
    if isinstance(constraint, Power):
        return (x**constraint.p).sum()
    return (constraint.f * x**2 + (1 - constraint.f) * x).sum()


CONSTRAINTS = [Power(1.2), Power(1.5), Power(2), Power(4), Hybrid(1), Hybrid(0.7), Hybrid(0.3), Hybrid(0.05)]


@pytest.mark.parametrize("constraint", CONSTRAINTS, ids=str)
def test_the_best_weights_of_one_event_are_those_a_general_solver_finds(constraint):
    b = np.array([0.3, 1.0, 0.9, 0.02])
    found = relax(one_event(b), constraint).weights
    limit = NonlinearConstraint(lambda x: left_side(constraint, x), 0, 1)
    positive = LinearConstraint(np.eye(4), 0, 1)
    best = minimize(lambda x: -b @ x, np.full(4, 0.2), constraints=[limit, positive], method="SLSQP", tol=1e-14)
    assert left_side(constraint, found) == pytest.approx(1, abs=1e-12)
    assert b @ found == pytest.approx(-best.fun, rel=1e-7)


@pytest.mark.parametrize("constraint", [Power(1), Hybrid(0), Hybrid(-1)], ids=str)
def test_l1_puts_all_weight_on_one_pair(constraint):
    """(3.18)"""
    assert relax(one_event(np.array([0.3, 1.0, 0.9])), constraint).weights.tolist() == [0, 1, 0]


@pytest.mark.parametrize("constraint", [Power(2), Hybrid(1)], ids=str)
def test_l2_is_method_35(constraint):
    slots = build(SELF, (net := network(6, seed=1), events(net, 120, 0.5)))
    assert relax(slots, constraint).energy == pytest.approx(reconstruct(slots, gap=1e-12).energy, rel=1e-11)


@pytest.mark.mpi
@pytest.mark.parametrize("constraint", [Power(1), Power(3), Hybrid(0.4)], ids=str)
def test_rounds_end_at_a_point_no_event_can_improve_on_any_number_of_ranks(constraint):
    problem = (net := network(6, seed=2), events(net, 80, 0.8, both=0.3))
    slots = build(WORLD, problem)
    found = relax(slots, constraint, tolerance=1e-12)
    alone = relax(build(SELF, problem), constraint, tolerance=1e-12)
    again = relax(slots, constraint, start=found.weights, rounds=1)
    assert found.energy == pytest.approx(alone.energy, rel=1e-12)
    assert again.energy == pytest.approx(found.energy, rel=1e-12)


@pytest.mark.parametrize("p", [2.0, 3.0, 6.0])
def test_from_p_2_on_the_maximum_does_not_depend_on_the_start(p):
    slots = build(SELF, (net := network(5, seed=3), events(net, 60, 1.0)))
    rng = np.random.default_rng(0)
    energies = []
    for _ in range(3):
        x = rng.random(len(slots)) ** 6 + 1e-9
        x /= np.repeat(slots.columns(x ** (p / 2), x ** (p / 2)) ** (1 / p), np.diff(slots.start))
        energies.append(relax(slots, Power(p), start=x, tolerance=1e-12).energy)
    assert np.ptp(energies) < 1e-9 * energies[0]


def test_l1_depends_on_its_start():
    """Section 3.2: (3.6) is unstable; with μ = 0 two events together are at rest on any pair."""
    net = Network.complete(3, 0.0, 1.0, 1.0).with_parameters(np.zeros(3), np.ones(3), np.array([0.05, 0.5, 3.0]))
    slots = build(SELF, (net, Events(np.array([0.0, 2.0]), np.full((2, 2), -1), 2.0)))
    energies = {round(relax(slots, Power(1), start=np.tile(np.eye(3)[k], 2)).energy, 9) for k in range(3)}
    assert len(energies) == 3


@pytest.mark.parametrize(
    ("kind", "value"), [(Power, 0.9), (Power, np.nan), (Hybrid, 1.1), (Hybrid, -2), (Hybrid, np.nan)]
)
def test_constraints_without_meaning_are_refused(kind, value):
    with pytest.raises(DataError, match="must be at least"):
        kind(value)


# ---- (3.4)


def written_out(slots, x):
    """(3.4) as a double sum."""
    net, time = slots.network, slots.events.time[slots.event]
    weight = np.zeros((len(time), len(net)))
    weight[slots.column, slots.pair] = x
    total = 0.0
    for e, t in enumerate(time):
        decay = np.exp(-net.decay * (t - time[:e, None]))
        λ = net.background + net.branching * net.decay * (weight[:e] * decay).sum(axis=0)
        total += weight[e] @ λ / λ.sum()
    return total


def test_34_is_the_double_sum_and_its_gradient_the_derivative():
    slots = build(SELF, (net := network(4, seed=4), events(net, 30, 0.6)), complete=True)
    functional, rng = Functional(slots), np.random.default_rng(1)
    x, v, h = rng.random(len(slots)), rng.normal(size=len(slots)), 1e-6
    value, gradient = functional.value(x)
    assert value == pytest.approx(written_out(slots, x), rel=1e-12)
    slope = (functional.value(x + h * v)[0] - functional.value(x - h * v)[0]) / (2 * h)
    assert slope == pytest.approx(gradient @ v, rel=1e-7)


@pytest.mark.mpi
def test_34_does_not_see_the_time_scale_in_example_1():
    """Section 3.2.1: it is 1 for the second event whichever pair takes both."""
    net = Network.complete(3, 1e-9, 1.0, 1.0)
    net = net.with_parameters(net.background, net.branching, np.array([0.05, 0.5, 3.0]))
    slots = build(WORLD, (net, Events(np.array([0.0, 2.0]), np.full((2, 2), -1), 2.0)), complete=True)
    for k in range(3):
        start = np.full((2, 3), 0.01)
        start[:, k] = 1
        start /= np.linalg.norm(start, axis=1)[:, None]
        found = normalised(slots, slots.scatter(start.reshape(-1) if WORLD.rank == 0 else None))
        assert found.value > 1.3  # 1/√3 from the first event at the least, 1 from the second


def test_34_rises_from_its_start():
    slots = build(SELF, (net := network(5, seed=5), events(net, 60, 0.5)), complete=True)
    found = normalised(slots)
    assert found.reason > 0 and found.value > Functional(slots).value(slots.uniform())[0] * 1.02
    assert Energy(slots).slots.columns(found.weights, found.weights) == pytest.approx(np.ones(slots.count), abs=1e-12)
