"""The energy of (3.5) in the weights of all slots, its derivatives, and how far from its maximum a point can be."""

from __future__ import annotations

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

from . import kernel
from .slots import Slots


class Energy:
    """Λ(x) = Σ_i r_iᵀ A_i r_i + r_iᵀ b_i of (3.20), up to the constant that complete events give.

    Every method is collective; arrays (S,) are over this rank's slots.
    """

    def __init__(self, slots: Slots) -> None:
        self.slots = slots
        self._scratch = np.empty(len(slots.coupling))

    def couple(self, x: NDArray) -> NDArray:
        """2 A x, shape (S,)."""
        s, out = self.slots, np.empty(len(self.slots))
        kernel.call("couple", len(s), s.pair, s.decay, len(s.coupling), s.coupling, x, self._scratch, out)
        return out

    def gradient(self, x: NDArray) -> NDArray:
        """g = b + 2 A x, shape (S,)."""
        return self.slots.linear + self.couple(x)

    def value(self, x: NDArray, g: NDArray | None = None) -> float:
        """Λ(x) = Σ x (b + g) / 2; `g`, if known, is the gradient at x."""
        g = self.gradient(x) if g is None else g
        return 0.5 * self.slots.sum(x * (self.slots.linear + g))

    def sweep(self, x: NDArray, times: int = 1) -> NDArray:
        """x after `times` rounds of maximising over one event after another; Λ never falls.

        A round goes through the events in their order, so rank 0 makes it for all.
        """
        s = self.slots
        whole = s.gather(x)
        if whole is not None:
            w = s.whole
            scratch, future = np.empty(len(w.coupling)), np.empty(len(w))
            for _ in range(times):
                kernel.call(
                    "sweep", w.count, w.start, w.pair, w.decay, len(w.coupling), w.coupling, w.linear, scratch,
                    future, whole,
                )  # fmt: skip
        return s.scatter(whole)

    def gap(self, x: NDArray, g: NDArray | None = None) -> float:
        """Upper bound of Λ* - Λ(x) for x with columns of unit length: the smaller of two.

        Both follow from the concavity of Λ in y = x² (theorem 3.3.1). First order: the gradient in y is g/(2x), and
        the maximum of a linear function over a simplex is at a corner,
            Λ* - Λ <= Σ_j [max_i g_ij/(2 x_ij) - g_j·x_j/2].
        Second order: with ν_j = x_j·g_j/2, e = g/2 - ν x, h = b/2 - e, where all h > 0,
            Λ* - Λ <= Σ_i (max_j |e_ij|/h_ij) Σ_j x_ij |e_ij|.
        """
        s = self.slots
        g = self.gradient(x) if g is None else g
        along = s.columns(x, g)
        steepest = np.empty(s.count)
        kernel.call("ratio", s.count, s.start, g, x, steepest)
        if s.comm.size > 1:
            s.comm.Allreduce(MPI.IN_PLACE, steepest, op=MPI.MAX)
        first = 0.5 * float((steepest - along).sum())

        e = 0.5 * (g - np.repeat(along, np.diff(s.start)) * x)
        h = 0.5 * s.linear - e
        size = np.abs(e)
        used = size > 0
        good = bool((h[used] > 0).all())
        second = 0.0
        if good and used.any():
            worst = np.zeros(len(s.coupling))
            np.maximum.at(worst, s.pair[used], size[used] / h[used])
            second = float(worst @ np.bincount(s.pair, weights=x * size, minlength=len(worst)))
        second = s.comm.allreduce(second)
        if not s.comm.allreduce(good, op=MPI.LAND):
            second = np.inf
        return max(0.0, min(first, second))
