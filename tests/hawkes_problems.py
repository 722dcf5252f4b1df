"""Networks and events for the tests, and the sums of chapter 3 written out."""

import numpy as np
from hypothesis import strategies as st

from extremal.hawkes.events import UNKNOWN, Events, Network
from extremal.hawkes.slots import Slots


def network(agents=6, seed=None, background=0.01, branching=0.5, decay=0.1):
    """Every pair; parameters spread over a decade or more where a seed is given."""
    net = Network.complete(agents, background, branching, decay)
    if seed is None:
        return net
    rng = np.random.default_rng(seed)
    μ, ω = (value * 10 ** rng.uniform(-1, 1, len(net)) for value in (background, decay))
    return net.with_parameters(μ, rng.uniform(0.1, 0.9, len(net)), ω)


def events(net, count, incomplete, seed=0, duration=None, both=0.0):
    """Events at random times of random pairs; a share has one participant missing, a share of those both."""
    rng = np.random.default_rng(seed)
    duration = 25.0 * count / len(net) if duration is None else duration
    time = np.sort(rng.uniform(0, duration, count))
    people = net.pairs[rng.integers(0, len(net), count)].copy()
    blank = rng.random(count) < incomplete
    side = rng.integers(0, 2, count)
    people[blank, side[blank]] = UNKNOWN
    people[blank & (rng.random(count) < both)] = UNKNOWN
    return Events(time, people, duration)


def dense(slots):
    """A (S, S) and b (S,) of (3.20), written out from (3.3); all slots on one rank."""
    net, known = slots.network, slots.events
    time = known.time[slots.event][slots.column]
    pair = slots.pair + slots.first_pair
    coupling = net.branching * net.decay
    with np.errstate(over="ignore", under="ignore"):
        A = 0.5 * coupling[pair] * np.exp(-net.decay[pair] * np.abs(time[:, None] - time)) * (pair[:, None] == pair)
        np.fill_diagonal(A, 0)
        number = net.number(*known.participants.T)
        number[known.incomplete] = -1
        b = net.background[pair].copy()
        for s, (k, t) in enumerate(zip(pair, time, strict=True)):
            b[s] += coupling[k] * np.exp(-net.decay[k] * np.abs(known.time[number == k] - t)).sum()
    return A, b


@st.composite
def problems(draw):
    """A small network and events of every kind: ties, long gaps, inactive pairs, one or both participants missing."""
    agents = draw(st.integers(2, 6))
    count = draw(st.integers(1, 25))
    seed = draw(st.integers(0, 2**32 - 1))
    rng = np.random.default_rng(seed)
    net = network(agents, seed=seed)
    if draw(st.booleans()) and len(net) > 1:
        idle = rng.random(len(net)) < 0.3
        idle[0] = False
        net = net.with_parameters(np.where(idle, 0, net.background), np.where(idle, 0, net.branching), net.decay)
    gaps = rng.exponential(10.0 ** rng.uniform(-3, 3, count))
    gaps[rng.random(count) < draw(st.sampled_from([0.0, 0.3]))] = 0
    time = np.cumsum(gaps)
    people = net.pairs[rng.choice(np.flatnonzero(net.active), count)].copy()
    blank = rng.random(count) < draw(st.sampled_from([0.3, 1.0]))
    people[blank, rng.integers(0, 2, count)[blank]] = UNKNOWN
    people[blank & (rng.random(count) < 0.3)] = UNKNOWN
    return net, Events(time, people, float(time[-1]))


def unit_columns(slots, values):
    """Largest distance of a column's length from 1."""
    return float(np.abs(slots.columns(values, values) - 1).max(initial=0))


def build(comm, problem, **kind):
    """Slots of a (network, events)."""
    return Slots.build(comm, *problem, **kind)
