"""What cases of snow share: places of particles, steps of one length, what a point reports."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from extremal.mpm.bodies import seed
from extremal.mpm.particles import Particles

from ...errors import InputError
from .._table import petsc_options

if TYPE_CHECKING:
    from mpi4py import MPI
    from numpy.typing import NDArray

    from extremal.mpm.bodies import Region
    from extremal.mpm.law import Law
    from extremal.mpm.problem import SnowProblem

# settings of every case of snow: those of a scene's [grid], [analysis] and [[body]]
KEYS: dict[str, Any] = {
    "cell_size": 0.05,  # m
    "spline": "cubic",
    "per_cell": 4,
    "places": "lattice",  # of the particles: "lattice", where per_cell is a square, or "random", as scenes are seeded
    "volumes": "seeded",  # or "measured"
    "time_step": 2e-4,  # s
    "beta": 0.0,
    "flip": 1.0,
    "precision": "double",
    "rtol": 1e-12,  # of the conjugate residuals
}


def particles(
    region: Region, settings: dict[str, Any], law: Law, velocity: Callable[[NDArray], NDArray], comm: MPI.Comm
) -> tuple[Particles, NDArray]:
    """This rank's share of the particles that fill a plane region, and the places X (n, 2) [m] of all, by `ident`.

    Raises
    ------
    InputError
        If `per_cell` is no square and the places are a lattice.
    """
    h, count = settings["cell_size"], settings["per_cell"]
    if settings["places"] == "random":
        x = seed(region, h, count)
    else:
        side = round(count**0.5)
        if side**2 != count:
            raise InputError(f'per_cell = {count}: must be a square where places = "lattice"')
        low, high = (np.asarray(corner) * side / h for corner in region.bounds())
        axes = [h / side * (np.arange(round(a), round(b)) + 0.5) for a, b in zip(low, high)]
        x = np.stack([axis.ravel() for axis in np.meshgrid(*axes, indexing="ij")], axis=1)
        x = x[region.inside(x)]
    share = h**2 / count
    made = Particles.at(x, law.density * share, velocity(x))
    if settings["volumes"] == "seeded":
        made.volume[:] = share
    return made.take(np.arange(comm.rank, len(x), comm.size)), x


def walk(
    problem: SnowProblem,
    settings: dict[str, Any],
    steps: int,
    *,
    push: Callable[[float], None] | None = None,
    look: Callable[[float], None],
) -> dict[str, Any]:
    """Make `steps` steps, `push(t)` before and `look(t)` after each; returns what a case reports of them (collective).

    The seconds are those of the steps alone.
    """
    wall = seconds = 0.0
    iterations = 0.0
    dt = settings["time_step"]
    with petsc_options("snow_", {"ksp_rtol": settings["rtol"]}):
        for step in range(steps):
            began, spent = time.monotonic(), time.process_time()
            if push is not None:
                push(step * dt)
            iterations += problem.advance(dt)["krylov_iterations"]
            wall, seconds = wall + time.monotonic() - began, seconds + time.process_time() - spent
            look(problem.time)
    return {
        "size": problem.size,
        "steps": steps,
        "seconds": seconds,
        "wall_seconds": wall,
        "iterations": {"krylov_iterations": int(iterations)},
    }


class Difference:
    """Sum over times and particles of |u - u_exact|² beside that of |u_exact|²; u is the displacement [m]."""

    def __init__(self, problem: SnowProblem, start: NDArray, exact: Callable[[NDArray, float], NDArray]) -> None:
        self._problem, self._start, self._exact = problem, start, exact
        self._sums = np.zeros(2)

    def __call__(self, t: float) -> None:
        """Add the particles of this rank as they are."""
        p = self._problem.particles
        X = self._start[p.ident]
        there = self._exact(X, t)
        self._sums += ((p.position - X - there) ** 2).sum(), (there**2).sum()

    def relative(self, comm: MPI.Comm) -> float:
        """Root of the ratio of the sums (collective)."""
        away, there = comm.allreduce(self._sums[0]), comm.allreduce(self._sums[1])
        return float(np.sqrt(away / there))
