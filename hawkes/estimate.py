"""Parameters from events of which some are incomplete: the question that chapter 4 of the source leaves open."""

from __future__ import annotations

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

from .enumeration import with_floor
from .events import DataError, Events, Network
from .gibbs import annealing, samplers, sum_of_chains
from .likelihood import Statistics
from .meanfield import mean_field
from .simulate import Seed
from .slots import Slots

METHODS = ("stochastic", "soft", "complete")
_SWEEPS = 2  # of Gibbs sampling, or of the mean field, in a round
_PASSES = 5  # maximisations in a round; before each, branching is shared out anew
_LEAST = 1e-200  # an active pair stays active
# what a maximisation needs of Statistics
_SUMS = ("background", "triggered", "delay", "exposure", "unseen")


class Estimation:
    """Estimates of μ, θ and ω by rounds of guessing who took part and maximising the likelihood.

    Methods:

    stochastic
        Stochastic EM: participants are sampled from their posterior, by two sweeps of Gibbs sampling in each of the
        chains, and the parameters maximise the likelihood of the events thus completed; the estimate is the mean over
        the later half of the rounds. Reconstruction is part of it, and the bias of the others absent.
    soft
        Plain EM: incomplete events are spread over their candidates by the mean-field probabilities. Biased: spread
        events look like background and blur the clusters.
    complete
        Incomplete events are left out. Biased: offspring and background are missing.

    Parameters per pair are the most likely a posteriori, see `maximum`.
    """

    def __init__(
        self,
        comm: MPI.Comm,
        network: Network,
        events: Events,
        *,
        method: str = "stochastic",
        per_pair: bool = False,
        strength: float = 5.0,
        chains: int = 4,
        seed: Seed = 0,
    ) -> None:
        """
        Parameters
        ----------
        comm : mpi4py.MPI.Comm
            Ranks share the chains; the same answer on any number of them.
        network : Network
            Its parameters are where to start (`rough_guess` makes some). Inactive pairs stay so.
        events : Events
        method : {"stochastic", "soft", "complete"}
        per_pair : bool
            Parameters of each pair, rather than the same for all.
        strength : float
            Weight of the prior of parameters per pair, in events.
        chains : int
            Independent samples of the participants in each round.
        seed : int or numpy.random.SeedSequence

        Raises
        ------
        DataError
            If there is nothing to estimate from.
        """
        if method not in METHODS:
            raise ValueError(f"method {method!r}: must be one of {', '.join(METHODS)}")
        if method == "complete":
            whole, chains = ~events.incomplete, 1
            events = Events(events.time[whole], events.participants[whole], events.duration)
        self.comm, self.method, self.per_pair, self.strength, self.chains = comm, method, per_pair, strength, chains
        self._start, self._active = network, network.active
        self._rounds: list[NDArray] = []
        self._values = np.stack([network.background, network.branching, network.decay])[:, self._active]
        self._slots = Slots.build(comm, network, events, complete=method == "soft")
        if method == "soft":
            self._q: NDArray | None = None
        else:
            self._samplers = samplers(self._slots, chains, seed)
            self._unused = np.zeros(len(self._slots.whole))
        pair = network.number(*events.participants[~events.incomplete].T)
        if not (self._slots.count or network.active[pair[pair >= 0]].any()) or events.duration <= 0:
            raise DataError("there are no events, or no time, to estimate parameters from")

    def step(self) -> None:
        """One round (collective)."""
        network = with_floor(self._with(self._values))
        if self.method == "soft":
            self._slots = Slots.build(self.comm, network, self._slots.events, complete=True)
            self._q = mean_field(self._slots, sweeps=_SWEEPS, start=self._q)
        else:
            powers = np.ones(_SWEEPS) if self._rounds else annealing(10 * _SWEEPS)
            for sampler in self._samplers.values():
                for power in powers:
                    sampler.sweep(network, self._unused, power)
        for _ in range(_PASSES):
            sums = self._sums(self._with(self._values))
            strength = self.strength if self.per_pair else np.inf
            self._values = maximum(sums, self._slots.events.duration, self._values, strength)
        self._rounds.append(self._values if self.per_pair else self._values[:, :1])

    @property
    def rounds(self) -> int:
        return len(self._rounds)

    @property
    def history(self) -> NDArray:
        """(rounds, 3) μ, θ, ω after each round, their means over active pairs."""
        return np.array([row.mean(axis=1) for row in self._rounds]).reshape(-1, 3)

    @property
    def drift(self) -> float:
        """Largest relative change of a mean parameter from the third to the last quarter of the rounds."""
        quarter = self.rounds // 4
        if not quarter:
            return np.inf
        last = np.log(np.maximum(self.history[-2 * quarter :], _LEAST))
        return float(np.abs(last[quarter:].mean(axis=0) - last[:quarter].mean(axis=0)).max())

    @property
    def network(self) -> Network:
        """The pairs with the estimates: of the method `stochastic`, means over the later half of the rounds."""
        if not self._rounds:
            return self._start
        later = self._rounds[self.rounds // 2 :] if self.method == "stochastic" else self._rounds[-1:]
        return self._with(np.mean(later, axis=0))

    @property
    def supercritical(self) -> NDArray:
        """Pairs whose estimated θ is 1 or more: such a process grows without bound, and nothing else does for long."""
        return np.flatnonzero(self.network.branching >= 1)

    def state(self) -> dict[str, NDArray]:
        """What `restore` needs, of a method that samples and has made a round; on rank 0 (collective)."""
        if not self._rounds:
            return {}
        mine = {c: sampler.state() for c, sampler in self._samplers.items()}
        everyone = self._slots.comm.gather(mine) or []
        chains = {c: parts for some in everyone for c, parts in some.items()}
        found = [np.stack([chains[c][k] for c in sorted(chains)]) if chains else np.zeros(0) for k in (0, 1)]
        return {"pair": found[0], "random": found[1], "rounds": np.array(self._rounds), "values": self._values}

    def restore(self, state: dict[str, NDArray]) -> None:
        """Go on from what `state` gave, on any number of ranks; the same on all of them."""
        if state:
            self._rounds, self._values = list(state["rounds"]), state["values"]
            for c, sampler in self._samplers.items():
                sampler.restore(state["pair"][c], state["random"][c])

    def standard_errors(self, samples: int = 50) -> dict[str, NDArray]:
        """Standard errors of `background`, `branching` and `decay` of each pair (K,), 0 if inactive (collective).

        From the observed information of the incomplete data, by Louis' identity
            I = E[-∇²ℓ] - Var[∇ℓ],
        ℓ the log-likelihood with all participants known, mean and variance over their posterior at the estimates
        (`samples` sweeps of each chain), in the logarithms of the parameters. The spread between rounds would be no
        substitute: it is what sampling adds, not what the data leave open. A pair's own 3 x 3 information is
        inverted; what events that could be of either tie together between pairs is neglected, of the order of
        1/candidates. inf where the data leave a parameter open.

        Raises
        ------
        ValueError
            For the method `soft`, which does not maximise a likelihood.
        """
        if self.method == "soft":
            raise ValueError("soft EM has no standard errors")
        network, sums = self.network, {}
        for c, sampler in self._samplers.items():
            sums[c] = np.zeros(())
            for _ in range(samples):
                sampler.sweep(with_floor(network), self._unused)
                found = self._statistics(sampler.pair, network)
                score, curvature = self._grouped(found.score), self._grouped(found.curvature)
                moments = np.concatenate([-curvature, score[:, None] * score, score[None]])
                sums[c] = sums[c] + moments / (samples * self.chains)
        total = sum_of_chains(self.comm, sums)
        information = total[:3] - (total[3:6] - total[6][:, None] * total[6])
        values = np.stack([network.background, network.branching, network.decay])[:, self._active]
        if self.per_pair:
            mean = values.mean(axis=1, keepdims=True)
            information += np.eye(3)[:, :, None] * (self.strength * values / np.maximum(mean, _LEAST))[:, None]
        errors = np.stack([_deviations(information[..., g]) for g in range(information.shape[2])], axis=1)
        out = np.zeros((3, len(network)))
        out[:, self._active] = errors * values
        return dict(zip(("background", "branching", "decay"), out))

    def _with(self, values: NDArray) -> Network:
        rows = np.stack([self._start.background, self._start.branching, self._start.decay])
        rows[:, self._active] = np.maximum(values, _LEAST)
        return self._start.with_parameters(*rows)

    def _grouped(self, values: NDArray) -> NDArray:
        active = values[..., self._active]
        return active if self.per_pair else active.sum(axis=-1, keepdims=True)

    def _statistics(self, pair: NDArray, network: Network) -> Statistics:
        events, there = self._slots.events, pair >= 0
        return Statistics.of(network, events.time[there], pair[there], events.duration)

    def _sums(self, network: Network) -> NDArray:
        """(5, active) sums over the events, the mean of all chains (collective)."""
        if self.method == "soft":
            s = self._slots
            time, pair = s.events.time[s.event][s.column], s.pair + np.int32(s.first_pair)
            found = {s.comm.rank: Statistics.of(network, time, pair, s.events.duration, self._q)}
        else:
            found = {c: self._statistics(sampler.pair, network) for c, sampler in self._samplers.items()}
        stacked = {c: np.stack([getattr(one, name) for name in _SUMS]) for c, one in found.items()}
        total = sum_of_chains(self.comm, stacked)[:, self._active]
        return total if self.method == "soft" else total / self.chains


def maximum(sums: NDArray, duration: float, old: NDArray, strength: float) -> NDArray:
    """Parameters (3, K) that maximise the expected likelihood of events whose branching has been shared out.

    With p = 1 - μ/λ the probability that an event is an offspring, Δt the time since its parent and τ = T - t,
        μ = Σ (1 - p) / T,   θ = Σ p / Σ (1 - e^{-ωτ}),   ω = Σ p / (Σ p Δt + θ Σ τ e^{-ωτ}).
    First all pairs together. Each pair then has the maximum a posteriori, in the logarithm of each parameter, under a
    Gamma prior whose mean is the common value and whose shape is `strength`: as if that many more events, of
    the common kind, had been seen of the pair. inf: all pairs have the common values.

    Parameters
    ----------
    sums : (5, K)
        Σ (1 - p), Σ p, Σ p Δt, Σ (1 - e^{-ωτ}), Σ τ e^{-ωτ} of each pair.
    duration : float
        T.
    old : (3, K)
        The parameters before, kept where the sums determine nothing.
    strength : float
    """
    before = old.mean(axis=1)
    total, K = sums.sum(axis=1), sums.shape[1]
    μ = total[0] / (duration * K)
    θ = total[1] / total[3] if total[3] > 0 else before[1]
    late = total[2] + θ * total[4]
    ω = total[1] / late if late > 0 and total[1] > 0 else before[2]
    if np.isinf(strength):
        return np.repeat([[μ], [θ], [ω]], K, axis=1)

    def shrunk(count: NDArray, measure: NDArray | float, common: float, kept: NDArray) -> NDArray:
        below = common * measure + strength
        return np.where(below > 0, common * (count + strength) / np.where(below > 0, below, 1), kept)

    branching = shrunk(sums[1], sums[3], θ, old[1])
    return np.stack([
        shrunk(sums[0], duration, μ, old[0]), branching, shrunk(sums[1], sums[2] + branching * sums[4], ω, old[2])
    ])  # fmt: skip


def rough_guess(network: Network, events: Events) -> Network:
    """Shared parameters to start an estimation with: half of the events background, and ω from the typical gap."""
    active = max(int(network.active.sum()), 1)
    N, T = max(len(events), 1), events.duration if events.duration > 0 else 1.0
    pair, time = network.number(*events.participants[~events.incomplete].T), events.time[~events.incomplete]
    order = np.argsort(pair, kind="stable")
    gaps = np.diff(time[order])[(np.diff(pair[order]) == 0) & (pair[order][1:] >= 0)]
    gaps = gaps[gaps > 0]
    typical = float(np.median(gaps)) if len(gaps) else T * active / N
    rows = [np.where(network.active, v, old) for v, old in (
        (N / (2 * active * T), network.background), (0.5, network.branching), (1 / typical, network.decay)
    )]  # fmt: skip
    return network.with_parameters(*rows)


def _deviations(information: NDArray) -> NDArray:
    """Square roots of the diagonal of the inverse, inf if that is no covariance."""
    try:
        np.linalg.cholesky(information)
    except np.linalg.LinAlgError:
        return np.full(len(information), np.inf)
    return np.sqrt(np.diag(np.linalg.inv(information)))
