"""The weak form of equilibrium and motion: energy, residual and tangent at a displacement."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import ufl
from dolfinx import fem
from numpy.typing import NDArray
from petsc4py import PETSc

from . import compat
from .conditions import BodyForce, Constraints, Pressure, Traction
from .constitutive import Constitutive
from .integrators import Terms
from .space import Space

if TYPE_CHECKING:
    from .contacts import Contacts

Load = tuple[Sequence[str], Callable[[NDArray, float], NDArray]]


class Equations:
    """Find w with  ∫ P(w):∇v dX + α ∫ ρ (w - û)·v dX + C γ (w - ũ) = loads(v)  for all v, see `integrators`.

    Without inertia α = γ = 0. C = a M + b K is Rayleigh damping with K the projected tangent of the last state.

    Attributes
    ----------
    terms : Terms or None
        Inertia of the present step.
    has_energy : bool
        Whether the residual is the gradient of `energy` (not with pressures, not with the IFE extension).
    held : (n,) int32
        Owned degrees of freedom with prescribed displacement.
    contact : Contacts or None
        Adds its energy, force and Hessian.
    matrix : PETSc.Mat
        The tangent.
    """

    def __init__(
        self,
        space: Space,
        laws: Constitutive,
        constraints: Constraints,
        *,
        inertia: bool,
        damping: tuple[float, float],
        gravity: Sequence[float] | None,
        body_force: Callable[[NDArray, float], NDArray] | None,
        tractions: Sequence[Load],
        pressures: Sequence[Load],
    ) -> None:
        self.space, self.laws, self.constraints = space, laws, constraints
        self.comm: Any = space.comm
        self.terms: Terms | None = None
        self.contact: Contacts | None = None
        self.loads_at: float | None = None  # time of the loads in force
        self.weights = space.weights()
        self.pressures = [Pressure(space, names, value) for names, value in pressures]
        self.has_energy = laws.has_energy and not pressures
        self.mass_damping, self._stiffness_damping = damping
        self._loads: list[tuple[PETSc.Log.Event, Any]] = []
        self._loads += [(event("traction"), Traction(space, names, value)) for names, value in tractions]
        self._loads += [(event("body_force"), BodyForce(space, body_force))] if body_force is not None else []
        self._events = {name: event(f"elasticity:{name}") for name in ("energy", "residual", "tangent")}
        self._inertia_event = event("inertia") if inertia else None
        self._damping_event = event("damping") if any(damping) else None
        self._pressure_event = event("pressure") if pressures else None
        self._forms(inertia, gravity)

    def _forms(self, inertia: bool, gravity: Sequence[float] | None) -> None:
        space, d = self.space, self.space.dimension
        v, du = ufl.TestFunction(space.vectors), ufl.TrialFunction(space.vectors)
        self._residual_form = compat.form(ufl.inner(self.laws.stress, ufl.grad(v)) * space.dx)
        flat_v, flat_du = (
            ufl.as_vector([ufl.grad(w)[i, j] for i in range(d) for j in range(d)]) for w in (v, du)
        )
        tangent = ufl.dot(flat_v, ufl.dot(self.laws.tangent, flat_du)) * space.dx
        if inertia or gravity is not None:
            rho = fem.Function(compat.cellwise(space.mesh))
            rho.x.array[:] = self.laws.density()
        if gravity is not None:
            acceleration = fem.Constant(space.mesh, np.array(gravity, dtype=PETSc.ScalarType)[:d])
            form = compat.form(rho * ufl.inner(acceleration, v) * ufl.dx)
            self._loads.append((event("gravity"), _Constant(form)))
        self.mass: PETSc.Mat | None = None
        if inertia:
            self._alpha = fem.Constant(space.mesh, PETSc.ScalarType(1.0))
            mass = rho * ufl.inner(du, v) * ufl.dx(metadata={"quadrature_degree": 2 * space.degree})
            tangent += self._alpha * mass
            compiled = compat.form(mass)
            self._mass_form = compiled
            self.mass = compat.matrix(compiled)
            compat.add_matrix(self.mass, compiled, [])
            self.mass.assemble()
        self._tangent_form = compat.form(tangent)
        self.matrix = self._stiffness = compat.matrix(self._tangent_form)
        self.matrix.setBlockSize(d)
        self.vector = compat.vector(self._residual_form)
        self.load = self.vector.duplicate()
        self._work, self._product = self.vector.duplicate(), self.vector.duplicate()
        self.owned = space.vectors.dofmap.index_map.size_local * d
        self.held = self.constraints.dofs[self.constraints.dofs < self.owned]
        self.matrix.setNearNullSpace(self._rigid_motions())

    def _rigid_motions(self) -> PETSc.NullSpace:
        """Rigid motions of the reference body, for algebraic multigrid."""
        d = self.space.dimension
        x = self.space.positions[: self.owned // d]
        fields = [np.broadcast_to(np.eye(d)[k], x.shape) for k in range(d)]
        for i in range(d):
            for j in range(i):
                turn = np.zeros_like(x)
                turn[:, i], turn[:, j] = -x[:, j], x[:, i]
                fields.append(turn)
        basis: list[PETSc.Vec] = []
        for one in fields:
            vec = self.vector.duplicate()
            vec.array[:] = one.ravel()
            for other in basis:
                vec.axpy(-vec.dot(other), other)
            vec.normalize()
            basis.append(vec)
        return PETSc.NullSpace().create(vectors=basis, comm=self.comm)

    def meet(self, contact: Contacts) -> None:
        """Add contact; before a solver is made, since the tangent may need a pattern that changes."""
        self.contact = contact
        if contact.surface is not None:
            self.matrix = compat.unfilled(self._stiffness)
            self.matrix.setNearNullSpace(self._stiffness.getNearNullSpace())

    # ------------------------------------------------------------------ what SNES asks

    def set(self, x: PETSc.Vec) -> None:
        """Make `x` the displacement of the space, ghosts included."""
        vec = compat.vector_of(self.space.u)
        x.copy(vec)
        vec.ghostUpdate(addv=PETSc.InsertMode.INSERT, mode=PETSc.ScatterMode.FORWARD)

    def energy(self, x: PETSc.Vec) -> float:
        """Elastic, inertial, damping and load energy at `x` [J]; infinite where the law has no value."""
        with self._events["energy"]:
            self.set(x)
            touch = self.contact.energy() if self.contact is not None else 0.0
            if touch == np.inf:
                return touch
            self.laws.update(energy=True)
            total = float(self.weights @ self.laws.energy.x.array)
            rate = self._damping_stress()
            if rate is not None:
                strain = self.laws.gradient - self._gradient_tilde
                total += 0.5 * float(self.weights @ np.einsum("ni,ni->n", rate, strain))
            total = self.comm.allreduce(total) - self.load.dot(x)
            total += self._inertia(x, None) + touch
        return total if np.isfinite(total) else np.inf

    def residual(self, x: PETSc.Vec, out: PETSc.Vec, reactions: bool = False) -> None:
        """Gradient of `energy`, plus pressures; where the displacement is prescribed zero, or the reactions [N]."""
        with self._events["residual"]:
            self.set(x)
            self.internal_force(out)
            out.axpy(-1.0, self.load)
            self._inertia(x, out)
            if self.contact is not None:
                self.contact.add_force(out)
            if not reactions:
                out.array[self.held] = 0

    def internal_force(self, out: PETSc.Vec) -> None:
        """∫ P:∇v dX with stiffness damping and pressures, at the displacement of the space."""
        self.laws.update(stress=True)
        rate = self._damping_stress()
        if rate is not None:
            self.laws.stress.x.array[:] += rate.ravel()
        self._assemble_stress(out)
        if self._pressure_event is not None:
            with self._pressure_event:
                for pressure in self.pressures:
                    pressure.add_residual(out)
        out.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)

    def _assemble_stress(self, out: PETSc.Vec) -> None:
        with out.localForm() as local:
            local.set(0.0)
        compat.add_vector(out, self._residual_form)

    def _inertia(self, x: PETSc.Vec, out: PETSc.Vec | None) -> float:
        """Energy of inertia and mass damping at `x` [J]; their force is added to `out`."""
        if self.terms is None or self._inertia_event is None:
            return 0.0
        terms, total = self.terms, 0.0
        with self._inertia_event:
            for factor, at in ((terms.alpha, terms.u_hat), (self.mass_damping * terms.gamma, terms.u_tilde)):
                if factor == 0:
                    continue
                self._work.array[:] = x.array_r - at[: self.owned]
                self.mass.mult(self._work, self._product)  # type: ignore[union-attr]
                total += factor / 2 * self._work.dot(self._product)
                if out is not None:
                    out.axpy(factor, self._product)
        return total

    def tangent(self, x: PETSc.Vec, out: PETSc.Mat, projected: bool) -> None:
        """Derivative of the residual; `projected` cuts negative eigenvalues of ∂P/∂F at every point."""
        with self._events["tangent"]:
            self.set(x)
            self.laws.update(tangent=True, project=projected)
            if self.terms is not None:
                self._alpha.value = self.terms.alpha + self.mass_damping * self.terms.gamma
                if self._stiffness_damping:
                    self.laws.tangent.x.array[:] += self._stiffness_damping * self.terms.gamma * self._lagged
            stiffness = self._stiffness
            stiffness.zeroEntries()
            compat.add_matrix(stiffness, self._tangent_form, self.constraints.conditions)
            for pressure in self.pressures:
                pressure.add_tangent(stiffness, self.constraints.conditions)
            if self.contact is not None:
                self.contact.add_tangent(stiffness, projected)
            stiffness.assemble()
            if self.contact is not None and self.contact.surface is not None:
                compat.fill(out, stiffness, self.contact.coupling(projected))
            elif out.handle != stiffness.handle:
                stiffness.copy(out, PETSc.Mat.Structure.SAME_NONZERO_PATTERN)

    def linear_force(self, here: PETSc.Vec, change: NDArray) -> PETSc.Vec:
        """Residual at `here` plus the projected tangent there times `change` (local values); fills `matrix`.

        The result is `vector`, zero where the displacement is prescribed.
        """
        self.residual(here, self.vector)
        self.tangent(here, self.matrix, True)
        self.space.u.x.array[:] = change
        self.space.gradient(self.laws.gradient)
        size = self.laws.gradient.shape[1]
        tangent = self.laws.tangent.x.array.reshape(-1, size, size)
        self.laws.stress.x.array[:] = np.einsum("nij,nj->ni", tangent, self.laws.gradient).ravel()
        self._assemble_stress(self._work)
        self._work.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
        self.vector.axpy(1.0, self._work)
        if self.mass is not None:
            self._work.array[:] = change[: self.owned]
            self.mass.mult(self._work, self._product)
            self.vector.axpy(float(self._alpha.value), self._product)
        if self.contact is not None:
            self.contact.add_linear(change, self.vector)
        self.vector.array[self.held] = 0
        return self.vector

    # ------------------------------------------------------------------ a step's loads, inertia and damping

    def set_time(self, time: float) -> None:
        """Take loads and pressures at `time`."""
        self.loads_at = time
        with self.load.localForm() as local:
            local.set(0.0)
        for log, load in self._loads:
            with log:
                load.add(self.load, time)
        self.load.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
        for pressure in self.pressures:
            pressure.set_time(time)

    def begin(self, terms: Terms | None, start: NDArray) -> None:
        """Take the inertia of a step that begins at displacement `start` (local values)."""
        self.terms = terms
        if terms is None or not self._stiffness_damping or self._damping_event is None:
            return
        with self._damping_event:
            u = self.space.u.x.array
            u[:] = start
            self.laws.update(tangent=True)
            self._lagged = self.laws.tangent.x.array.copy()
            u[:] = terms.u_tilde
            self._gradient_tilde = np.empty_like(self.laws.gradient)
            self.space.gradient(self._gradient_tilde)

    def rounding(self) -> float:
        """|F| [N] below which the digits of the positions tell nothing: eps α |M û| of inertia in very short steps."""
        if self.terms is None:
            return 0.0
        self._work.array[:] = self.terms.u_hat[: self.owned]
        self.mass.mult(self._work, self._product)  # type: ignore[union-attr]
        return float(np.finfo(float).eps * self.terms.alpha * self._product.norm())

    def _damping_stress(self) -> NDArray | None:
        """Stress b γ K:(∇w - ∇ũ) of stiffness damping at the points."""
        if self.terms is None or not self._stiffness_damping or self._damping_event is None:
            return None
        with self._damping_event:
            rate = self.terms.gamma * (self.laws.gradient - self._gradient_tilde)
            tangent = self._lagged.reshape(len(rate), rate.shape[1], -1)
            return self._stiffness_damping * np.einsum("nij,nj->ni", tangent, rate)

    def acceleration(self, u: NDArray, velocity: NDArray, held: NDArray) -> NDArray:
        """a = M⁻¹ (loads - f_int(u) - C v) [m/s²], where it is not prescribed; all are local values.

        Parameters
        ----------
        u, velocity : (local nodes * d,)
            [m], [m/s]
        held : (local nodes * d,)
            Prescribed acceleration [m/s²]; other entries are not looked at.
        """
        assert self.mass is not None
        force, found = self.vector.duplicate(), self.vector.duplicate()
        found.array[:] = u[: self.owned]
        self.begin(Terms(0.0, u, 1.0, u - velocity), u)  # C (u - (u - v))
        self.residual(found, force)
        self.begin(None, u)
        self._work.array[:] = 0
        self._work.array[self.held] = held[self.held]
        self.mass.mult(self._work, self._product)
        force.axpy(1.0, self._product)
        force.scale(-1.0)
        force.array[self.held] = held[self.held]
        mass = compat.matrix(self._mass_form)
        compat.add_matrix(mass, self._mass_form, self.constraints.conditions)
        mass.assemble()
        ksp = PETSc.KSP().create(self.comm)
        ksp.setOptionsPrefix("elastic_start_")
        ksp.setOperators(mass)
        ksp.setType("cg")
        ksp.getPC().setType("jacobi")
        ksp.setTolerances(rtol=1e-12, max_it=1000)
        ksp.setFromOptions()
        ksp.solve(force, found)
        out = fem.Function(self.space.vectors)
        vec = compat.vector_of(out)
        found.copy(vec)
        vec.ghostUpdate(addv=PETSc.InsertMode.INSERT, mode=PETSc.ScatterMode.FORWARD)
        for used in (force, found, mass, ksp):
            used.destroy()
        return out.x.array.copy()

    def kinetic_energy(self, velocity: NDArray) -> float:
        """½ vᵀ M v [J]."""
        if self.mass is None:
            return 0.0
        self._work.array[:] = velocity[: self.owned]
        self.mass.mult(self._work, self._product)
        return 0.5 * self._work.dot(self._product)

    def destroy(self) -> None:
        """Free the PETSc objects."""
        for used in (self.matrix, self._stiffness, self.vector, self.load, self._work, self._product, self.mass):
            if used is not None:
                used.destroy()


class _Constant:
    """A load that does not depend on time, assembled once."""

    def __init__(self, form: Any) -> None:
        self._form = form
        self._vector: PETSc.Vec | None = None

    def add(self, load: PETSc.Vec, time: float) -> None:
        if self._vector is None:
            self._vector = load.duplicate()
            compat.add_vector(self._vector, self._form)
        with load.localForm() as out, self._vector.localForm() as own:
            out.axpy(1.0, own)


def event(name: str) -> PETSc.Log.Event:
    """PETSc log event of an effect of this part, seen by -log_view and run.json."""
    return PETSc.Log.Event(f"elastic:{name}")
