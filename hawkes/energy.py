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
                later(w, whole, scratch, future)
                kernel.call(
                    "sweep", w.count, w.start, w.pair, w.decay, len(w.coupling), w.coupling, w.linear, scratch,
                    future, whole,
                )  # fmt: skip
        return s.scatter(whole)

    def gap(self, x: NDArray, g: NDArray | None = None) -> float:
        """Upper bound of Λ* - Λ(x) for x with columns of unit length: the smaller of two.

        First order: Λ is concave in y = x² (theorem 3.3.1) with gradient g/(2x), and the maximum of a linear function
        over a simplex is at a corner,
            Λ* - Λ <= Σ_j [max_i g_ij/(2 x_ij) - g_j·x_j/2].
        Where x and g are 0, √(y_j y_l) <= (y_j + y_l)/2 bounds what such slots of a timeline can do to each other.
        Second order: with ν_j = x_j·g_j/2, e = g/2 - ν x and N = diag(ν) - A,
            Λ(x + d) - Λ(x) = 2 e·d - dᵀN d,   N x = h = b/2 - e,
        and N has no positive entry off its diagonal, so that h > 0 gives dᵀN d >= Σ h d²/x and
            Λ* - Λ <= Σ x e²/h.
        """
        s = self.slots
        g = self.gradient(x) if g is None else g
        along = s.columns(x, g)
        first = 0.5 * float((self._steepest(x, g) - along).sum())

        ν = s.spread(0.5 * along)
        e = 0.5 * g - ν * x
        h = 0.5 * s.linear - e
        alone = (x == 0) & (s.coupling[s.pair] == 0)  # N's row is ν alone
        good = bool(((h > 0) & (x > 0) | alone & (ν > 0) | (alone & (e == 0))).all())
        second = np.inf
        if s.comm.allreduce(good, op=MPI.LAND):
            with np.errstate(divide="ignore", invalid="ignore"):
                terms = np.where(alone, e**2 / ν, x * e**2 / h)
            second = s.sum(terms[e != 0])
        return max(0.0, min(first, second))

    def _steepest(self, x: NDArray, g: NDArray) -> NDArray:
        """(n,) largest g/x of each event."""
        s, most = self.slots, np.empty(self.slots.count)
        idle = (x == 0) & (g == 0)
        if s.comm.allreduce(bool(idle.any()), op=MPI.LOR):
            g, x = np.where(idle, self.couple(idle.astype(float)), g), np.where(idle, 1.0, x)
        kernel.call("ratio", s.count, s.start, g, x, most)
        if s.comm.size > 1:
            s.comm.Allreduce(MPI.IN_PLACE, most, op=MPI.MAX)
        return most


def later(slots: Slots, x: NDArray, scratch: NDArray, future: NDArray) -> None:
    """Put into `future` (S,) what later slots of a slot's timeline add up to, Σ x e^(-ω Δt); `scratch` (K,) is lost.

    Not collective.
    """
    kernel.call("later", len(slots), slots.pair, slots.decay, len(slots.coupling), x, scratch, future)
