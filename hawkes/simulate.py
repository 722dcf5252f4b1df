"""Synthetic data: events of a network of Hawkes processes, and the removal of what would not be known of them."""

from __future__ import annotations

import zlib
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from . import kernel
from .events import UNKNOWN, DataError, Events, Network

Seed: TypeAlias = "int | np.random.SeedSequence"
LIMIT = 20_000_000  # events of one simulation
_BLOCK = 1 << 16  # events between two supplies of random numbers


def stream(seed: Seed, purpose: str) -> np.random.Generator:
    """Random numbers of their own for each purpose, so that one seed may serve for all; the same on every machine."""
    whole = seed if isinstance(seed, np.random.SeedSequence) else np.random.SeedSequence(seed)
    key = (*whole.spawn_key, zlib.crc32(purpose.encode()))
    return np.random.Generator(np.random.Philox(np.random.SeedSequence(whole.entropy, spawn_key=key)))


def simulate(
    network: Network, *, count: int | None = None, duration: float | None = None, seed: Seed, limit: int = LIMIT
) -> Events:
    """Events of all pairs together from an empty history, exactly distributed as (2.3) says.

    Parameters
    ----------
    network : Network
    count : int, optional
        Stop at this many events; the observation ends with the last of them, T = t_N.
    duration : float, optional
        Instead: all events until this time [unit of time].
    seed : int or numpy.random.SeedSequence
        The same seed gives the same events on every rank; fewer of them are the first of more.
    limit : int
        Largest number of events. With θ >= 1 their number grows exponentially with the duration.

    Raises
    ------
    DataError
        If there would be more events than `limit`, or never as many as `count`.
    """
    if (count is None) == (duration is None):
        raise ValueError("either count or duration")
    if duration is not None and not 0 <= duration < np.inf:
        raise DataError(f"duration of the simulation is {duration:g}: must be finite, 0 or more")
    if count is not None and not 0 <= count <= limit:
        raise DataError(f"{count} events asked for: must be from 0 to {limit}")
    wanted, end = limit + 1 if count is None else count, np.inf if duration is None else float(duration)
    times, pairs = _run(network, wanted, end, stream(seed, "simulate"))
    if count is not None and len(times) < count:
        raise DataError(f"{count} events asked for, but no pair has a background rate above 0: there are none")
    if len(times) > limit:
        explosive = f" (branching reaches {network.branching.max():g})" if network.branching.max() >= 1 else ""
        raise DataError(f"more than {limit} events until {duration:g}{explosive}: choose a shorter duration")
    last = float(times[-1]) if len(times) else 0.0
    return Events(times, network.pairs[pairs], last if duration is None else end)


def _run(network: Network, wanted: int, end: float, random: np.random.Generator) -> tuple[NDArray, NDArray]:
    background = network.background
    wait = random.standard_exponential(len(network))
    first = np.full(len(network), np.inf)
    np.divide(wait, background, out=first, where=background > 0)
    who = np.argsort(first, kind="stable").astype(np.int32)  # a sorted row is a heap
    when, excess = first[who], np.zeros(len(network))
    jump, made = network.branching * network.decay, np.zeros(1, dtype=np.int64)
    times, pairs = [np.empty(0)], [np.empty(0, dtype=np.int32)]
    while wanted > 0:
        size = min(wanted, _BLOCK)
        draws, time, pair = random.standard_exponential(2 * size), np.empty(size), np.empty(size, dtype=np.int32)
        kernel.call(
            "simulate", len(network), background, jump, network.decay, end, size, draws, when, who, excess, time,
            pair, made, subject="simulate",
        )  # fmt: skip
        n = int(made[0])
        times.append(time[:n])
        pairs.append(pair[:n])
        wanted -= n
        if n < size:
            break
    return np.concatenate(times), np.concatenate(pairs)


def hide(events: Events, count: int, *, mode: str = "one", seed: Seed) -> Events:
    """Events of which `count`, chosen uniformly without replacement, have become incomplete.

    Parameters
    ----------
    events : Events
        Those that are incomplete already stay so and are not chosen.
    mode : {"one", "both"}
        One of the two participants, by the toss of a coin, becomes unknown, or both.

    Raises
    ------
    DataError
        If there are fewer complete events.
    """
    if mode not in ("one", "both"):
        raise ValueError(f"mode {mode!r}: must be one or both")
    complete = np.flatnonzero(~events.incomplete)
    if not 0 <= count <= len(complete):
        raise DataError(f"{count} events to become incomplete: must be from 0 to {len(complete)}, the complete ones")
    random = stream(seed, "hide")
    chosen = np.sort(random.choice(complete, count, replace=False))
    people = events.participants.copy()
    if mode == "both":
        people[chosen] = UNKNOWN
    else:
        people[chosen, random.integers(0, 2, count)] = UNKNOWN
    return Events(events.time, people, events.duration)


def under_report(events: Events, share: float, *, seed: Seed) -> Events:
    """Events less those that are never reported: each is lost with probability `share`, whatever the others do.

    Raises
    ------
    DataError
        If `share` is not from 0 to 1.
    """
    if not 0 <= share <= 1:
        raise DataError(f"share of unreported events is {share:g}: must be from 0 to 1")
    kept = stream(seed, "under_report").random(len(events)) >= share
    return Events(events.time[kept], events.participants[kept], events.duration)
