"""Method (3.4): each event's intensity relative to that of all pairs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from petsc4py import PETSc

from extremal.native.options import defaults

from .reconstruct import PREFIX
from .slots import Slots

DEFAULTS = {"tao_type": "blmvm", "tao_max_it": 500, "tao_gatol": 1e-8, "tao_grtol": 1e-8, "tao_gttol": 0}


@dataclass(frozen=True)
class Normalised:
    """Weights (S,) of this rank's slots, the functional (3.4), and TAO's iterations and reason."""

    weights: NDArray
    value: float
    iterations: int
    reason: int


def normalised(slots: Slots, start: NDArray | None = None) -> Normalised:
    """A stationary point of (3.4) with weights of unit length (collective; rank 0 computes).

    The functional is not concave: which of its maxima is found depends on `start`. An evaluation costs every pair at
    every event, so this is for small problems, to see what section 3.2 says of (3.4).

    Parameters
    ----------
    slots : Slots
        Made with `complete=True`.
    start : (S,), optional
        Equal weights otherwise.
    """
    weights = slots.gather(slots.uniform() if start is None else start)
    figures = None
    if weights is not None:
        weights, *figures = _maximise(Functional(slots.whole), weights)
    value, iterations, reason = slots.comm.bcast(figures)
    return Normalised(slots.scatter(weights), value, iterations, reason)


class Functional:
    """(3.4) with weights: Σ_e Σ_i x_ie λ_i(t_e) / Σ_i' λ_i'(t_e), λ_i fed by the weights of earlier events.

    Parameters
    ----------
    slots : Slots
        All slots, complete events included, on one rank.
    """

    def __init__(self, slots: Slots) -> None:
        self.slots = slots
        network = slots.network
        time = slots.events.time[slots.event]
        step = np.diff(time, prepend=time[:1])
        self._decay = np.exp(-network.decay * step[:, None])  # (n, K)
        self._decay[0] = 0
        self._coupling = network.branching * network.decay
        self._background = network.background

    def value(self, x: NDArray) -> tuple[float, NDArray]:
        """The functional and its gradient (S,) at weights x (S,)."""
        s = self.slots
        weight = np.zeros(self._decay.shape)
        weight[s.column, s.pair] = x
        past = np.zeros_like(weight)
        for e in range(1, len(weight)):
            past[e] = self._decay[e] * (past[e - 1] + weight[e - 1])
        intensity = self._background + self._coupling * past
        total = intensity.sum(axis=1)
        share = np.divide(intensity, total[:, None], out=np.zeros_like(intensity), where=total[:, None] > 0)
        each = (weight * share).sum(axis=1)
        # what a weight does to later events: d(x·λ/Λ)/dλ = x/Λ - (x·λ)/Λ²
        inverse = np.divide(1, total, out=np.zeros_like(total), where=total > 0)[:, None]
        pull = (weight - each[:, None]) * inverse
        future = np.zeros(weight.shape[1])
        slope = share
        for e in range(len(weight) - 1, -1, -1):
            slope[e] += self._coupling * future
            future = self._decay[e] * (future + pull[e])
        return float(each.sum()), slope[s.column, s.pair]


def _maximise(functional: Functional, x: NDArray) -> tuple[NDArray, float, int, int]:
    s = functional.slots

    def unit(z: NDArray) -> tuple[NDArray, NDArray]:
        size = s.spread(np.sqrt(s.columns(z, z)))
        size[size == 0] = 1
        return z / size, size

    def evaluate(tao: PETSc.TAO, z: PETSc.Vec, out: PETSc.Vec) -> float:
        point, size = unit(z.array_r)
        value, g = functional.value(point)
        out.array[:] = -(g - point * s.spread(s.columns(point, g))) / size
        return -value

    vectors = [PETSc.Vec().createSeq(len(s), comm=PETSc.COMM_SELF) for _ in range(4)]
    z, gradient, low, high = vectors
    high.set(PETSc.INFINITY)
    z.array[:] = x
    tao = PETSc.TAO().create(PETSc.COMM_SELF)
    tao.setOptionsPrefix(PREFIX)
    tao.setObjectiveGradient(evaluate, gradient)
    tao.setVariableBounds((low, high))
    tao.setSolution(z)
    with defaults(PREFIX, DEFAULTS):
        tao.setFromOptions()
    tao.solve()
    weights, _ = unit(z.array_r.copy())
    figures = functional.value(weights)[0], tao.getIterationNumber(), int(tao.getConvergedReason())
    for used in (tao, *vectors):
        used.destroy()
    return weights, *figures
