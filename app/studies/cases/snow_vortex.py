"""The generalised vortex: a Neo-Hookean ring of which each circle turns by an angle of its own, held by a body force.

Kamojjala, Brannon, Sadeghirad and Guilkey, "Verification tests in solid mechanics", Engineering with Computers 31
(2015). A point (R, Θ) of the ring 3/4 < R < 5/4 moves to (R, Θ + α), α(R, t) = g(t) h(R), h = 1 - 32 s² + 256 s⁴,
s = R - 1, g = A sin(πt/T): no circle changes its radius, the edges neither turn nor shear. In the polar basis of the
present place F is a rotation times 1 + γ e_θ⊗e_r, γ = R g h', so that J = 1 and, with P = μ(F - F^-T) + λ ln J F^-T,

    σ = P Fᵀ/J = μ (γ (e_r⊗e_θ + e_θ⊗e_r) + γ² e_θ⊗e_θ)
    div σ = μ (-γ²/r e_r + (γ' + 2γ/r) e_θ)
    a = -R (ġ h)² e_r + R g̈ h e_θ

and the force per mass is b = a - div σ/ρ. Particles get dt b(X, t) before each step: the grid then has it as it has
forces of the step's beginning, of first order as the step itself.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from . import _snow

if TYPE_CHECKING:
    from mpi4py import MPI
    from numpy.typing import NDArray

KEYS: dict[str, Any] = {
    **_snow.KEYS,
    "time_step": 1e-3,
    "amplitude": 0.1,  # A [rad]
    "end": 0.5,  # over T: there all circles are turned most
}
STIFF, POISSON, DENSITY, PERIOD = 1e3, 0.3, 1e3, 1.0  # Pa, 1, kg/m³, s
MU = STIFF / (2 * (1 + POISSON))
INNER, OUTER = 0.75, 1.25  # m


def run(settings: dict[str, Any], comm: MPI.Comm) -> dict[str, Any]:
    """Error of the displacement over all particles and times, relative to the exact one (collective)."""
    from extremal.mpm.law import Law
    from extremal.mpm.problem import SnowProblem

    law, A, dt = Law("neo_hookean", STIFF, POISSON, DENSITY), settings["amplitude"], settings["time_step"]
    made, start = _snow.particles(_Ring(), settings, law, lambda X: velocity(X, 0.0, A), comm)
    keys = ("cell_size", "spline", "beta", "flip", "precision")
    problem = SnowProblem(comm, made, [law], **{key: settings[key] for key in keys})
    away = _snow.Difference(problem, start, lambda X, t: place(X, t, A) - X)

    def push(t: float) -> None:
        p = problem.particles
        p.velocity += dt * force(start[p.ident], t, A)

    steps = max(1, round(settings["end"] * PERIOD / dt))
    told = _snow.walk(problem, settings, steps, push=push, look=away)
    return {**told, "error": away.relative(comm)}


class _Ring:
    def bounds(self) -> tuple[NDArray, NDArray]:
        corner = np.full(2, OUTER)
        return -corner, corner

    def inside(self, x: NDArray) -> NDArray:
        R = np.hypot(*x.T)
        return (INNER < R) & (R < OUTER)


def place(X: NDArray, t: float, A: float) -> NDArray:
    """x(X, t) [m], shape (n, 2)."""
    R, _, along, across = _polar(X, t, A)
    return R * along


def velocity(X: NDArray, t: float, A: float) -> NDArray:
    """∂x/∂t [m/s], shape (n, 2)."""
    R, h, along, across = _polar(X, t, A)
    w = np.pi / PERIOD
    return R * A * w * np.cos(w * t) * h[0] * across


def force(X: NDArray, t: float, A: float) -> NDArray:
    """b(X, t) per mass [m/s²], shape (n, 2)."""
    R, (h, slope, bend), along, across = _polar(X, t, A)
    w = np.pi / PERIOD
    g, rate, change = A * np.sin(w * t), A * w * np.cos(w * t), -A * w**2 * np.sin(w * t)
    γ, γ_r = R * g * slope, g * (slope + R * bend)
    radial = -R * (rate * h) ** 2 + MU / DENSITY * γ**2 / R
    turning = R * change * h - MU / DENSITY * (γ_r + 2 * γ / R)
    return radial * along + turning * across


def _polar(X: NDArray, t: float, A: float) -> tuple[NDArray, tuple[NDArray, NDArray, NDArray], NDArray, NDArray]:
    """R (n, 1), h with its derivatives, e_r and e_θ (n, 2) at the present place."""
    R = np.hypot(*X.T)[:, None]
    s = R - (INNER + OUTER) / 2
    h = 1 - 32 * s**2 + 256 * s**4, -64 * s + 1024 * s**3, -64 + 3072 * s**2
    angle = np.arctan2(X[:, 1:], X[:, :1]) + A * np.sin(np.pi * t / PERIOD) * h[0]
    along = np.hstack([np.cos(angle), np.sin(angle)])
    return R, h, along, along[:, ::-1] * [-1, 1]
