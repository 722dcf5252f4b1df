"""The network of Hawkes processes written out from (2.3), (3.1) and (3.26): slow, and independent of the package."""

import itertools

import numpy as np

from extremal.hawkes.events import UNKNOWN, Events


def thinned(net, duration, seed):
    """Events by thinning (Ogata 1981), pair by pair."""
    rng = np.random.default_rng(seed)
    found = []
    for k in range(len(net)):
        μ, θ, ω = net.background[k], net.branching[k], net.decay[k]
        t, excess = 0.0, 0.0
        while μ + excess > 0:
            wait = rng.exponential(1 / (bound := μ + excess))
            t, excess = t + wait, excess * np.exp(-ω * wait)
            if t > duration:
                break
            if rng.random() * bound < μ + excess:
                found.append((t, k))
                excess += θ * ω
    found.sort()
    time = np.array([t for t, _ in found])
    return Events(time, net.pairs[[k for _, k in found]], duration)


def hidden(full, count, seed):
    """`count` of the events with one participant missing, by the toss of a coin."""
    rng = np.random.default_rng(seed)
    people = full.participants.copy()
    people[rng.choice(len(full), count, replace=False), rng.integers(0, 2, count)] = UNKNOWN
    return Events(full.time, people, full.duration)


def log_likelihood(net, time, pair, duration, compensator):
    """ln of (3.1); of events at equal times the one that stands first comes first."""
    total = 0.0
    with np.errstate(divide="ignore", under="ignore"):
        for e, (t, k) in enumerate(zip(time, pair, strict=True)):
            earlier = time[:e][pair[:e] == k]
            excited = net.branching[k] * net.decay[k] * np.exp(-net.decay[k] * (t - earlier)).sum()
            total += np.log(net.background[k] + excited)
            if compensator:
                total -= net.branching[k] * (1 - np.exp(-net.decay[k] * (duration - t)))
    return total - compensator * duration * net.background.sum()


def energy(net, time, pair):
    """(3.3)"""
    total = net.background[pair].sum()
    for a, b in itertools.combinations(range(len(time)), 2):
        if pair[a] == pair[b]:
            k = pair[a]
            total += net.branching[k] * net.decay[k] * np.exp(-net.decay[k] * abs(time[a] - time[b]))
    return total


def allocations(slots):
    """Number of ways of filling in."""
    return np.prod(slots.candidates.astype(float))


def filled(slots):
    """For each allocation: the slots it chooses (n,), times and pairs of all events that can have happened."""
    net, events = slots.network, slots.events
    pair = net.number(*events.participants.T)
    pair[events.incomplete] = -1
    pair[(pair >= 0) & ~net.active[pair]] = -1
    choices = [range(a, b) for a, b in itertools.pairwise(slots.start)]
    for chosen in itertools.product(*choices):
        whole = pair.copy()
        whole[slots.event] = slots.pair[list(chosen)]
        there = whole >= 0
        yield np.array(chosen, dtype=int), events.time[there], whole[there]


def posterior(slots, compensator):
    """(3.26) with f = L, divided by the sum over all allocations; None if that is 0."""
    net, duration = slots.network, slots.events.duration
    ways, logs = [], []
    for chosen, time, pair in filled(slots):
        ways.append(chosen)
        logs.append(log_likelihood(net, time, pair, duration, compensator))
    top = max(logs)
    if top == -np.inf:
        return None
    out = np.zeros(len(slots))
    for chosen, value in zip(ways, logs, strict=True):
        out[chosen] += np.exp(value - top)
    return out / np.exp(np.array(logs) - top).sum()


def energy_sums(slots):
    """(3.26) with f = Λ."""
    out = np.zeros(len(slots))
    for chosen, time, pair in filled(slots):
        out[chosen] += energy(slots.network, time, pair)
    return out
