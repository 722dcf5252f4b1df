"""The snow problem: one step of the material point method (7.3.1), as the session drives it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray
from petsc4py import PETSc

from extremal.obstacles.colliders import Collider

from . import gradients, implicit, kernel, measures
from .colliders import collide
from .decomposition import Decomposition
from .grid import Grid
from .law import Law, table
from .limits import StepFailure, check
from .moduli import Moduli
from .particles import Particles
from .sharing import Sharing

if TYPE_CHECKING:
    from .exchange import Exchange

EXPLICIT_WAVE = 0.3  # cells that an elastic wave may cross in an explicit step
IMPLICIT_WAVE = 8.0  # and in an implicit one: linearised once, it gains energy from about 16
STRAY = 0.005  # of a rank's particles that may be in cells of other ranks
ROUNDING = 1e3  # roundings of a right-hand side that is nothing else
NOTHING = np.zeros(())  # mass attached to nodes [kg]
REBALANCE = 1.3  # imbalance at which space is cut anew


class SnowProblem:
    """Bodies of snow on a background grid.

    Parameters
    ----------
    comm : mpi4py.MPI.Comm
    particles : Particles
        Any share of all particles on each rank; they are sent where they belong.
    laws : sequence of Law
        `particles.body` chooses among them.
    cell_size : float
        h [m].
    gravity : sequence of float or None
        [m/s²]
    colliders : sequence of Collider
    spline : str
        "cubic" or "quadratic".
    beta : float
        0 explicit, 1/2 trapezoidal, 1 backward Euler.
    flip : float
        α of step 8: the share of FLIP.
    cfl : float
        Largest |v| dt/h.
    precision : str
        "double" or "single", of the implicit operator.
    rebalance : float
        Imbalance at which space is divided anew.
    with_gradients : bool
        Whether particles carry F_E and F_P, which only cost time: nothing depends on them.

    Attributes
    ----------
    exchange : Exchange or None
        An elastic body that snow meets before the colliders; None: there is none.
    """

    def __init__(
        self,
        comm: MPI.Comm,
        particles: Particles,
        laws: Sequence[Law],
        *,
        cell_size: float,
        gravity: Sequence[float] | None = None,
        colliders: Sequence[Collider] = (),
        spline: str = "cubic",
        beta: float = 1.0,
        flip: float = 0.95,
        cfl: float = 0.5,
        precision: str = "double",
        rebalance: float = REBALANCE,
        with_gradients: bool = False,
    ) -> None:
        self.comm, self.time, self.h = comm, 0.0, cell_size
        self.on_iteration: Callable[[dict[str, float]], None] | None = None
        self.exchange: Exchange | None = None
        self.laws, self._table = tuple(laws), table(laws)
        self._gravity = None if gravity is None else np.asarray(gravity, dtype=float)
        self._colliders, self._beta, self._flip = tuple(colliders), beta, flip
        self._cfl, self._rebalance = cfl, rebalance
        d = particles.dimension
        self._kernel = kernel.load(comm, d, spline)
        self._operator_kernel = self._kernel
        if beta and precision == "single":
            self._operator_kernel = kernel.load(comm, d, spline, "single")
        if with_gradients:
            particles.carry_gradients()
        self._space = Decomposition(comm, cell_size, particles)
        self.particles = self._space.migrate(particles)
        self.size = comm.allreduce(len(particles))
        self._mass = comm.allreduce(float(particles.mass.sum()))
        self._dissipated = 0.0  # on this rank
        self._measured = False  # whether particles have volumes
        self._known: Moduli | None = None
        self._nodes = 0  # that this rank owns
        self._figures = {"krylov_iterations": 0.0, "dt": 0.0}
        present = {
            "plasticity": any(law.is_plastic for law in laws),
            "hardening": any(law.is_plastic and law.hardening for law in laws),
            "implicit": beta > 0,
            "gravity": gravity is not None,
            "colliders": bool(colliders),
            "gradients": with_gradients,
        }
        on = ["snow", *(name for name, there in present.items() if there)]
        self.effects: dict[str, dict[str, Any]] = {name: {} for name in on}
        names = ("grid", "to_grid", "force", "to_particles", "flow", "migrate")
        self._events = {name: PETSc.Log.Event(f"snow:snow:{name}") for name in names}
        self._events |= {name: PETSc.Log.Event(f"snow:{name}") for name in ("implicit", "colliders", "gradients")}
        self._events["solid"] = PETSc.Log.Event("snow:solid:collisions")

    # ------------------------------------------------------------------ a step

    def advance(self, dt: float) -> dict[str, float]:
        """One step of 7.3.1.

        Returns
        -------
        dict
            krylov_iterations and wanted_step, the longest step [s] the new velocities allow.

        Raises
        ------
        StepFailure
            On all ranks, with the state as before: the step is too long for the velocities or deforms too much.
        """
        longest = self._longest_step()
        if dt > longest * (1 + 1e-9):
            raise StepFailure(f"particles or waves cross too many cells: dt {dt:.3g} is above {longest:.3g}", longest)
        with self._events["migrate"]:
            self._arrange()
        with self._events["grid"]:
            grid = self._grid()
            sharing = Sharing(grid, self._space)
        try:
            iterations = self._step(grid, sharing, dt)
        finally:
            sharing.destroy()
        self.time += dt
        self._nodes = len(sharing.node[sharing.owned])
        self._figures = {"krylov_iterations": float(iterations), "dt": dt}
        return {"krylov_iterations": float(iterations), "wanted_step": self._longest_step()}

    def _grid(self) -> Grid:
        """This rank's grid; FloatingPointError on all ranks where one of them has a particle that is nowhere."""
        grid, words = None, ""
        try:
            grid = Grid(self._kernel, self.h, self.particles)
        except FloatingPointError as error:
            words = str(error)
        if any(self._largest(float(grid is None))):
            raise FloatingPointError(self.comm.allreduce(words, op=MPI.MAX))
        assert grid is not None
        return grid

    def _step(self, grid: Grid, sharing: Sharing, dt: float) -> int:
        p, d, n = self.particles, self.particles.dimension, sharing.count
        mass, old = np.zeros(n), np.zeros((n, d))
        with self._events["to_grid"]:
            grid.call("to_grid", p.position, p.velocity, p.mass, mass, old)
            sharing.sum_to_owners(mass)
            sharing.sum_to_owners(old)
            sharing.from_owners(mass)
            heavy = np.where(mass > 0, mass, 1.0)[:, None]
            old /= heavy
            sharing.from_owners(old)
        if not self._measured:
            self._measure_volumes(grid, mass)
        moduli = self._moduli().values
        force = np.zeros((n, d))
        with self._events["force"]:
            grid.call("force", p.position, p.stretch, moduli, force)
            sharing.sum_to_owners(force)
        owned = sharing.owned
        new = old.copy()
        new[owned] += dt * force[owned] / heavy[owned]
        if self._gravity is not None:
            new[owned] += dt * self._gravity[:d]
        own, free, attached = mass[owned], np.ones(len(new[owned]), dtype=bool), NOTHING
        meets_something = self._colliders or self.exchange is not None
        if meets_something:
            new[owned], free, attached = self._collide(sharing.node[owned] * self.h, new[owned], own, dt)
        iterations = 0
        if self._beta:
            with self._events["implicit"]:
                iterations = self._implicit(grid, sharing, moduli, own, new, free, attached, dt)
        sharing.from_owners(new)
        velocity, gradient, extremes = np.empty((len(p), d)), np.empty((len(p), d * d)), np.empty(3)
        with self._events["to_particles"]:
            grid.call(
                "to_particles", p.position, new, old, float(self._flip), float(dt), p.velocity, velocity, gradient,
                extremes,
            )  # fmt: skip
        self._check(extremes, dt)
        with self._events["flow"]:
            dissipated = np.zeros(1)
            self._kernel.call(
                "flow", len(p), gradient, float(dt), p.volume, p.stiffness, p.body, self._table, p.stretch, p.plastic,
                dissipated,
            )  # fmt: skip
            self._dissipated += float(dissipated[0])
        if p.elastic_gradient is not None:
            with self._events["gradients"]:
                gradients.follow(p, gradient, dt)
        if meets_something:
            velocity, *_ = self._collide(p.position, velocity, p.mass, dt)
        p.velocity = np.ascontiguousarray(velocity)
        self._kernel.call("move", len(p), float(dt), p.velocity, p.position)
        self._known = None
        return iterations

    def _collide(self, x: NDArray, v: NDArray, mass: NDArray, dt: float) -> tuple[NDArray, NDArray, NDArray]:
        """Velocities of nodes or particles after collisions, which are free, what mass [kg] is attached to each."""
        if self.exchange is not None:
            with self._events["solid"]:
                return self.exchange.collide(self._colliders, x, v, mass, self.time + dt)
        with self._events["colliders"]:
            after, hit = collide(self._colliders, x, v, self.time + dt)
            return after, ~hit, NOTHING

    def _measure_volumes(self, grid: Grid, mass: NDArray) -> None:
        """Step 2 of 7.3.1, in the first step of all (collective)."""
        p = self.particles
        if not self.comm.allreduce(bool(p.volume.all()), op=MPI.LAND):
            density = np.empty(len(p))
            grid.call("density", p.position, mass, density)
            p.volume[:] = p.mass / density
            self._known = None
        self._measured = True

    def _implicit(
        self,
        grid: Grid,
        sharing: Sharing,
        moduli: NDArray,
        mass: NDArray,
        new: NDArray,
        free: NDArray,
        attached: NDArray,
        dt: float,
    ) -> int:
        operator = implicit.Operator(
            self.particles, grid, sharing, self._operator_kernel, moduli, mass + attached, self._beta * dt**2, free
        )
        right = -operator.hessian(new[sharing.owned])
        right[~free] = 0
        rounding = self._rounding(sharing, mass, new, dt)
        if not np.isfinite(rounding):  # PETSc 3.22 has no such tolerance
            raise StepFailure("velocities are not finite", dt / 4)
        delta, iterations, reason = implicit.solve(operator, right, rounding, self.comm)
        if reason < 0:
            raise StepFailure(f"KSP ended with reason {reason} after {iterations} iterations", dt / 2)
        new[sharing.owned] += delta
        if self.exchange is not None:
            self.exchange.follow(delta, mass, attached)
        return iterations

    def _rounding(self, sharing: Sharing, mass: NDArray, velocity: NDArray, dt: float) -> float:
        """What rounding alone leaves of the right-hand side, in the natural norm [kg^½ m/s].

        Each node's velocity is rounded by ε |v|, β Δt² M⁻¹ H makes of it about β (c Δt/h)² as much.
        """
        energy = self.comm.allreduce(float(mass @ (velocity[sharing.owned] ** 2).sum(axis=1)))
        (wave,) = self._largest(self._moduli().wave)
        growth = self._beta * (wave * dt / self.h) ** 2
        return ROUNDING * np.finfo(self._operator_kernel.real).eps * growth * float(np.sqrt((1 + growth) * energy))

    def _check(self, extremes: NDArray, dt: float) -> None:
        """Refuse a step that deforms a particle too much or is not finite; nothing has been changed yet.

        Parameters
        ----------
        extremes : (3,)
            Of this rank's particles: see `to_particles` in kernel.c.
        """
        # nan does not survive a reduction: each rank looks at its own
        bad = len(self.particles) > 0 and not np.isfinite(extremes).all()
        squeeze, turn, fastest, anywhere = self._largest(*extremes, float(bad))
        if anywhere:
            raise StepFailure("velocities are not finite", dt / 4)
        check(-squeeze, turn, fastest * dt / self.h, self._cfl, dt)

    def _largest(self, *values: float) -> list[float]:
        """Of each value the largest of all ranks."""
        all_ranks = np.array(values)
        self.comm.Allreduce(MPI.IN_PLACE, all_ranks, op=MPI.MAX)
        return all_ranks.tolist()

    def _moduli(self) -> Moduli:
        if self._known is None or not self._known.belong_to(self.particles):
            self._known = Moduli.of(self._kernel, self.particles, self._table)
        return self._known

    def _longest_step(self) -> float:
        """Longest step [s] that the velocities and the elastic waves, hardening included, allow."""
        moduli = self._moduli()
        fastest, wave = self._largest(moduli.speed, moduli.wave)
        longest = self._cfl * self.h / fastest if fastest > 0 else np.inf
        cells = IMPLICIT_WAVE if self._beta else EXPLICIT_WAVE
        return min(longest, cells * self.h / (wave or 1.0))

    def _arrange(self) -> None:
        """Particles where they belong; space is cut anew where one rank has too many."""
        if self.comm.size == 1:
            return
        before = self.particles
        self.particles = self._space.migrate(before, STRAY)
        if self.particles is before:
            return
        if self._space.imbalance(len(self.particles)) > self._rebalance:
            self._space = Decomposition(self.comm, self.h, self.particles)
            self.particles = self._space.migrate(self.particles)

    # ------------------------------------------------------------------ what the session asks

    def diagnostics(self) -> dict[str, float]:
        """Conserved quantities and energies [SI]; raises LostParticles on all ranks where a particle has been lost."""
        p = self.particles
        found = measures.conserved(self.comm, p)
        count, mass = found["particles"], found["mass"]
        if count != self.size or not abs(mass - self._mass) <= measures.SAME_MASS * self._mass:
            raise measures.LostParticles(
                f"{self.size - count:g} of {self.size} particles were lost, {self._mass:g} kg became {mass:g} kg"
            )
        energy = measures.energies(self.comm, p, self._kernel, self._table, self._gravity)
        speed = self.comm.allreduce(float(np.linalg.norm(p.velocity, axis=1).max(initial=0)), op=MPI.MAX)
        return {"time": self.time} | found | energy | {
            "plastic_dissipation": self.comm.allreduce(self._dissipated),
            "energy": sum(energy.values()),
            "largest_speed": speed,
            **self._figures,
            "active_nodes": float(self.comm.allreduce(self._nodes)),
            "imbalance": self._space.imbalance(len(p)),
        }

    def _gathered(self) -> dict[str, NDArray] | None:
        """All particles in the order of seeding, on rank 0."""
        parts = self.comm.gather(self.particles.arrays())
        if parts is None:
            return None
        whole = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
        order = np.argsort(whole["ident"], kind="stable")
        return {name: values[order] for name, values in whole.items()}

    def state(self) -> dict[str, NDArray]:
        """All that a restart needs, on rank 0 in the order of seeding; {} elsewhere."""
        whole, dissipated = self._gathered(), self.comm.allreduce(self._dissipated)
        return {} if whole is None else whole | {"dissipated": np.array([dissipated])}

    def restore(self, state: dict[str, NDArray]) -> None:
        """Take over what `state` gave, on any number of ranks; raises ValueError on all where it gave too little."""
        rank, wanted = self.comm.rank, self.particles.arrays()
        missing = self.comm.bcast([name for name in wanted if name not in state] if rank == 0 else None)
        if missing:
            raise ValueError(f"has no {' and no '.join(missing)}; accepted is a checkpoint with what is to be written")
        arrays = {name: values for name, values in state.items() if name in wanted}
        parts = None
        if rank == 0:
            cuts = np.array_split(np.arange(len(arrays["ident"])), self.comm.size)
            parts = [Particles(**{name: np.ascontiguousarray(a[c]) for name, a in arrays.items()}) for c in cuts]
        particles = self.comm.scatter(parts)
        self._space = Decomposition(self.comm, self.h, particles)
        self.particles = self._space.migrate(particles)
        self._dissipated = float(state["dissipated"][0]) if rank == 0 else 0.0
        self._measured = False

    def geometry(self) -> None:
        """There is no mesh: particles move."""
        return None

    def fields(self, names: Sequence[str] | None = None) -> None:
        """There is no mesh: see `particle_fields`."""
        return None

    def particle_fields(self, names: Sequence[str] | None = None) -> dict[str, NDArray] | None:
        """On rank 0, in the order of seeding: points (n, 3) [m] and what `names` asks for (default all)."""
        whole = self._gathered()
        if whole is None:
            return None
        return {
            name: values
            for name, values in measures.shown(whole, self.laws).items()
            if names is None or name in ("points", *names)
        }
