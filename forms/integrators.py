"""Time integration as a sequence of minimisation problems.

Every scheme asks for the w with

    α M (w - û) + f_int(w) + C γ (w - ũ) = f_ext

where M is the mass and C the Rayleigh damping matrix; w is the new displacement, for the midpoint rule that at the
middle of the step. Each class states α, û, γ, ũ and what follows from w. Steps may vary in length.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass
class Motion:
    """Displacement [m], velocity [m/s] and what the scheme remembers, local arrays with ghosts."""

    u: NDArray
    v: NDArray
    a: NDArray | None = None
    u_old: NDArray | None = None
    v_old: NDArray | None = None
    dt_old: float = 0.0


@dataclass(frozen=True)
class Terms:
    """α [1/s²], û [m], γ [1/s], ũ [m] of one step and the part of it after which forces are taken."""

    alpha: float
    u_hat: NDArray
    gamma: float
    u_tilde: NDArray
    stage: float = 1.0


class Scheme:
    """What the schemes have in common."""

    order = 2
    needs_acceleration = False  # that of the start; BDF2 and backward Euler do without

    def terms(self, m: Motion, dt: float) -> Terms:
        """α, û, γ, ũ of the step."""
        raise NotImplementedError

    def finish(self, m: Motion, w: NDArray, dt: float) -> Motion:
        """The motion at the end of the step."""
        raise NotImplementedError

    def error(self, m: Motion, new: Motion, dt: float) -> NDArray:
        """Local error of the displacement after a step [m], ~ dt^(order + 1): its distance to u + dt (v + v')/2."""
        return np.abs(new.u - m.u - dt / 2 * (m.v + new.v))


class BackwardEuler(Scheme):
    """v' = (u' - u)/dt, a' = (v' - v)/dt; first order, damps."""

    order = 1

    def terms(self, m: Motion, dt: float) -> Terms:
        """α = 1/dt², û = u + dt v."""
        return Terms(1 / dt**2, m.u + dt * m.v, 1 / dt, m.u)

    def finish(self, m: Motion, w: NDArray, dt: float) -> Motion:
        """The motion at the end of the step."""
        return Motion(w, (w - m.u) / dt)


class BDF2(Scheme):
    """Second-order backward differentiation with variable steps; the first step is backward Euler."""

    @staticmethod
    def _weights(m: Motion, dt: float) -> tuple[float, float, float]:
        r = dt / m.dt_old
        return (1 + 2 * r) / (1 + r), -(1 + r), r * r / (1 + r)

    def terms(self, m: Motion, dt: float) -> Terms:
        """u̇' = (c0 u' + c1 u + c2 u_old)/dt, likewise for v."""
        if m.u_old is None or m.v_old is None:
            return BackwardEuler().terms(m, dt)
        c0, c1, c2 = self._weights(m, dt)
        u_tilde = -(c1 * m.u + c2 * m.u_old) / c0
        u_hat = u_tilde - dt / c0**2 * (c1 * m.v + c2 * m.v_old)
        return Terms(c0**2 / dt**2, u_hat, c0 / dt, u_tilde)

    def finish(self, m: Motion, w: NDArray, dt: float) -> Motion:
        """The motion at the end of the step."""
        terms = self.terms(m, dt)
        return Motion(w, terms.gamma * (w - terms.u_tilde), None, m.u, m.v, dt)


class Midpoint(Scheme):
    """Implicit midpoint rule: w = (u + u')/2; second order, keeps linear and angular momentum."""

    needs_acceleration = True  # by the first error estimate

    def terms(self, m: Motion, dt: float) -> Terms:
        """α = 4/dt², û = u + dt/2 v, forces in the middle of the step."""
        return Terms(4 / dt**2, m.u + dt / 2 * m.v, 2 / dt, m.u, 0.5)

    def finish(self, m: Motion, w: NDArray, dt: float) -> Motion:
        """The motion at the end of the step."""
        u = 2 * w - m.u
        return Motion(u, 2 * (u - m.u) / dt - m.v, None, m.u, m.v, dt)

    def error(self, m: Motion, new: Motion, dt: float) -> NDArray:
        """dt³/12 |u‴|, from the mean accelerations of this step and the last one."""
        a = (new.v - m.v) / dt
        if m.v_old is not None:
            return dt**3 / 6 * np.abs(a - (m.v - m.v_old) / m.dt_old) / (dt + m.dt_old)
        return dt**2 / 6 * np.abs(a - m.a) if m.a is not None else np.zeros_like(a)


class Newmark(Scheme):
    """Trapezoidal rule (β = 1/4, γ = 1/2); second order."""

    needs_acceleration = True

    def terms(self, m: Motion, dt: float) -> Terms:
        """α = 4/dt², û = u + dt v + dt²/4 a."""
        assert m.a is not None
        return Terms(4 / dt**2, m.u + dt * m.v + dt**2 / 4 * m.a, 2 / dt, m.u + dt / 2 * m.v)

    def finish(self, m: Motion, w: NDArray, dt: float) -> Motion:
        """The motion at the end of the step."""
        assert m.a is not None
        a = 4 / dt**2 * (w - m.u - dt * m.v) - m.a
        return Motion(w, m.v + dt / 2 * (m.a + a), a)

    def error(self, m: Motion, new: Motion, dt: float) -> NDArray:
        """dt³/12 |u‴|, from the accelerations at both ends."""
        assert m.a is not None and new.a is not None
        return dt**2 / 12 * np.abs(new.a - m.a)


INTEGRATORS: dict[str, type[Scheme]] = {
    "backward_euler": BackwardEuler,
    "bdf2": BDF2,
    "midpoint": Midpoint,
    "newmark": Newmark,
}
