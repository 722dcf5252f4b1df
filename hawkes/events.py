"""What is known: a network of pairs of agents with the parameters of their processes, and a list of events."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

UNKNOWN = -1


class DataError(ValueError):
    """Network or events cannot be used; the message is one line for the user."""


@dataclass(frozen=True)
class Network:
    """Pairs of agents that interact, each by a Hawkes process of its own (2.3).

    Attributes
    ----------
    agents : tuple of str
        Names.
    pairs : (K, 2) int32
        Agents of each pair, the smaller number first; no pair twice.
    background : (K,)
        μ, the rate of events that nothing triggers [1/unit of time].
    branching : (K,)
        θ, the mean number of direct offspring of an event.
    decay : (K,)
        ω [1/unit of time]: offspring follow after 1/ω in the mean.
    """

    agents: tuple[str, ...]
    pairs: NDArray
    background: NDArray
    branching: NDArray
    decay: NDArray

    def __post_init__(self) -> None:
        pairs = np.ascontiguousarray(self.pairs, dtype=np.int32).reshape(-1, 2)
        object.__setattr__(self, "pairs", pairs)
        if not len(pairs):
            raise DataError("the network has no pair")
        if (pairs[:, 0] >= pairs[:, 1]).any() or (pairs < 0).any() or (pairs >= len(self.agents)).any():
            raise DataError("a pair must be two agents of the network, the smaller number first")
        if len(np.unique(pairs, axis=0)) != len(pairs):
            raise DataError("a pair is given twice")
        for name, accepted in (("background", "0 or more"), ("branching", "0 or more"), ("decay", "above 0")):
            values = np.ascontiguousarray(np.broadcast_to(getattr(self, name), len(pairs)), dtype=float)
            object.__setattr__(self, name, values)
            bad = ~np.isfinite(values) | (values < 0) | ((values == 0) & (name == "decay"))
            if bad.any():
                k = int(np.flatnonzero(bad)[0])
                raise DataError(f"{name} of {self.name(k)} is {values[k]:g}: must be {accepted}")

    @classmethod
    def complete(cls, agents: int | tuple[str, ...], background: float, branching: float, decay: float) -> Network:
        """Every pair of the agents, all with the same parameters."""
        names = tuple(str(k + 1) for k in range(agents)) if isinstance(agents, int) else agents
        pairs = np.column_stack(np.triu_indices(len(names), 1))
        same = (np.full(len(pairs), float(value)) for value in (background, branching, decay))
        return cls(names, pairs, *same)

    def __len__(self) -> int:
        return len(self.pairs)

    def name(self, pair: int) -> str:
        """Names of a pair's agents."""
        first, second = self.pairs[pair]
        return f"{self.agents[first]} - {self.agents[second]}"

    @property
    def active(self) -> NDArray:
        """(K,) bool: pairs that can have an event at all (section 3.3: the others are left out)."""
        return (self.background > 0) | (self.branching > 0)

    def number(self, first: NDArray, second: NDArray) -> NDArray:
        """The pair of two agents, -1 where they are no pair; arrays of equal shape, in any order of the two."""
        key = self.pairs[:, 0].astype(np.int64) * len(self.agents) + self.pairs[:, 1]
        order = np.argsort(key)
        low, high = np.minimum(first, second).astype(np.int64), np.maximum(first, second)
        wanted = low * len(self.agents) + high
        at = np.minimum(np.searchsorted(key[order], wanted), len(key) - 1)
        found = (key[order][at] == wanted) & (low >= 0)
        return np.where(found, order[at], -1).astype(np.int32)

    def with_parameters(self, background: NDArray, branching: NDArray, decay: NDArray) -> Network:
        """The same pairs with other parameters."""
        return replace(self, background=background, branching=branching, decay=decay)


@dataclass(frozen=True)
class Events:
    """Events in the order of time.

    Attributes
    ----------
    time : (N,)
        Since the beginning of the observation.
    participants : (N, 2) int32
        Agents, UNKNOWN where one is missing.
    duration : float
        Length T of the observation; no event is later.
    """

    time: NDArray
    participants: NDArray
    duration: float

    def __post_init__(self) -> None:
        time = np.ascontiguousarray(self.time, dtype=float)
        object.__setattr__(self, "time", time)
        object.__setattr__(self, "participants", np.ascontiguousarray(self.participants, np.int32).reshape(-1, 2))
        if len(self.participants) != len(time):
            raise DataError(f"{len(time)} times, but {len(self.participants)} pairs of participants")
        if not np.isfinite(time).all() or not np.isfinite(self.duration):
            raise DataError("times must be finite")
        if len(time) and (time[0] < 0 or (np.diff(time) < 0).any() or time[-1] > self.duration):
            raise DataError("times must not decrease, from 0 to the duration of the observation")

    def __len__(self) -> int:
        return len(self.time)

    @property
    def incomplete(self) -> NDArray:
        """(N,) bool: events of which a participant is missing."""
        return (self.participants == UNKNOWN).any(axis=1)
