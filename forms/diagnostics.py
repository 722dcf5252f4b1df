"""A problem in figures: for its history, and for the line that says why a step failed."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from mpi4py import MPI

from .newton import Figures, Newton

if TYPE_CHECKING:
    from .problem import ElasticProblem


def diagnostics(problem: ElasticProblem, figures: Figures) -> dict[str, float]:
    """Energies [J], smallest J and stretch, inverted elements, contact, and what the last step took (collective)."""
    space, laws, comm, contact = problem.space, problem.laws, problem.comm, problem.contact
    space.u.x.array[:] = problem.motion.u
    if problem.equations.loads_at != problem.time:  # after a failed step, a restart, within the midpoint rule
        problem.equations.set_time(problem.time)
    laws.update(energy=True)
    elastic = comm.allreduce(float(problem.equations.weights @ laws.energy.x.array))
    points = comm.allreduce(len(problem.equations.weights))
    stretches = laws.stretches()
    J = stretches.prod(axis=1)
    problem.unknown.array[:] = problem.motion.u[: problem.equations.owned]
    loads = -problem.equations.load.dot(problem.unknown)
    kinetic = problem.equations.kinetic_energy(problem.motion.v)
    moved = np.linalg.norm(problem.motion.u.reshape(-1, space.dimension), axis=1).max(initial=0)
    touch = contact.diagnostics(problem.motion.u, problem.time) if contact is not None else {}
    stored = contact.barrier_energy(problem.motion.u, problem.time) if contact is not None else 0.0
    return {
        "time": problem.time,
        "energy": elastic + loads + kinetic + stored,
        "elastic_energy": elastic,
        "kinetic_energy": kinetic,
        "inverted": comm.allreduce(int(np.unique(space.point_cells[J < 0]).size)),
        "smallest_J": comm.allreduce(float(J.min(initial=np.inf)), op=MPI.MIN),
        "smallest_stretch": comm.allreduce(float(stretches[:, -1].min(initial=np.inf)), op=MPI.MIN),
        "residual": figures.residual,
        "newton_iterations": figures.newton,
        "krylov_iterations": figures.krylov,
        "svd_skipped": comm.allreduce(laws.skipped) / max(1, points),
        "max_displacement": comm.allreduce(float(moved), op=MPI.MAX),
        **touch,
    }


def why(problem: ElasticProblem, newton: Newton, figures: Figures) -> str:
    """Why a step failed: reasons of the solvers and the worst element, in one line (collective)."""
    words = f"{newton.reasons()} after {figures.newton} Newton iterations, |F| = {figures.residual:.3g} N"
    words += f" (wanted {problem.tolerance:.3g})"
    problem.equations.set(problem.unknown)
    problem.laws.update()
    stretches = problem.laws.stretches()
    J = stretches.prod(axis=1)
    worst: tuple[float, int, tuple, tuple] = (np.inf, 0, (), ())
    if len(J):
        k = int(np.argmin(np.where(np.isfinite(J), J, -np.inf)))
        cell = problem.space.point_cells[k]
        place = tuple(problem.space.midpoints()[cell][: problem.space.dimension])
        worst = (float(J[k]), int(problem.space.domain.original_cells[cell]), tuple(stretches[k]), place)
    J_worst, element, s, x = min(problem.comm.allgather(worst), key=lambda w: w[0])
    return (
        f"{words}; worst element {element} at ({', '.join(f'{c:.3g}' for c in x)}) m: J = {J_worst:.3g}, "
        f"stretches {', '.join(f'{c:.3g}' for c in s)}"
    )
