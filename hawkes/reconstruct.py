"""Method (3.5): the weights that maximise the energy, by TAO."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray
from petsc4py import PETSc

from extremal.native.options import defaults

from . import kernel
from .energy import Energy
from .events import DataError
from .slots import Slots

PREFIX = "hawkes_"
DEFAULTS = {
    "tao_type": "blmvm",
    "tao_max_it": 2000,
    # the Hessian is a product only
    "pc_type": "none",
    "tao_bnk_pc_type": "none",
}
BOUNDED = ("blmvm", "bncg", "bqnls", "bqnkls", "bqnktl", "bqnktr", "tron", "bnls", "bntl", "bntr")
NEWTON = ("tron", "bntr", "bntl", "bnls")
ATTEMPTS = 3  # of TAO, after sweeps that take it away from where it gave up
WORTHWHILE = 10.0
LIFT = 1e-8  # of the weight that a sweep would give: a slot at its bound has infinite slope in y = x²


class ReconstructionError(ArithmeticError):
    """The maximum was not reached; the message says why TAO stopped, and where it stands.

    Attributes
    ----------
    reached : Reconstruction
        Where it stands.
    """

    reached: Reconstruction


def check_options() -> None:
    """Raise DataError if the options ask for a type of TAO that cannot keep weights from falling below 0."""
    kind = PETSc.Options(PREFIX).getString("tao_type", str(DEFAULTS["tao_type"]))
    if kind not in BOUNDED:
        raise DataError(f"-{PREFIX}tao_type {kind}: must be one of {', '.join(BOUNDED)}, which keep bounds")


@dataclass(frozen=True)
class Reconstruction:
    """Weights of (3.5) and how good they are.

    Attributes
    ----------
    weights : (S,)
        x of this rank's slots; those of an event have unit length.
    energy : float
        Λ of (3.20).
    gap : float
        Proven bound of Λ* - Λ.
    iterations : int
        Of TAO.
    reason : str
        Why TAO stopped.
    seconds : float
    """

    weights: NDArray
    energy: float
    gap: float
    iterations: int
    reason: str
    seconds: float

    @property
    def relative_gap(self) -> float:
        """Gap over energy."""
        return self.gap / self.energy if self.energy > 0 else 0.0


def reconstruct(
    slots: Slots,
    *,
    gap: float = 1e-8,
    sweeps: int = 5,
    start: NDArray | None = None,
    monitor: Callable[[dict[str, float]], None] | None = None,
) -> Reconstruction:
    """Solve (3.5) (collective).

    A few sweeps over the events come first; where events are strongly coupled they slow down, and TAO goes on with
    z >= 0 and x_j = z_j/|z_j|, which makes (3.5) bound-constrained.

    Parameters
    ----------
    slots : Slots
    gap : float
        Largest relative gap, proven by `Energy.gap`, at which to stop.
    sweeps : int
        Rounds of `Energy.sweep` before TAO, and as many again as long as they divide the gap by `WORTHWHILE`.
    start : (S,), optional
        Weights to begin with; equal ones otherwise.
    monitor : callable, optional
        Called with {"iteration", "energy", "residual", "gap"} (gap: the last one worked out).

    Returns
    -------
    Reconstruction

    Raises
    ------
    ReconstructionError
        On all ranks, where the gap is not reached.
    """
    began = time.perf_counter()
    energy = Energy(slots)
    solver = _Solver(energy, gap, monitor)
    try:
        x = solver.sweep(_lifted(energy, slots.uniform() if start is None else start), sweeps)
        for attempt in range(ATTEMPTS):
            if attempt:
                x = energy.sweep(x, 20)
            x = solver.solve(x)
            if solver.certified:
                break
    finally:
        solver.destroy()
    result = Reconstruction(x, solver.value, solver.gap, solver.iterations, solver.reason, time.perf_counter() - began)
    if not solver.certified:
        error = ReconstructionError(
            f"TAO ended with {solver.reason} after {solver.iterations} iterations at a relative gap of "
            f"{result.relative_gap:.3g}, above {gap:.3g}"
        )
        error.reached = result
        raise error
    return result


def _lifted(energy: Energy, x: NDArray) -> NDArray:
    """x with no weight at 0 where the energy could grow from there, columns of unit length (collective).

    Where two events have no weight on a timeline and nothing else is there, the gradient is 0 although the energy grows
    as both get some: such stationary points are no maxima where b = 0 (example 1 of section 3.2).
    """
    s, g = energy.slots, energy.gradient(x)
    stuck, idle = (x == 0) & (g > 0), (x == 0) & (g == 0) & (s.coupling[s.pair] > 0)
    if not s.comm.allreduce(int((stuck | idle).sum())):
        return x
    size = s.spread(np.sqrt(s.columns(g, g)))
    x = x.copy()
    x[stuck] = LIFT * g[stuck] / size[stuck]
    x[idle] = LIFT * s.uniform()[idle]
    return x / s.spread(np.sqrt(s.columns(x, x)))


class _Solver:
    """TAO on z, with what its callbacks share."""

    def __init__(self, energy: Energy, wanted: float, monitor: Callable[[dict[str, float]], None] | None) -> None:
        self.energy, self.slots, self.wanted, self.monitor = energy, energy.slots, wanted, monitor
        self.value = self.gap = 0.0
        self.iterations, self.reason = 0, "CONVERGED_USER"  # TAO is not needed where sweeps do
        self.certified = False
        self._before = 0  # iterations of earlier attempts
        self._point: NDArray | None = None  # where x, g and the rest belong to
        self._tao: PETSc.TAO | None = None
        self._used: list[PETSc.Object] = []
        self._held = False
        self._radius = self._stiffness = np.zeros(energy.slots.count)

    def _create(self) -> PETSc.TAO:
        comm, n = self.slots.comm, len(self.slots)
        z, gradient, low, high = (PETSc.Vec().createMPI((n, PETSc.DECIDE), comm=comm) for _ in range(4))
        high.set(PETSc.INFINITY)
        tao = PETSc.TAO().create(comm)
        tao.setOptionsPrefix(PREFIX)
        tao.setObjectiveGradient(self._objective_gradient, gradient)
        matrix = PETSc.Mat().createPython(((n, PETSc.DECIDE), (n, PETSc.DECIDE)), _Hessian(self), comm=comm)
        matrix.setOption(PETSc.Mat.Option.SYMMETRIC, True)
        matrix.setUp()
        tao.setHessian(self._hessian, matrix)
        tao.setVariableBounds((low, high))
        tao.setSolution(z)
        tao.setConvergenceTest(self._test)
        with defaults(PREFIX, DEFAULTS):
            tao.setFromOptions()
        # |z_j| is free: a Newton step needs it held, by ½ |g_j| ln²(|z_j|/ρ_j)
        self._held = tao.getType() in NEWTON
        self._used = [tao, matrix, z, gradient, low, high]
        return tao

    def destroy(self) -> None:
        """Free the PETSc objects."""
        for used in self._used:
            used.destroy()

    def sweep(self, x: NDArray, times: int) -> NDArray:
        """Rounds over the events from x, as long as they are worth it."""
        before = np.inf
        while times and not self.certified:
            x = _lifted(self.energy, self.energy.sweep(x, times))
            self._certify(x, self.energy.gradient(x))
            if not self.gap < before / WORTHWHILE:  # nor where numbers have overflown
                break
            before = self.gap
        return x

    def solve(self, x: NDArray) -> NDArray:
        """Go on from x; returns the weights reached."""
        s = self.slots
        g = self.energy.gradient(x)
        self._certify(x, g)
        if self.certified or not s.count:
            self.certified = True
            return x
        size = np.sqrt(s.columns(g, g))
        # scaled so, a column's curvature is about 1 (its own energy over its length squared)
        self._radius, self._stiffness = np.sqrt(size), size
        tao = self._tao = self._tao or self._create()
        z = tao.getSolution()
        z.array[:] = x * s.spread(self._radius)
        self._next = (np.inf, 0)
        tao.solve()
        self.iterations = self._before = self._before + tao.getIterationNumber()
        reasons = {number: name for name, number in vars(PETSc.TAO.Reason).items() if name[0] in "CD"}
        self.reason = reasons.get(int(tao.getConvergedReason()), "DIVERGED")
        self._evaluate(z.array_r)
        x = _lifted(self.energy, self.x)
        self._certify(x, self.energy.gradient(x))
        return x

    # ------------------------------------------------------------------ energy in z

    def _combine(self, factor: NDArray, u: NDArray, other: NDArray, v: NDArray) -> NDArray:
        """factor_j u + other_j v in each column j."""
        s, out = self.slots, np.empty(len(self.slots))
        kernel.call("combine", s.count, s.start, factor, u, other, v, out)
        return out

    def _evaluate(self, z: NDArray) -> None:
        """x, g, |z_j| and x_j·g_j at z."""
        # every rank must answer alike: what follows is collective
        same = self._point is not None and np.array_equal(self._point, z)
        if self.slots.comm.allreduce(same, op=MPI.LAND):
            return
        s = self.slots
        self._point = z.copy()
        length = np.sqrt(s.columns(z, z))
        self.length = np.where(length > 0, length, 1.0)
        nothing = np.zeros(s.count)
        self.x = self._combine(1 / self.length, z, nothing, z)
        self.g = self.energy.gradient(self.x)
        self.along = s.columns(self.x, self.g)

    def _objective_gradient(self, tao: PETSc.TAO, z: PETSc.Vec, out: PETSc.Vec) -> float:
        self._evaluate(z.array_r)
        ρ = self.length
        radial = self.along.copy()
        value = -self.energy.value(self.x, self.g)
        if self._held:
            stretch = np.log(ρ / self._radius)
            radial += self._stiffness * stretch
            value += 0.5 * float((self._stiffness * stretch**2).sum())
        # -(g - x (x·g))/ρ, and the holding force along x
        out.array[:] = self._combine(-1 / ρ, self.g, radial / ρ, self.x)
        return value

    def _hessian(self, tao: PETSc.TAO, z: PETSc.Vec, matrix: PETSc.Mat, preconditioner: PETSc.Mat) -> None:
        self._evaluate(z.array_r)
        matrix.getPythonContext().added = 0.0
        matrix.assemble()

    def product(self, v: NDArray) -> NDArray:
        """Hessian of the objective times v, at the last point evaluated."""
        s, x, g, ρ = self.slots, self.x, self.g, self.length
        xv = s.columns(x, v)
        w = self._combine(1 / ρ, v, -xv / ρ, x)  # the change of x
        dg = self.energy.couple(w)
        turned = s.columns(w, g) + s.columns(x, dg)
        out = -self._combine(1 / ρ, dg, -turned / ρ, x)
        out += self._combine(self.along / ρ, w, -self.along * xv / ρ**2, x)
        out += self._combine(xv / ρ**2, g, np.zeros(s.count), g)
        if self._held:
            k, stretch = self._stiffness, np.log(ρ / self._radius)
            out += self._combine(k * stretch / ρ, w, k * (1 - stretch) * xv / ρ**2, x)
        return out

    # ------------------------------------------------------------------ when to stop

    def _certify(self, x: NDArray, g: NDArray) -> None:
        self.value = self.energy.value(x, g)
        self.gap = self.energy.gap(x, g)
        self.certified = self.gap <= self.wanted * max(self.value, 0.0)

    def _test(self, tao: PETSc.TAO) -> None:
        its, value, residual = tao.getSolutionStatus()[:3]
        wanted, latest = self._next
        if residual <= wanted or its >= latest:
            self._evaluate(tao.getSolution().array_r)
            x = _lifted(self.energy, self.x)
            self._certify(x, self.g if x is self.x else self.energy.gradient(x))
            # the gap falls like the square of the residual
            missing = self.wanted * self.value / self.gap if self.gap > 0 else 1.0
            self._next = (residual * min(1.0, 1.2 * missing**0.5), its + 10)
        if self.monitor is not None:
            row = {"iteration": self._before + its, "energy": -value, "residual": residual, "gap": self.gap}
            self.monitor(row)
        reason = PETSc.TAO.Reason
        if self.certified:
            tao.setConvergedReason(reason.CONVERGED_USER)
        elif not np.isfinite(value) or not np.isfinite(residual):
            tao.setConvergedReason(reason.DIVERGED_NAN)
        elif its >= tao.getMaximumIterations():  # a test of one's own takes over all of TAO's
            tao.setConvergedReason(reason.DIVERGED_MAXITS)
        else:
            tao.setConvergedReason(reason.CONTINUE_ITERATING)


class _Hessian:
    """The matrix TAO's Newton types see."""

    def __init__(self, solver: _Solver) -> None:
        self._solver = solver
        self.added = 0.0  # times the identity

    def mult(self, matrix: PETSc.Mat, v: PETSc.Vec, out: PETSc.Vec) -> None:
        out.array[:] = self._solver.product(v.array_r) + self.added * v.array_r

    def shift(self, matrix: PETSc.Mat, a: float) -> None:
        """What bnls does to a Hessian that is not positive."""
        self.added += a
