"""Held and moved boundaries, body forces, tractions, pressures."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import dolfinx
import numpy as np
import ufl
from dolfinx import fem
from mpi4py import MPI
from numpy.typing import NDArray
from petsc4py import PETSc

from . import compat
from .laws import LawError
from .space import Space

Motion = Callable[[NDArray, float], NDArray]  # positions (n, d) [m], time -> (n, d) [m] or [Pa]


@dataclass(frozen=True)
class Prescribed:
    """Displacement given on part of the body.

    Attributes
    ----------
    boundary : tuple of str
        Names of boundaries; or
    where : callable or None
        positions (n, d) [m] -> (n,) bool, choosing nodes.
    components : tuple of int
        Which components of the displacement are given.
    motion : callable or None
        (positions (n, d), time) -> displacement (n, d) [m]; None means zero.
    """

    boundary: tuple[str, ...] = ()
    where: Callable[[NDArray], NDArray] | None = None
    components: tuple[int, ...] = (0, 1, 2)
    motion: Motion | None = None


class Constraints:
    """All prescribed displacements of a body; where two meet, the later one wins.

    Attributes
    ----------
    conditions : list of dolfinx.fem.DirichletBC
        For the rows and columns that matrices leave out.
    dofs : (n,) int32
        Held degrees of freedom of this rank, ghosts included.
    """

    def __init__(self, space: Space, prescribed: Sequence[Prescribed]) -> None:
        self._space, d = space, space.dimension
        owner = np.full((len(space.positions), d), -1)
        for k, one in enumerate(prescribed):
            nodes = self._nodes(one)
            if space.comm.allreduce(len(nodes), op=MPI.SUM) == 0:
                raise LawError(f"condition {k + 1} holds no node: its place selects nothing of this mesh")
            for component in one.components:
                if component < d:
                    owner[nodes, component] = k
        self._moved = []
        for k, one in enumerate(prescribed):
            nodes, components = np.nonzero(owner == k)
            self._moved.append((one.motion, nodes, components))
        self.dofs = np.flatnonzero(owner.ravel() >= 0).astype(np.int32)
        self.conditions = [
            compat.held(space.vectors, c, np.flatnonzero(owner[:, c] >= 0) * d + c)
            for c in range(d)
            if space.comm.allreduce(int((owner[:, c] >= 0).sum()), op=MPI.SUM)
        ]

    def _nodes(self, one: Prescribed) -> NDArray:
        space = self._space
        if one.where is not None:
            return np.flatnonzero(one.where(space.positions))
        facets = space.domain.facets(one.boundary)
        return fem.locate_dofs_topological(space.vectors, space.dimension - 1, facets)

    def apply(self, values: NDArray, time: float, *, zero: bool = False) -> None:
        """Write the displacement prescribed at `time` to `values` (local nodes * d,); zero instead if asked."""
        table = values.reshape(-1, self._space.dimension)
        for motion, nodes, components in self._moved:
            if zero or motion is None or len(nodes) == 0:
                table[nodes, components] = 0
            else:
                given = motion(self._space.positions[nodes], time)
                table[nodes, components] = np.asarray(given)[np.arange(len(nodes)), components]

    def rates(self, time: float, velocity: NDArray, acceleration: NDArray) -> None:
        """Write the velocity [m/s] and acceleration [m/s²] prescribed from `time` on to the held entries.

        One-sided differences of third and second order: a motion may begin with a jerk.
        """
        h, held = 1e-3, self.dofs
        u = np.zeros((4, len(velocity)))
        for k in range(4):
            self.apply(u[k], time + k * h)
        velocity[held] = (np.array([-11, 18, -9, 2]) @ u)[held] / (6 * h)
        acceleration[held] = (np.array([2, -5, 4, -1]) @ u)[held] / h**2


class _Surface:
    """Facets of some boundaries with a measure of their own, so that two loads may share a facet."""

    def __init__(self, space: Space, boundary: Sequence[str]) -> None:
        facets = space.domain.facets(boundary)
        if space.comm.allreduce(len(facets), op=MPI.SUM) == 0:
            raise LawError(f"boundary {', '.join(boundary)} has no facet")
        marks = np.ones(len(facets), dtype=np.int32)
        tags = dolfinx.mesh.meshtags(space.mesh, space.dimension - 1, facets, marks)
        rule = {"quadrature_degree": 2 * space.degree}
        self.ds = ufl.Measure("ds", domain=space.mesh, subdomain_data=tags, subdomain_id=1, metadata=rule)


class Traction:
    """Force per reference area: adds ∫ t·v dS to the load."""

    def __init__(self, space: Space, boundary: Sequence[str], value: Motion) -> None:
        surface, self._value, self._space = _Surface(space, boundary), value, space
        self._field = fem.Function(space.vectors)
        v = ufl.TestFunction(space.vectors)
        self._form = compat.form(ufl.inner(self._field, v) * surface.ds)

    def add(self, load: PETSc.Vec, time: float) -> None:
        """load += ∫ t·v dS at `time` (ghosts not exchanged)."""
        self._field.x.array[:] = np.asarray(self._value(self._space.positions, time)).ravel()
        compat.add_vector(load, self._form)


class BodyForce:
    """Force per reference volume: adds ∫ b·v dV to the load, b taken at quadrature points."""

    def __init__(self, space: Space, value: Motion) -> None:
        self._value, d, degree = value, space.dimension, 2 * space.degree
        self._field = fem.Function(compat.quadrature(space.mesh, degree, (d,)))
        points, _ = compat.rule(d, degree)
        here = compat.expression(ufl.SpatialCoordinate(space.mesh), points)
        x = compat.evaluate(here, space.mesh, np.arange(space.cells, dtype=np.int32)).reshape(-1, d)
        self._rows = compat.cell_dofs(self._field.function_space, space.cells).ravel()
        self._x = np.empty_like(x)
        self._x[self._rows] = x
        v = ufl.TestFunction(space.vectors)
        dx = ufl.dx(domain=space.mesh, metadata={"quadrature_degree": degree, "quadrature_scheme": "default"})
        self._form = compat.form(ufl.inner(self._field, v) * dx)

    def add(self, load: PETSc.Vec, time: float) -> None:
        """load += ∫ b·v dV at `time` (ghosts not exchanged)."""
        self._field.x.array[:] = np.asarray(self._value(self._x, time)).ravel()
        compat.add_vector(load, self._form)


class Pressure:
    """Pressure p on the deformed surface: adds ∫ p cof(F) N·v dS to the residual. It has no energy in general."""

    def __init__(self, space: Space, boundary: Sequence[str], value: Motion) -> None:
        surface, self._value, self._space = _Surface(space, boundary), value, space
        self._scalars = compat.lagrange(space.mesh, 1)
        self._x = self._scalars.tabulate_dof_coordinates()[:, : space.dimension]
        self._p = fem.Function(self._scalars)
        v, du = ufl.TestFunction(space.vectors), ufl.TrialFunction(space.vectors)
        F = ufl.Identity(space.dimension) + ufl.grad(space.u)
        form = self._p * ufl.inner(ufl.cofac(F) * ufl.FacetNormal(space.mesh), v) * surface.ds
        self._residual = compat.form(form)
        self._tangent = compat.form(ufl.derivative(form, space.u, du))

    def set_time(self, time: float) -> None:
        """Take the pressure at `time`."""
        self._p.x.array[:] = np.asarray(self._value(self._x, time)).ravel()

    def add_residual(self, residual: PETSc.Vec) -> None:
        """residual += ∫ p cof(F) N·v dS (ghosts not exchanged)."""
        compat.add_vector(residual, self._residual)

    def add_tangent(self, matrix: PETSc.Mat, conditions: list[Any]) -> None:
        """matrix += the derivative of that, not symmetric."""
        compat.add_matrix(matrix, self._tangent, conditions)
