"""The elastic problem: what the session drives, from constitutive laws to SNES."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import ufl
from dolfinx import fem
from mpi4py import MPI
from numpy.typing import NDArray
from petsc4py import PETSc

from extremal.meshes import Domain

from . import compat, initial
from .conditions import BodyForce, Constraints, Prescribed, Pressure, Traction
from .constitutive import Constitutive, agree
from .integrators import INTEGRATORS, Motion, Terms, local_error
from .material import Material
from .newton import Figures, Newton, StepFailure
from .space import Space


MOST_PREDICTIONS = 24  # linear solves before a step, see ElasticProblem._predict


@dataclass(frozen=True)
class Stage:
    """One solve of a continuation: ν at most `poisson_ratio`, ε = `threshold`; None leaves the material's own."""

    poisson_ratio: float | None = None
    threshold: float | None = None


class Events:
    """PETSc log events of the part, so that -log_view and run.json tell what each effect costs."""

    def __init__(self) -> None:
        for name in ("energy", "residual", "tangent", "inertia", "pressure", "constitutive"):
            setattr(self, name, PETSc.Log.Event(f"elastic:{name}"))


class ElasticProblem:
    """Equilibrium or motion of an invertible hyperelastic body.

    Parameters
    ----------
    domain : Domain
    materials : mapping of region name to Material
    degree : int
        1 or 2, of the displacement.
    prescribed : sequence of Prescribed
    tractions, pressures : sequence of (boundary names, function)
        Functions of (positions (n, d) [m], time) giving [Pa].
    gravity : sequence of float or None
        Acceleration [m/s²].
    body_force : callable or None
        Function of (positions (n, d) [m], time) giving [N/m³] of reference volume.
    integrator : str or None
        None for equilibrium; else a name in `INTEGRATORS`.
    damping : (float, float)
        Rayleigh factors of mass [1/s] and stiffness [s].
    stages : sequence of Stage
        Easier problems solved first where elements are inverted. This continuation is ours, not the source's.
    tolerance : float
        Largest |F| relative to E·V^((d-1)/d).
    iterations : int
        Most Newton iterations in a step, over all stages.
    exact_tangent : bool
        Never project the tangent.
    error_tolerance : float or None
        Largest local error [m] of an accepted dynamic step.
    """

    def __init__(
        self,
        domain: Domain,
        materials: Mapping[str, Material],
        *,
        degree: int = 1,
        prescribed: Sequence[Prescribed] = (),
        tractions: Sequence[tuple[Sequence[str], Callable]] = (),
        pressures: Sequence[tuple[Sequence[str], Callable]] = (),
        gravity: Sequence[float] | None = None,
        body_force: Callable | None = None,
        integrator: str | None = None,
        damping: tuple[float, float] = (0.0, 0.0),
        stages: Sequence[Stage] = (),
        tolerance: float = 1e-8,
        iterations: int = 150,
        exact_tangent: bool = False,
        error_tolerance: float | None = None,
    ) -> None:
        self.comm = domain.mesh.comm
        self.time = 0.0
        self.on_iteration: Callable[[dict[str, float]], None] | None = None
        self.space = Space(domain, degree)
        self.laws = Constitutive(self.space, materials)
        self.constraints = agree(self.comm, lambda: Constraints(self.space, prescribed))
        self._tractions = [Traction(self.space, names, value) for names, value in tractions]
        self._body_forces = [BodyForce(self.space, body_force)] if body_force is not None else []
        self._pressures = [Pressure(self.space, names, value) for names, value in pressures]
        self._gravity = gravity
        self._scheme = INTEGRATORS[integrator]() if integrator else None
        self._mass_damping, self._stiffness_damping = damping
        self._stages = tuple(stages)
        self._iterations, self._exact, self._error_tolerance = iterations, exact_tangent, error_tolerance
        self.has_energy = self.laws.has_energy and not pressures
        self._events = Events()
        self._weights = self.space.weights()
        volume = self.comm.allreduce(float(self._weights.sum()))
        d = self.space.dimension
        self.force_scale = self.laws.stiffness_scale() * volume ** ((d - 1) / d)
        self.tolerance = tolerance * self.force_scale
        self._figures = Figures()
        self._terms: Terms | None = None
        self._forms()
        zeros = np.zeros_like(self.space.u.x.array)
        self.motion = Motion(zeros.copy(), zeros.copy())
        self.effects = self._effects(gravity, damping)

    # ------------------------------------------------------------------ set-up

    def _forms(self) -> None:
        space, d = self.space, self.space.dimension
        v, du = ufl.TestFunction(space.vectors), ufl.TrialFunction(space.vectors)
        self._residual_form = compat.form(ufl.inner(self.laws.stress, ufl.grad(v)) * space.dx)
        g, h = ufl.grad(du), ufl.grad(v)
        flat_g = ufl.as_vector([g[i, j] for i in range(d) for j in range(d)])
        flat_h = ufl.as_vector([h[i, j] for i in range(d) for j in range(d)])
        tangent = ufl.dot(flat_h, ufl.dot(self.laws.tangent, flat_g)) * space.dx
        self._load_form = None
        if self._scheme is not None or self._gravity is not None:
            rho = fem.Function(compat.cellwise(space.mesh))
            rho.x.array[:] = self.laws.density()
            if self._gravity is not None:
                acceleration = fem.Constant(space.mesh, np.array(self._gravity, dtype=PETSc.ScalarType)[:d])
                self._load_form = compat.form(rho * ufl.inner(acceleration, v) * ufl.dx)
        if self._scheme is not None:
            self._alpha = fem.Constant(space.mesh, PETSc.ScalarType(1.0))
            mass = rho * ufl.inner(du, v) * ufl.dx(metadata={"quadrature_degree": 2 * space.degree})
            tangent += self._alpha * mass
            form = compat.form(mass)
            self._mass = compat.matrix(form)
            compat.add_matrix(self._mass, form, [])
            self._mass.assemble()
        self._tangent_form = compat.form(tangent)
        self._matrix = compat.matrix(self._tangent_form)
        self._matrix.setBlockSize(d)
        self._vector = compat.vector(self._residual_form)
        self._unknown = self._vector.duplicate()
        self._load = self._vector.duplicate()
        self._work = self._vector.duplicate()
        self._product = self._vector.duplicate()
        self._owned = space.vectors.dofmap.index_map.size_local * d
        self._held = self.constraints.dofs[self.constraints.dofs < self._owned]
        self._matrix.setNearNullSpace(self._rigid_motions())
        self._newton = Newton(self, self._vector, self._matrix, symmetric=not self._pressures)
        self._newton.on_iteration = self._report

    def _rigid_motions(self) -> PETSc.NullSpace:
        """Rigid motions of the reference body, for algebraic multigrid."""
        x, d = self.space.positions[: self._owned // self.space.dimension], self.space.dimension
        fields = [np.broadcast_to(np.eye(d)[k], x.shape) for k in range(d)]
        for i in range(d):
            for j in range(i):
                turn = np.zeros_like(x)
                turn[:, i], turn[:, j] = -x[:, j], x[:, i]
                fields.append(turn)
        basis: list[PETSc.Vec] = []
        for one in fields:
            vec = self._vector.duplicate()
            vec.array[:] = one.ravel()
            for other in basis:
                vec.axpy(-vec.dot(other), other)
            vec.normalize()
            basis.append(vec)
        return PETSc.NullSpace().create(vectors=basis, comm=self.comm)

    def _effects(self, gravity: Any, damping: tuple[float, float]) -> dict[str, dict[str, float]]:
        on: dict[str, dict[str, float]] = {"elasticity": {}}
        if self.laws.is_extended:
            on["extension"] = {}
        present = {
            "inertia": self._scheme is not None,
            "gravity": gravity is not None,
            "damping": any(damping),
            "traction": bool(self._tractions),
            "body_force": bool(self._body_forces),
            "pressure": bool(self._pressures),
            "continuation": bool(self._stages),
        }
        return on | {name: {} for name, there in present.items() if there}

    @property
    def is_dynamic(self) -> bool:
        """Whether there is inertia."""
        return self._scheme is not None

    # ------------------------------------------------------------------ where it starts

    def start(self, state: str = "rest", velocity: Callable[[NDArray], NDArray] | None = None, **how: Any) -> None:
        """Put the body in a state ("rest", "scatter", "collapse", "mirror") and give it a velocity [m/s].

        `how` goes to the function of that name in `initial`. Prescribed displacements hold from the start.
        """
        self.space.u.x.array[:] = 0
        if state != "rest":
            getattr(initial, state)(self.space, **how)
        self.constraints.apply(self.space.u.x.array, self.time)
        self.motion = Motion(self.space.u.x.array.copy(), np.zeros_like(self.space.u.x.array))
        if velocity is not None:
            self.motion.v[:] = np.asarray(velocity(self.space.positions)).ravel()
        self._set_load(self.time)
        if self._scheme is not None and self._scheme.needs_acceleration:
            self.motion.a = self._acceleration()

    def _acceleration(self) -> NDArray:
        """a = M⁻¹ (f_ext - f_int - C v) at the present state."""
        self._internal_force(self._work)
        self._work.aypx(-1.0, self._load)
        if self._mass_damping:
            self._product.setArray(self.motion.v[: self._owned])
            self._mass.mult(self._product, self._unknown)
            self._work.axpy(-self._mass_damping, self._unknown)
        ksp = PETSc.KSP().create(self.comm)
        ksp.setOptionsPrefix("elastic_start_")
        ksp.setOperators(self._mass)
        ksp.setType("cg")
        ksp.getPC().setType("jacobi")
        ksp.setTolerances(rtol=1e-12, max_it=1000)
        ksp.setFromOptions()
        ksp.solve(self._work, self._product)
        ksp.destroy()
        out = fem.Function(self.space.vectors)
        self._set(out, self._product)
        out.x.array[self.constraints.dofs] = 0
        return out.x.array.copy()

    # ------------------------------------------------------------------ the equations SNES solves

    @staticmethod
    def _set(function: fem.Function, x: PETSc.Vec) -> None:
        vec = compat.vector_of(function)
        x.copy(vec)
        vec.ghostUpdate(addv=PETSc.InsertMode.INSERT, mode=PETSc.ScatterMode.FORWARD)

    def energy(self, x: PETSc.Vec) -> float:
        """Elastic, inertial and load energy at `x` [J]."""
        with self._events.energy:
            self._set(self.space.u, x)
            self.laws.update(energy=True)
            total = self.comm.allreduce(self._sum(self._damped_energy()))
            total -= self._load.dot(x)
            if self._terms is not None:
                total += self._inertia(x, None)
        return total if np.isfinite(total) else np.inf

    def _sum(self, density: NDArray) -> float:
        return float(self._weights @ density)

    def residual(self, x: PETSc.Vec, out: PETSc.Vec) -> None:
        """Gradient of `energy`; zero where the displacement is prescribed."""
        with self._events.residual:
            self._set(self.space.u, x)
            self._internal_force(out)
            out.axpy(-1.0, self._load)
            if self._terms is not None:
                self._inertia(x, out)
            out.array[self._held] = 0

    def _internal_force(self, out: PETSc.Vec) -> None:
        self.laws.update(stress=True)
        self._damped_stress()
        with out.localForm() as local:
            local.set(0.0)
        compat.add_vector(out, self._residual_form)
        for pressure in self._pressures:
            with self._events.pressure:
                pressure.add_residual(out)
        out.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)

    def _inertia(self, x: PETSc.Vec, out: PETSc.Vec | None) -> float:
        """Energy of inertia and mass damping at x; their force is added to `out`."""
        terms = self._terms
        assert terms is not None
        total = 0.0
        with self._events.inertia:
            for factor, at in ((terms.alpha, terms.u_hat), (self._mass_damping * terms.gamma, terms.u_tilde)):
                if factor == 0:
                    continue
                self._work.array[:] = x.array_r - at[: self._owned]
                self._mass.mult(self._work, self._product)
                total += factor / 2 * self._work.dot(self._product)
                if out is not None:
                    out.axpy(factor, self._product)
        return total

    def tangent(self, x: PETSc.Vec, out: PETSc.Mat, projected: bool) -> None:
        """Hessian of `energy`; `projected` cuts negative eigenvalues of ∂P/∂F at every point."""
        with self._events.tangent:
            self._set(self.space.u, x)
            self.laws.update(tangent=True, project=projected and not self._exact)
            if self._terms is not None:
                self._alpha.value = self._terms.alpha + self._mass_damping * self._terms.gamma
                if self._stiffness_damping:
                    self.laws.tangent.x.array[:] += self._stiffness_damping * self._terms.gamma * self._lagged
            out.zeroEntries()
            compat.add_matrix(out, self._tangent_form, self.constraints.conditions)
            for pressure in self._pressures:
                with self._events.pressure:
                    pressure.add_tangent(out, self.constraints.conditions)
            out.assemble()

    # Stiffness damping: the tangent of the last accepted state, times the rate of the displacement gradient.

    def _damping_rate(self) -> NDArray | None:
        if self._terms is None or not self._stiffness_damping:
            return None
        rate = self._terms.gamma * (self.laws.gradient - self._gradient_tilde)
        return self._stiffness_damping * np.einsum("nij,nj->ni", self._lagged.reshape(len(rate), rate.shape[1], -1), rate)

    def _damped_energy(self) -> NDArray:
        stress = self._damping_rate()
        if stress is None:
            return self.laws.energy.x.array
        strain = self.laws.gradient - self._gradient_tilde
        return self.laws.energy.x.array + 0.5 * np.einsum("ni,ni->n", stress, strain)

    def _damped_stress(self) -> None:
        stress = self._damping_rate()
        if stress is not None:
            self.laws.stress.x.array[:] += stress.ravel()

    # ------------------------------------------------------------------ a step

    def _set_load(self, time: float) -> None:
        with self._load.localForm() as local:
            local.set(0.0)
        if self._load_form is not None:
            compat.add_vector(self._load, self._load_form)
        for load in (*self._tractions, *self._body_forces):
            load.add(self._load, time)
        self._load.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
        for pressure in self._pressures:
            pressure.set_time(time)

    def advance(self, dt: float) -> dict[str, float]:
        """One load or time step.

        Parameters
        ----------
        dt : float
            Length of the step [s].

        Returns
        -------
        dict
            newton_iterations, krylov_iterations, stages; wanted_step where the local error is controlled.

        Raises
        ------
        StepFailure
            On all ranks; the state is that before the step.
        """
        before = self.motion
        try:
            figures, stages = self._step(before, dt)
        except StepFailure:
            self.space.u.x.array[:] = before.u
            self._terms = None
            raise
        self._figures = figures
        self.time += dt
        return {"newton_iterations": figures.newton, "krylov_iterations": figures.krylov, "stages": stages}

    def _step(self, before: Motion, dt: float) -> tuple[Figures, int]:
        u = self.space.u.x.array
        if self._scheme is not None:
            self._terms = self._scheme.terms(before, dt)
            if self._stiffness_damping:
                u[:] = before.u
                self.laws.update(tangent=True)
                self._lagged = self.laws.tangent.x.array.copy()
                u[:] = self._terms.u_tilde
                self._gradient_tilde = np.empty_like(self.laws.gradient)
                self.space.gradient(self._gradient_tilde)
        stage = self._terms.stage if self._terms is not None else 1.0
        self._set_load(self.time + stage * dt)
        moved = before.u.copy()
        self.constraints.apply(moved, self.time + dt)
        moved = before.u + stage * (moved - before.u)
        self._predict(before.u, moved)
        self._unknown.array[:] = moved[: self._owned]

        figures, stages = self._solve()
        self._set(self.space.u, self._unknown)
        if self._scheme is None:
            self.motion = replace(before, u=u.copy())
        else:
            new = self._scheme.finish(before, u.copy(), dt)
            self._check_error(before, new, dt)
            self.motion = new
            u[:] = new.u
        return figures, stages

    def _predict(self, start: NDArray, moved: NDArray) -> None:
        """Let the body follow its moved boundary by linear solves, unless a jump of the boundary has less energy.

        The boundary goes part of the way at a time, so that no element of a body without inverted ones inverts.

        Parameters
        ----------
        start, moved : (local nodes * d,)
            Displacement before the step, and the same with the new prescribed values; the latter is changed.
        """
        jump = moved - start
        if self.comm.allreduce(float(np.abs(jump).max(initial=0)), op=MPI.MAX) == 0 or not self.has_energy:
            return
        here, done, part = start.copy(), 0.0, 1.0
        self.space.u.x.array[:] = start
        may_invert = self._count_inverted() > 0
        for _ in range(MOST_PREDICTIONS):
            part = min(part, 1 - done)
            ahead = self._follow(here, part * jump)
            if may_invert or self._count_inverted() == 0:
                here, done = ahead, done + part
                part *= 2
            else:
                part /= 2
            if done >= 1:
                break
        else:
            return
        self._unknown.array[:] = here[: self._owned]
        energy = self.energy(self._unknown)
        self._unknown.array[:] = moved[: self._owned]
        if energy < self.energy(self._unknown):
            moved[:] = here

    def _follow(self, here: NDArray, jump: NDArray) -> NDArray:
        """Where linear elasticity takes the body from `here` when its boundary moves by `jump`."""
        self._unknown.array[:] = here[: self._owned]
        self.residual(self._unknown, self._vector)
        self.tangent(self._unknown, self._matrix, True)
        self.space.u.x.array[:] = jump
        self.space.gradient(self.laws.gradient)
        size = self.laws.gradient.shape[1]
        tangent = self.laws.tangent.x.array.reshape(-1, size, size)
        self.laws.stress.x.array[:] = np.einsum("nij,nj->ni", tangent, self.laws.gradient).ravel()
        with self._work.localForm() as local:
            local.set(0.0)
        compat.add_vector(self._work, self._residual_form)
        self._work.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
        self._vector.axpy(1.0, self._work)
        if self._terms is not None:
            self._work.array[:] = jump[: self._owned]
            self._mass.mult(self._work, self._product)
            self._vector.axpy(float(self._alpha.value), self._product)
        self._vector.array[self._held] = 0
        self._newton.solve_linear(self._matrix, self._vector, self._product)
        self._unknown.array[:] = here[: self._owned] + jump[: self._owned] - self._product.array
        self._set(self.space.u, self._unknown)
        return self.space.u.x.array.copy()

    def _check_error(self, before: Motion, new: Motion, dt: float) -> None:
        if self._error_tolerance is None:
            return
        error = self.comm.allreduce(float(local_error(before, new, dt).max(initial=0)), op=MPI.MAX)
        if error > self._error_tolerance:
            raise StepFailure(f"local error {error:.3g} m is above error_tolerance = {self._error_tolerance:g} m")

    def _solve(self) -> tuple[Figures, int]:
        """Solve for `_unknown`, through the stages of the continuation where elements start inverted."""
        stages = [*self._stages, Stage()] if self._stages and self._count_inverted() else [Stage()]
        total = Figures()
        for stage in stages:
            self.laws.stage(stage.poisson_ratio, stage.threshold)
            last = stage is stages[-1]
            try:
                total = total + self._newton.solve(self._unknown, self.tolerance, self._iterations - total.newton)
            finally:
                if last:
                    self.laws.stage()
            if last and total.reason <= 0:
                raise StepFailure(self._why(total))
        return total, len(stages)

    def _count_inverted(self) -> int:
        self.laws.update()
        return self.comm.allreduce(int((self._determinants() < 0).sum()))

    def _determinants(self) -> NDArray:
        d = self.space.dimension
        return np.linalg.det(self.laws.gradient.reshape(-1, d, d) + np.eye(d))

    def _why(self, figures: Figures) -> str:
        """Reasons of the solvers and the worst element."""
        words = f"{self._newton.reasons()} after {figures.newton} Newton iterations, |F| = {figures.residual:.3g} N"
        words += f" (wanted {self.tolerance:.3g})"
        self._set(self.space.u, self._unknown)
        self.laws.update()
        stretches = self.laws.stretches()
        J = stretches.prod(axis=1)
        worst = (np.inf, 0, (), ())
        if len(J):
            k = int(np.argmin(np.where(np.isfinite(J), J, -np.inf)))
            cell = self.space.point_cells[k]
            place = tuple(self.space.midpoints()[cell][: self.space.dimension])
            worst = (float(J[k]), int(self.space.domain.original_cells[cell]), tuple(stretches[k]), place)
        J_worst, element, s, x = min(self.comm.allgather(worst), key=lambda w: w[0])
        return (
            f"{words}; worst element {element} at ({', '.join(f'{c:.3g}' for c in x)}) m: J = {J_worst:.3g}, "
            f"stretches {', '.join(f'{c:.3g}' for c in s)}"
        )

    def _report(self, iteration: int, norm: float) -> None:
        if self.on_iteration is None:
            return
        J = self._determinants()
        inverted = self.comm.allreduce(int((J.reshape(-1) < 0).sum()))
        self.on_iteration({"iteration": iteration, "residual": norm, "inverted": inverted})

    # ------------------------------------------------------------------ what the session asks

    def diagnostics(self) -> dict[str, float]:
        """Energies [J], smallest J and stretch, inverted elements and what the last step took."""
        self.space.u.x.array[:] = self.motion.u
        self.laws.update(energy=True)
        self._vector_from(self.motion.u, self._unknown)
        elastic = self.comm.allreduce(self._sum(self.laws.energy.x.array))
        skipped = self.comm.allreduce(self.laws.skipped) / max(1, self.comm.allreduce(len(self._weights)))
        stretches = self.laws.stretches()
        J = stretches.prod(axis=1)
        inverted = np.unique(self.space.point_cells[J < 0]).size
        loads = -self._load.dot(self._unknown)
        kinetic = 0.0
        if self._scheme is not None:
            self._vector_from(self.motion.v, self._work)
            self._mass.mult(self._work, self._product)
            kinetic = 0.5 * self._work.dot(self._product)
        size = self.space.dimension
        moved = np.linalg.norm(self.motion.u.reshape(-1, size), axis=1).max(initial=0)
        return {
            "time": self.time,
            "energy": elastic + loads + kinetic,
            "elastic_energy": elastic,
            "kinetic_energy": kinetic,
            "inverted": self.comm.allreduce(int(inverted)),
            "smallest_J": self.comm.allreduce(float(J.min(initial=np.inf)), op=MPI.MIN),
            "smallest_stretch": self.comm.allreduce(float(stretches[:, -1].min(initial=np.inf)), op=MPI.MIN),
            "residual": self._figures.residual,
            "newton_iterations": self._figures.newton,
            "krylov_iterations": self._figures.krylov,
            "svd_skipped": skipped,
            "max_displacement": self.comm.allreduce(float(moved), op=MPI.MAX),
        }

    def _vector_from(self, values: NDArray, out: PETSc.Vec) -> None:
        out.array[:] = values[: self._owned]

    def state(self) -> dict[str, NDArray]:
        """All that a restart needs, on rank 0 in canonical order; {} elsewhere."""
        kept = {name: getattr(self.motion, name) for name in ("u", "v", "a", "u_old", "v_old")}
        function = fem.Function(self.space.vectors)
        out: dict[str, NDArray] = {}
        for name, values in kept.items():
            if values is None:
                continue
            function.x.array[:] = values
            gathered = self.space.gather_nodes(function)
            if gathered is not None:
                out[name] = gathered
        if self.comm.rank == 0:
            out["dt_old"] = np.array([self.motion.dt_old])
        return out

    def restore(self, state: dict[str, NDArray]) -> None:
        """Take over what `state` gave, on any number of ranks."""
        names = self.comm.bcast(sorted(state))
        function = fem.Function(self.space.vectors)
        values: dict[str, Any] = {}
        for name in names:
            if name == "dt_old":
                values[name] = float(self.comm.bcast(state[name][0] if self.comm.rank == 0 else None))
                continue
            self.space.scatter_nodes(state.get(name), function)
            values[name] = function.x.array.copy()
        self.motion = Motion(**values)
        self.space.u.x.array[:] = self.motion.u

    def geometry(self) -> tuple[NDArray, NDArray, str] | None:
        """Reference points, cells and their meshio name on rank 0."""
        return self.space.geometry()

    def fields(self, names: Sequence[str] | None = None) -> tuple[dict, dict] | None:
        """Point and cell data on rank 0: displacement [m], velocity [m/s] and those of `names` (default all)."""
        from .fields import fields

        return fields(self, names)
