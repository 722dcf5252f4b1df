"""A free elastic bar in the plane, struck by the velocity of its first longitudinal mode, against the exact vibration.

With ν = 0 the bar is one-dimensional: u(X, t) = v0/ω sin(ωt) cos(πX/L), ω = π c/L, c = sqrt(E/ρ). The strain is 3e-5,
so that the bar is linear and no particle changes its cell: what is left are the errors of grid, particles and steps.
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
    "periods": 1.0,  # until the end
    "norm": "displacement",  # of the error: "displacement", over all particles and times, or "frequency"
}
STIFF, DENSITY, LENGTH, WIDTH = 1e4, 100.0, 1.0, 0.2  # Pa, kg/m³, m, m
WAVE = (STIFF / DENSITY) ** 0.5
FREQUENCY = np.pi * WAVE / LENGTH  # [1/s]
SPEED = 1e-5 * WAVE  # v0 [m/s]


def run(settings: dict[str, Any], comm: MPI.Comm) -> dict[str, Any]:
    """Relative error of the displacement or the frequency (collective)."""
    from extremal.mpm.law import Law
    from extremal.mpm.problem import SnowProblem
    from extremal.obstacles.shapes import Box

    law = Law("fixed_corotated", STIFF, 0.0, DENSITY)
    made, start = _snow.particles(Box([0.0, 0.0], [LENGTH, WIDTH]), settings, law, lambda X: SPEED * mode(X), comm)
    keys = ("cell_size", "spline", "beta", "flip", "precision")
    problem = SnowProblem(comm, made, [law], **{key: settings[key] for key in keys})
    away = _snow.Difference(problem, start, exact)
    shape = mode(start)[:, 0]
    times, amplitude = [], []

    def look(t: float) -> None:
        away(t)
        p = problem.particles
        moved = (p.position - start[p.ident])[:, 0] @ shape[p.ident]
        times.append(t)
        amplitude.append(comm.allreduce(float(moved)) / (shape @ shape))

    steps = max(1, round(settings["periods"] * 2 * np.pi / FREQUENCY / settings["time_step"]))
    told = _snow.walk(problem, settings, steps, look=look)
    found, damping = fitted(np.array(times), np.array(amplitude))
    errors = {"displacement": away.relative(comm), "frequency": abs(found / FREQUENCY - 1)}
    return {**told, "error": errors[settings["norm"]], "diagnostics": {**errors, "damping": damping}}


def mode(X: NDArray) -> NDArray:
    """The mode's shape (n, 2) at X (n, 2)."""
    return np.column_stack([np.cos(np.pi * X[:, 0] / LENGTH), np.zeros(len(X))])


def exact(X: NDArray, t: float) -> NDArray:
    """u(X, t) [m], shape (n, 2)."""
    return SPEED / FREQUENCY * np.sin(FREQUENCY * t) * mode(X)


def fitted(t: NDArray, q: NDArray) -> tuple[float, float]:
    """Frequency and damping γ [1/s] of exp(-γ t) times a sine and a cosine, by least squares."""
    from scipy.optimize import least_squares

    q = q / np.abs(q).max()

    def away(z: NDArray) -> NDArray:
        waves = np.exp(-z[0] * t)[:, None] * np.column_stack([np.sin(z[1] * t), np.cos(z[1] * t)])
        rest: NDArray = waves @ np.linalg.lstsq(waves, q, rcond=None)[0] - q
        return rest

    found = least_squares(away, [0.0, FREQUENCY], x_scale=[1.0, FREQUENCY], xtol=1e-14, ftol=1e-14)
    return float(found.x[1]), float(found.x[0])
