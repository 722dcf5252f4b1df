"""The likelihood of complete events (3.1), its derivatives in the parameters, and the sums that maximise it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from . import kernel
from .events import Events, Network

_COLUMNS = 16


@dataclass(frozen=True)
class Statistics:
    """Sums over the events of each timeline (likelihood.c), from which likelihood and derivatives follow.

    Events at equal times count in the order in which they stand, as though an instant lay between them: (2.1) taken
    to the letter would have none excite another, and data recorded by the day would lose their densest clusters. It
    is the limit of ever smaller intervals, and what (3.3) does; the order itself changes nothing on a timeline.

    Attributes
    ----------
    parameters : (3, K)
        μ, θ and ω at which the sums were made.
    duration : float
        Length T of the observation.
    sums : (16, K)
        In the order of likelihood.c.
    """

    parameters: NDArray
    duration: float
    sums: NDArray

    @classmethod
    def of(
        cls, network: Network, time: NDArray, pair: NDArray, duration: float, weight: NDArray | None = None
    ) -> Statistics:
        """One pass over events (N,) on the timelines `pair` (int32), with weights, 1 by default."""
        sums, K = np.zeros((len(network), _COLUMNS)), len(network)
        weight = np.ones(len(time)) if weight is None else weight
        kernel.call(
            "statistics", len(time), time, pair, weight, network.background, network.branching, network.decay,
            float(duration), np.full(K, -np.inf), np.zeros((K, 3)), sums, subject="likelihood",
        )  # fmt: skip
        parameters = np.stack([network.background, network.branching, network.decay])
        return cls(parameters, float(duration), np.ascontiguousarray(sums.T))

    @property
    def log_likelihood(self) -> NDArray:
        """(K,) Σ ln λ, the logarithm of (3.1)."""
        return self.sums[1]

    @property
    def compensator(self) -> NDArray:
        """(K,) ∫λ dt = μ T + θ Σ (1 - e^{-ω(T-t)}): expected number of events."""
        μ, θ, _ = self.parameters
        return μ * self.duration + θ * self.sums[5]

    @property
    def background(self) -> NDArray:
        """(K,) expected number of events that nothing triggered."""
        return self.sums[2]

    @property
    def triggered(self) -> NDArray:
        """(K,) expected number of offspring."""
        return self.sums[3]

    @property
    def delay(self) -> NDArray:
        """(K,) expected sum of the times from offspring back to their parents."""
        return self.sums[4]

    @property
    def exposure(self) -> NDArray:
        """(K,) Σ (1 - e^{-ω(T-t)}): the offspring that could be seen by the end, were θ = 1."""
        return self.sums[5]

    @property
    def unseen(self) -> NDArray:
        """(K,) Σ (T-t) e^{-ω(T-t)}."""
        return self.sums[6]

    @property
    def score(self) -> NDArray:
        """(3, K) gradient of ln L - ∫λ in ln μ, ln θ, ln ω."""
        μ, θ, ω = self.parameters
        return np.stack(
            [
                self.background - μ * self.duration,
                self.triggered - θ * self.exposure,
                self.triggered - ω * self.delay - ω * θ * self.unseen,
            ]
        )

    @property
    def curvature(self) -> NDArray:
        """(3, 3, K) second derivatives of ln L - ∫λ in ln μ, ln θ, ln ω."""
        μ, θ, ω = self.parameters
        products, (mixed, curved) = self.sums[8:14], self.sums[14:]
        out = np.empty((3, 3, len(μ)))
        for (a, b), product in zip(((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)), products):
            out[a, b] = out[b, a] = -product
        out[1, 2] += mixed - self.unseen
        out[2, 1] = out[1, 2]
        out[2, 2] += curved + θ * self.sums[7]
        out *= self.parameters[:, None] * self.parameters
        return out + np.eye(3)[:, :, None] * self.score


def log_likelihood(network: Network, events: Events, *, compensator: bool = False) -> float:
    """ln L of (3.1) for events all of whose participants are known.

    ln L = Σ_i Σ_j ln λ_i(t_j) [- Σ_i ∫λ_i dt]; -inf where an event cannot have happened: its pair is inactive or not
    of the network, or has no background and no earlier event. Ties: see `Statistics`.

    Parameters
    ----------
    compensator : bool
        Subtract the expected number of events, which (3.1) leaves out.
    """
    if events.incomplete.any():
        raise ValueError("an event is incomplete")
    pair = network.number(*events.participants.T)
    if (pair < 0).any():
        return -np.inf
    found = Statistics.of(network, events.time, pair, events.duration)
    return float(found.log_likelihood.sum() - (found.compensator.sum() if compensator else 0.0))
