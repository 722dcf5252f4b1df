"""The surface of a moving body as others meet it: where it is, how fast and how heavy; impulses on it."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

from extremal.obstacles.facets import boundary

from .integrators import Motion

if TYPE_CHECKING:
    from .problem import ElasticProblem


class MovingSurface:
    """The boundary facets of a dynamic body of first degree, the same on all ranks, and the body's momentum.

    Masses m_k of nodes are the sums of the rows of the mass matrix M. With v + m⁻¹ I impulses I_k change the momentum
    by Σ I, since rows of M and its columns have the same sums, and the kinetic energy by ṽ·I + ½ I·m⁻¹ M m⁻¹ I with
    ṽ = m⁻¹ M v: by no more than that of free masses m_k with velocities ṽ_k.

    Parameters
    ----------
    problem : ElasticProblem
        Backward Euler or midpoint rule: a step changes the momentum by the forces in force in it times its length.

    Attributes
    ----------
    cells : (c, d + 1) int
        Simplices, by the canonical numbers of their nodes.
    facets : (f, d) int
        Those of the surface, turned outwards.
    mass : (n,) [kg]
        Of all nodes of the body; infinite where all components are prescribed.
    outside : (d,) [N s]
        Impulse on the body, since the start, of all but `push`: of loads, obstacles, and what holds it.
    """

    def __init__(self, problem: ElasticProblem) -> None:
        self._problem, space = problem, problem.space
        self._d = d = space.dimension
        self._equations = problem.equations
        self._owned = self._equations.owned // d
        points, self.cells, _ = self._comm.bcast(problem.geometry())
        self.facets = boundary(points[:, :d], self.cells)
        self._nodes = space.nodes[: self._owned]
        free = np.ones(len(space.nodes) * d, dtype=bool)
        free[problem.constraints.dofs] = False
        self._free = free.reshape(-1, d)
        rows = self._times_mass(np.ones(self._equations.owned))
        self._rows = self._gather(rows)[:, 0]
        self._held = self._gather((~self._free).astype(float)[: self._owned]) > 0
        self.mass = np.where(self._held.all(axis=1), np.inf, self._rows)
        self.outside = np.zeros(d)
        problem.on_solved = self._solved

    @property
    def _comm(self) -> MPI.Comm:
        return self._problem.comm

    # ------------------------------------------------------------------ where it is and how it moves

    def positions(self) -> NDArray:
        """Where the nodes are (n, d) [m] (collective)."""
        d = self._d
        u = self._problem.motion.u.reshape(-1, d)[: self._owned]
        return self._gather(self._problem.space.positions[: self._owned] + u)

    def velocities(self) -> NDArray:
        """ṽ (n, d) [m/s] of the nodes; that prescribed where they are held (collective)."""
        v = self._problem.motion.v[: self._equations.owned]
        smooth = self._gather(self._times_mass(v)) / self._rows[:, None]
        return np.where(np.isinf(self.mass)[:, None], self._gather(v.reshape(-1, self._d)), smooth)

    def momentum(self) -> NDArray:
        """Σ M v (d,) [N s] (collective)."""
        return self._sum(self._times_mass(self._problem.motion.v[: self._equations.owned]))

    def push(self, impulses: NDArray) -> None:
        """Change the velocity by `impulses` (n, d) [N s], the same on all ranks; what is held does not give way."""
        motion = self._problem.motion
        change = (impulses / self._rows[:, None])[self._problem.space.nodes]
        v = motion.v + np.where(self._free, change, 0.0).ravel()
        self._problem.motion = replace(motion, v=v)
        self.outside -= np.where(self._held, impulses, 0.0).sum(axis=0)

    def keep(self) -> tuple[Motion, float, bool, NDArray]:
        """What `put_back` needs to undo steps of the body."""
        contact = self._problem.contact
        active = contact is not None and contact.active
        return self._problem.motion, self._problem.time, active, self.outside.copy()

    def put_back(self, kept: tuple[Motion, float, bool, NDArray]) -> None:
        """Undo the steps made since `keep`."""
        problem = self._problem
        problem.motion, problem.time, active, self.outside = kept
        problem.space.u.x.array[:] = problem.motion.u
        if problem.contact is not None:
            problem.contact.active = active

    # ------------------------------------------------------------------ what else acts on the body

    def _solved(self, dt: float) -> None:
        """Add the impulse of the loads, obstacles, drag and reactions of a step (collective)."""
        problem, equations = self._problem, self._equations
        x, terms, force = problem.unknown, equations.terms, equations.vector.duplicate()
        assert terms is not None
        equations.residual(x, force, reactions=True)
        held = np.zeros_like(force.array)
        held[equations.held] = force.array[equations.held]
        force.array[:] = held + equations.load.array
        if equations.contact is not None:
            touch = equations.vector.duplicate()
            touch.set(0.0)
            equations.contact.add_force(touch)
            force.axpy(-1.0, touch)
            touch.destroy()
        drag = equations.mass_damping * terms.gamma
        force.array[:] -= drag * self._times_mass(x.array_r - terms.u_tilde[: equations.owned]).ravel()
        self.outside += dt * self._sum(force.array.reshape(-1, self._d))
        force.destroy()

    # ------------------------------------------------------------------ sums and gathering

    def _times_mass(self, values: NDArray) -> NDArray:
        """M times owned values (n * d,), as (n, d)."""
        mass = self._equations.mass
        assert mass is not None
        x, y = self._equations.vector.duplicate(), self._equations.vector.duplicate()
        x.array[:] = values
        mass.mult(x, y)
        out = y.array.reshape(-1, self._d).copy()
        x.destroy()
        y.destroy()
        return out

    def _sum(self, values: NDArray) -> NDArray:
        total = values.sum(axis=0)
        self._comm.Allreduce(MPI.IN_PLACE, total)
        return total

    def _gather(self, values: NDArray) -> NDArray:
        """Values (owned nodes, c) of all nodes (n, c), by their canonical numbers, on all ranks."""
        out = np.zeros((self._problem.space.node_count, values.shape[1]))
        out[self._nodes] = values
        self._comm.Allreduce(MPI.IN_PLACE, out)
        return out
