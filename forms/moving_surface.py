"""The surface of a moving body as others meet it: where it is, how fast and how heavy; impulses on it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from dolfinx import fem
from mpi4py import MPI
from numpy.typing import NDArray
from petsc4py import PETSc

from extremal.native.options import defaults
from extremal.obstacles.facets import boundary

from . import compat
from .integrators import Motion, Terms

if TYPE_CHECKING:
    from .problem import ElasticProblem

PREFIX = "elastic_push_"
DEFAULTS: Mapping[str, object] = {"ksp_type": "cg", "pc_type": "pbjacobi", "ksp_max_it": 2000}
LOOSE, TIGHT = 1e-4, 1e-11  # relative residuals: while impulses are sought, and of what the body is given


@dataclass
class _Step:
    """The step that the body has made: its inertia, unknown w, ∂u/∂w and ∂v/∂w [1/s], and whether T is assembled."""

    dt: float
    terms: Terms
    w: NDArray
    moves: float
    speeds: float
    assembled: bool = False


class MovingSurface:
    """The boundary facets of a dynamic body of first degree, the same on all ranks, its mobility and its momentum.

    Impulses I at the nodes during a step of length Δt change its unknown by δw = T⁻¹ I/Δt, with the tangent T = α M + K
    at the end of the step: all of the body's elastic answer to them within the step, linearised. Backward Euler and the
    midpoint rule then have given the body the momentum Σ I.

    Parameters
    ----------
    problem : ElasticProblem
        By backward Euler or the midpoint rule.

    Attributes
    ----------
    cells : (c, d + 1) int
        Simplices, by the canonical numbers of their nodes.
    facets : (f, d) int
        Those of the surface, turned outwards.
    mass : (n,) [kg]
        Of all nodes of the body, sums of the rows of M; infinite where all components are prescribed.
    outside : (d,) [N s]
        Impulse on the body, since the start, of all but `push`: of loads, obstacles, drag, and what holds it.
    """

    def __init__(self, problem: ElasticProblem) -> None:
        self._problem, space = problem, problem.space
        self._d = d = space.dimension
        self._equations = problem.equations
        self._owned = self._equations.owned // d
        points, self.cells, _ = self._comm.bcast(problem.geometry())
        self.facets = boundary(points[:, :d], self.cells)
        self._nodes = space.nodes[: self._owned]
        rows = self._gather(self._times_mass(np.ones(self._equations.owned)))[:, 0]
        self._held = self._gather((~space.free(problem.constraints.dofs)).astype(float)[: self._owned]) > 0
        self.mass = np.where(self._held.all(axis=1), np.inf, rows)
        self._ksp = PETSc.KSP().create(problem.comm)
        self._ksp.setOptionsPrefix(PREFIX)
        with defaults(PREFIX, DEFAULTS):
            self._ksp.setFromOptions()
        self._right, self._change = self._equations.vector.duplicate(), fem.Function(space.vectors)
        self._step: _Step | None = None
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
        """v (n, d) [m/s] of the nodes (collective)."""
        return self._gather(self._problem.motion.v.reshape(-1, self._d)[: self._owned])

    def momentum(self) -> NDArray:
        """Σ M v (d,) [N s] (collective)."""
        return self._sum(self._times_mass(self._problem.motion.v[: self._equations.owned]))

    # ------------------------------------------------------------------ impulses in the last step

    def mobility(self, impulses: NDArray) -> NDArray:
        """Change of the nodes' velocities (n, d) [m/s] by impulses (n, d) [N s], the same on all ranks (collective)."""
        step = self._respond(impulses, LOOSE)
        return step.speeds * self._gather(self._change.x.array.reshape(-1, self._d)[: self._owned])

    def push(self, impulses: NDArray) -> None:
        """Give the body impulses (n, d) [N s], the same on all ranks, in the step it has made (collective).

        Where the body would enter an obstacle by that it has the new velocity, but stays where it is.
        """
        problem, equations = self._problem, self._equations
        if not impulses.any():
            return
        step = self._respond(impulses, TIGHT)
        change = self._change.x.array.copy()
        equations.matrix.mult(compat.vector_of(self._change), self._right)  # what holds the body has no part in it
        passed_on = step.dt * self._sum(self._right.array.reshape(-1, self._d))
        gained = step.speeds * self._sum(self._times_mass(change[: equations.owned]))
        self.outside += gained - passed_on - np.where(self._held, impulses, 0.0).sum(axis=0)
        u, v = problem.motion.u + step.moves * change, problem.motion.v + step.speeds * change
        if problem.contact is not None:
            problem.contact.search_from(problem.motion.u)
            u = u if problem.contact.fits(u) else problem.motion.u
        problem.motion = replace(problem.motion, u=u, v=v)
        problem.space.u.x.array[:] = u

    def _respond(self, impulses: NDArray, rtol: float) -> _Step:
        """Put δw into `_change`."""
        step, equations, space = self._step, self._equations, self._problem.space
        assert step is not None
        if not step.assembled:
            self._problem.unknown.array[:] = step.w[: equations.owned]
            equations.terms = step.terms
            equations.tangent(self._problem.unknown, equations.matrix, True)
            equations.terms = None
            self._ksp.setOperators(equations.matrix)
            step.assembled = True
        self._right.array[:] = impulses[self._nodes].ravel() / step.dt
        self._right.array[equations.held] = 0
        self._ksp.setTolerances(rtol=PETSc.Options(PREFIX).getReal("ksp_rtol", rtol))
        vec = compat.vector_of(self._change)
        self._ksp.solve(self._right, vec)
        vec.ghostUpdate(addv=PETSc.InsertMode.INSERT, mode=PETSc.ScatterMode.FORWARD)
        space.u.x.array[:] = self._problem.motion.u
        return step

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
        assert terms is not None and problem.scheme is not None
        one = problem.scheme.finish(Motion(np.zeros(1), np.zeros(1)), np.ones(1), dt)
        self._step = _Step(dt, terms, problem.space.u.x.array.copy(), float(one.u[0]), float(one.v[0]))
        equations.residual(x, force, reactions=True)
        if equations.contact is None:
            held = force.array[equations.held].copy()
            force.array[:] = 0
            force.array[equations.held] = held
        force.axpy(1.0, equations.load)
        if equations.contact is not None:
            # friction has taken new forces since the solve: what is left in free rows is what has changed by that
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
