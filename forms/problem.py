"""The elastic problem: what the session drives."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

from extremal.meshes import Domain

from . import initial
from .conditions import Constraints, Prescribed
from .constitutive import Constitutive, agree
from .diagnostics import diagnostics, why
from .equations import Equations, Load, event
from .integrators import INTEGRATORS, Motion, Scheme
from .material import Material
from .newton import Figures, Newton, StepFailure, regime
from .prediction import coast, follow_boundary
from .space import Space
from .state import gather, scatter

if TYPE_CHECKING:
    from extremal.obstacles.colliders import Collider

    from .contacts import Contacts

# most solves of a step with friction after the first: its forces follow those of the solve before
LAGS, DYNAMIC_LAGS = 10, 1  # within short steps normal forces change little


@dataclass(frozen=True)
class Stage:
    """One solve of a continuation: ν at most `poisson_ratio`, ε = `threshold`; None leaves the material's own."""

    poisson_ratio: float | None = None
    threshold: float | None = None


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
        Functions of (positions (n, d) [m], time) giving (n, d) or (n,) [Pa].
    gravity : sequence of float or None
        Acceleration [m/s²].
    body_force : callable or None
        Function of (positions (n, d) [m], time) giving (n, d) [N/m³].
    integrator : str or None
        None for equilibrium; else a name in `INTEGRATORS`.
    damping : (float, float)
        Rayleigh factors of mass [1/s] and stiffness [s].
    stages : sequence of Stage
        Easier problems solved first where elements are inverted, or where the direct solve fails. This
        continuation is ours, not the source's.
    tolerance : float
        Largest |F| relative to E·V^((d-1)/d).
    iterations : int
        Most Newton iterations of one attempt, over all its stages.
    exact_tangent : bool
        Never project the tangent.
    error_tolerance : float or None
        Largest local error [m] of an accepted dynamic step.
    obstacles : sequence of Collider
        What the body's surface cannot enter.
    contact : mapping
        distance, stiffness, after, self, friction: see `made` in `contacts`.
    """

    def __init__(
        self,
        domain: Domain,
        materials: Mapping[str, Material],
        *,
        degree: int = 1,
        prescribed: Sequence[Prescribed] = (),
        tractions: Sequence[Load] = (),
        pressures: Sequence[Load] = (),
        gravity: Sequence[float] | None = None,
        body_force: Callable[[NDArray, float], NDArray] | None = None,
        integrator: str | None = None,
        damping: tuple[float, float] = (0.0, 0.0),
        stages: Sequence[Stage] = (),
        tolerance: float = 1e-8,
        iterations: int = 150,
        exact_tangent: bool = False,
        error_tolerance: float | None = None,
        obstacles: Sequence[Collider] = (),
        contact: Mapping[str, Any] | None = None,
    ) -> None:
        self.comm = domain.mesh.comm
        self.time = 0.0
        self.on_iteration: Callable[[dict[str, float]], None] | None = None
        self.on_solved: Callable[[float], None] | None = None  # told of each step [s] with its loads still in force
        self.space = Space(domain, degree)
        self.laws = Constitutive(self.space, materials)
        self.constraints = agree(self.comm, lambda: Constraints(self.space, prescribed))
        self.scheme = INTEGRATORS[integrator]() if integrator else None
        self._stages, self._iterations = tuple(stages), iterations
        self._exact, self._error_tolerance = exact_tangent, error_tolerance
        self.equations = Equations(
            self.space,
            self.laws,
            self.constraints,
            inertia=self.scheme is not None,
            damping=damping,
            gravity=gravity,
            body_force=body_force,
            tractions=tractions,
            pressures=pressures,
        )
        self.contact: Contacts | None = None
        if obstacles or (contact or {}).get("self"):
            from . import contacts

            held, stiff = self.constraints.dofs, self.laws.stiffness_scale()
            self.contact = contacts.made(self.space, obstacles, held, stiff, **contact or {})
            self.equations.meet(self.contact)
        d = self.space.dimension
        volume = self.comm.allreduce(float(self.equations.weights.sum()))
        self.tolerance = tolerance * self.laws.stiffness_scale() * volume ** ((d - 1) / d)
        self.unknown, self.size = self.equations.vector.duplicate(), self.equations.vector.getSize()
        self._newton: Newton | None = None
        self._figures = Figures()
        self._continuation = event("continuation") if stages else None
        zeros = np.zeros_like(self.space.u.x.array)
        self.motion = Motion(zeros.copy(), zeros.copy())
        present = {
            "elasticity": True,
            "extension": self.laws.is_extended,
            "inertia": self.scheme is not None,
            "gravity": gravity is not None,
            "body_force": body_force is not None,
            "damping": any(damping),
            "traction": bool(tractions),
            "pressure": bool(pressures),
            "continuation": bool(stages),
            "contact": bool(obstacles),
            "self_contact": self.contact is not None and self.contact.surface is not None,
        }
        self.effects: dict[str, dict[str, Any]] = {name: {} for name, there in present.items() if there}

    @property
    def is_dynamic(self) -> bool:
        """Whether there is inertia."""
        return self.scheme is not None

    # ------------------------------------------------------------------ where it starts

    def start(self, state: str = "rest", velocity: Callable[[NDArray], NDArray] | None = None, **how: Any) -> None:
        """Put the body in a state ("rest", "scatter", "collapse", "mirror", "affine") and give it a velocity [m/s].

        `how` goes to the function of that name in `initial`. Prescribed displacements hold from the start.
        """
        u = self.space.u.x.array
        u[:] = 0
        if state != "rest":
            getattr(initial, state)(self.space, **how)
        self.constraints.apply(u, self.time)
        if self.contact is not None:
            self.contact.check(u)
        self.motion = Motion(u.copy(), np.zeros_like(u))
        if velocity is not None:
            self.motion.v[:] = np.asarray(velocity(self.space.positions)).ravel()
        self.equations.set_time(self.time)
        if self.scheme is None:
            return
        acceleration = np.zeros_like(u)
        self.constraints.rates(self.time, self.motion.v, acceleration)
        if self.scheme.needs_acceleration:
            self.motion.a = self.equations.acceleration(self.motion.u, self.motion.v, acceleration)
            u[:] = self.motion.u

    # ------------------------------------------------------------------ a step

    def advance(self, dt: float) -> dict[str, float]:
        """One load or time step.

        Parameters
        ----------
        dt : float
            Length of the step [s].

        Returns
        -------
        dict
            newton_iterations, krylov_iterations, stages; wanted_step [s] where the local error is controlled.

        Raises
        ------
        StepFailure
            On all ranks; the state is that before the step.
        """
        before = self.motion
        try:
            figures, stages, wanted = self._step(before, dt)
        except StepFailure as failure:
            self.space.u.x.array[:] = before.u
            if self._stands_still(before.u, dt):
                failure.wanted_step = np.inf
            raise
        finally:
            self.equations.terms = None
        self._figures = figures
        self.time += dt
        report = {"newton_iterations": figures.newton, "krylov_iterations": figures.krylov, "stages": stages}
        return report | ({"wanted_step": wanted} if wanted is not None else {})

    def _stands_still(self, u: NDArray, dt: float) -> bool:
        """Whether a step of any length is the same static problem."""
        if self.is_dynamic or self.equations.pressures or not (self.contact is None or self.contact.at_rest):
            return False
        moved = u.copy()
        self.constraints.apply(moved, self.time + dt)
        self.equations.set_time(self.time + dt)
        change = self.equations.load.copy()
        self.equations.set_time(self.time)
        change.axpy(-1.0, self.equations.load)
        difference = max(change.norm(), float(np.abs(moved - u).max(initial=0)))
        change.destroy()
        return self.comm.allreduce(difference, op=MPI.MAX) == 0

    def _step(self, before: Motion, dt: float) -> tuple[Figures, int, float | None]:
        u = self.space.u.x.array
        terms = self.scheme.terms(before, dt) if self.scheme is not None else None
        self.equations.begin(terms, before.u)
        part = terms.stage if terms is not None else 1.0
        self.equations.set_time(self.time + part * dt)
        start = self._meet_obstacles(before.u, self.time + part * dt)
        moved = before.u.copy()
        self.constraints.apply(moved, self.time + dt)
        moved = start + part * (moved - before.u)

        newton = self._solver(before.u)
        guess = follow_boundary(self.equations, newton, start, moved)
        if self.contact is not None and not self._is_free(start, guess):
            guess = moved
            if not self._is_free(start, guess):
                raise StepFailure("parts of the surface would meet as the boundary moves")
        guess = coast(self.equations, start, guess, terms)
        figures, stages = self._solve(newton, guess)
        for _ in range(DYNAMIC_LAGS if self.is_dynamic else LAGS):
            self.equations.set(self.unknown)
            if self.contact is None or self.contact.follow():
                break
            again, _ = self._solve(newton, u.copy())
            figures = figures + again
        self.equations.set(self.unknown)
        if self.on_solved is not None:
            self.on_solved(dt)
        if self.scheme is None:
            self.motion = replace(before, u=u.copy())
            return figures, stages, None
        new = self.scheme.finish(before, u.copy(), dt)
        if self.contact is not None:
            self.contact.set_time(self.time + dt)
            if not self.contact.fits(new.u):
                raise StepFailure("something would be entered by the end of the step")
        wanted = self._check_error(self.scheme, before, new, dt)
        self.motion = new
        u[:] = new.u
        return figures, stages, wanted

    def _is_free(self, start: NDArray, end: NDArray) -> bool:
        """Whether the body can go straight from one displacement to the other (local values)."""
        assert self.contact is not None
        self.contact.search_from(start)
        return self.contact.fits(end)

    def _meet_obstacles(self, u: NDArray, time: float) -> NDArray:
        """`u` with the nodes moved that obstacles at `time` would be upon; contact begins where it waits to."""
        if self.contact is None:
            return u
        self.space.u.x.array[:] = u
        untangled = not self.contact.active and self._count_inverted() == 0
        return self.contact.begin(u, self.time, time, untangled)

    def _solver(self, start: NDArray) -> Newton:
        """The SNES, made at the first step, when it is known what the body is like."""
        if self._newton is None:
            self.space.u.x.array[:] = start
            name = regime(
                tangled=self._count_inverted() > 0,
                poisson_ratio=self.laws.largest_poisson_ratio(),
                unknowns=self.equations.vector.getSize(),
                symmetric=not self.equations.pressures,
            )
            self._newton = Newton(self.equations, name, self._exact)
            self.effects["elasticity"]["solver"] = name
            self._newton.on_iteration = self._report
        return self._newton

    def _solve(self, newton: Newton, guess: NDArray) -> tuple[Figures, int]:
        """Solve from `guess`: directly, or through the stages where elements start inverted or that fails."""
        self.space.u.x.array[:] = guess
        inverted = self._count_inverted() > 0
        attempts: list[list[Stage]] = [[Stage()]]
        if self._stages:
            staged = [*self._stages, Stage()]
            attempts = [staged] if inverted else [[Stage()], staged]
        total = Figures()
        for stages in attempts:
            self.unknown.array[:] = guess[: self.equations.owned]
            if self.contact is not None:
                self.contact.search_from(guess)
            found = self._through(newton, stages)
            total = total + found
            if found.reason > 0:
                return total, len(stages)
        raise StepFailure(why(self, newton, total))

    def _through(self, newton: Newton, stages: Sequence[Stage]) -> Figures:
        total = Figures()
        try:
            for stage in stages[:-1]:
                assert self._continuation is not None
                with self._continuation:
                    self.laws.stage(stage.poisson_ratio, stage.threshold)
                    total = total + newton.solve(self.unknown, self.tolerance, self._iterations - total.newton)
        finally:
            self.laws.stage()
        return total + newton.solve(self.unknown, self.tolerance, max(1, self._iterations - total.newton))

    def _check_error(self, scheme: Scheme, before: Motion, new: Motion, dt: float) -> float | None:
        """The step [s] that the local error asks for next; refuses this one where the error is too large."""
        if self._error_tolerance is None:
            return None
        error = self.comm.allreduce(float(scheme.error(before, new, dt).max(initial=0)), op=MPI.MAX)
        ratio = self._error_tolerance / error if error > 0 else np.inf
        wanted = dt * float(np.clip(0.9 * ratio ** (1 / (scheme.order + 1)), 0.1, 2.0))
        if error > self._error_tolerance:
            words = f"local error {error:.3g} m is above error_tolerance = {self._error_tolerance:g} m"
            raise StepFailure(words, wanted_step=wanted)
        return wanted

    def _count_inverted(self) -> int:
        """Quadrature points with J < 0 at the displacement of the space."""
        self.space.gradient(self.laws.gradient)
        return self.comm.allreduce(int((self.laws.determinants() < 0).sum()))

    def _report(self, iteration: int, norm: float) -> None:
        """Tell the session of an iterate; SNES has just evaluated the residual there."""
        if self.on_iteration is None:
            return
        figures = {"iteration": iteration, "residual": norm}
        if self.equations.has_energy:
            figures["energy"] = self.equations.energy(self.unknown)
        J = self.laws.determinants()
        inverted = int(np.unique(self.space.point_cells[J < 0]).size)
        figures["inverted"] = self.comm.allreduce(inverted)
        self.on_iteration(figures)

    # ------------------------------------------------------------------ what the session asks

    def diagnostics(self) -> dict[str, float]:
        """Energies [J], smallest J and stretch, inverted elements, contact and what the last step took."""
        return diagnostics(self, self._figures)

    def state(self) -> dict[str, NDArray]:
        """All that a restart needs, on rank 0 in canonical order; {} elsewhere."""
        out = gather(self.space, self.motion)
        if out and self.contact is not None:
            out["contact"] = np.array([self.contact.active])
        return out

    def restore(self, state: dict[str, NDArray]) -> None:
        """Take over what `state` gave, on any number of ranks."""
        if self.contact is not None:
            self.contact.active = self.comm.bcast(bool(state["contact"][0]) if state else None)
        self.motion = scatter(self.space, {name: values for name, values in state.items() if name != "contact"})
        self.space.u.x.array[:] = self.motion.u

    def geometry(self) -> tuple[NDArray, NDArray, str] | None:
        """Reference points, cells and their meshio name on rank 0."""
        return self.space.geometry()

    def fields(self, names: Sequence[str] | None = None) -> tuple[dict, dict] | None:
        """Point and cell data on rank 0: displacement [m], velocity [m/s] and those of `names` (default all)."""
        from .fields import fields

        return fields(self, names)

    def destroy(self) -> None:
        """Free the PETSc objects; solvers hold on to the problem, so that nothing else would."""
        if self._newton is not None:
            self._newton.destroy()
        self.equations.destroy()
        self.unknown.destroy()
