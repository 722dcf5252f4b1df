"""SNES as it is used here: Newton on an energy, with reasons and places when it fails."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from petsc4py import PETSc

from extremal.native.options import defaults

if TYPE_CHECKING:
    from .equations import Equations

# Tuned defaults, put in the options database where the user has not spoken (docs/petsc.md has the figures).
ALWAYS: Mapping[str, object] = {
    "snes_type": "newtonls",
    "snes_linesearch_type": "bt",
    "snes_linesearch_order": 3,
    "snes_linesearch_max_it": 40,
    "snes_divergence_tolerance": 1e300,  # from near rest a residual may well grow ten-thousandfold
    "snes_max_linear_solve_fail": 1_000_000_000,
    "ksp_rtol": 1e-4,
}
REGIMES: Mapping[str, Mapping[str, object]] = {
    # multigrid breaks down on tangled elements, a factorisation costs three times as much
    "tangled": {"ksp_type": "cg", "pc_type": "pbjacobi", "ksp_max_it": 1000},
    "smooth": {"ksp_type": "cg", "pc_type": "pbjacobi", "ksp_max_it": 2000},
    "nearly_incompressible": {
        "ksp_type": "cg",
        "ksp_max_it": 200,
        "pc_type": "cholesky",
        "pc_factor_mat_solver_type": "mumps",
    },
    "large_nearly_incompressible": {"ksp_type": "cg", "pc_type": "pbjacobi", "ksp_max_it": 10_000},
    # follower pressure makes the matrix unsymmetric
    "unsymmetric": {"ksp_type": "gmres", "ksp_gmres_restart": 100, "ksp_max_it": 2000, "pc_type": "pbjacobi"},
}
# the energy decides until its last digits are spent; then the residual along the step does
POLISH: Mapping[str, object] = {
    "snes_linesearch_type": "cp",
    "snes_linesearch_max_it": 5,
    "snes_linesearch_atol": 0.0,  # F·y below it would pass for convergence however large |F| is
}
POLISHED = 1e4  # times the tolerance: the largest residual that is polished
ROUNDING = 1e-15  # of the energy: a smaller gain is none
NEARLY_INCOMPRESSIBLE = 0.495  # Poisson's ratio
LARGEST_FACTORISATION = 60_000  # unknowns


def regime(*, tangled: bool, poisson_ratio: float, unknowns: int, symmetric: bool) -> str:
    """The name in `REGIMES` of the defaults for a body."""
    if not symmetric:
        return "unsymmetric"
    if tangled:
        return "tangled"
    if poisson_ratio > NEARLY_INCOMPRESSIBLE:
        small = unknowns <= LARGEST_FACTORISATION
        return "nearly_incompressible" if small else "large_nearly_incompressible"
    return "smooth"


_NEGATIVE = (PETSc.KSP.ConvergedReason.DIVERGED_INDEFINITE_MAT, PETSc.KSP.ConvergedReason.DIVERGED_INDEFINITE_PC)


class StepFailure(ArithmeticError):
    """A step has no solution that could be found; the message says why and where, in one line.

    `wanted_step` [s] is the length to try instead, where an error estimate tells.
    """

    def __init__(self, message: str, wanted_step: float | None = None) -> None:
        super().__init__(message)
        self.wanted_step = wanted_step


@dataclass
class Figures:
    """What a solve took, and how it ended."""

    newton: int = 0
    krylov: int = 0
    residual: float = 0.0
    reason: int = 0

    def __add__(self, other: Figures) -> Figures:
        return Figures(self.newton + other.newton, self.krylov + other.krylov, other.residual, other.reason)


class _Tangent:
    """Whether the coming tangent should be projected, from how the last iterations went."""

    def __init__(self, full_step: int) -> None:
        self._full_step = full_step  # evaluations of a line search that takes the first step it tries
        self.restart()

    def restart(self) -> None:
        self.projected, self.evaluations = True, 0
        self.energy: float | None = None
        self._start: float | None = None
        self._gain = 0.0  # of the last projected step
        self._pause, self._wait = 1, 1

    def project(self, reason: int) -> bool:
        """The choice for the coming iteration; `reason` is Krylov's of the last one, 0 if there is none."""
        gain = self._start - self.energy if self._start is not None and self.energy is not None else 0.0
        easy = reason != 0 and self.evaluations <= self._full_step
        self.evaluations, self._start = 0, self.energy
        if self.projected:
            self._gain = gain
            self._wait -= easy
            if self._wait < 0:
                self.projected = False
        elif not easy or reason in _NEGATIVE:
            self._pause = 1 if gain > self._gain else min(2 * self._pause, 16)
            self.projected, self._wait = True, self._pause
        return self.projected


class Newton:
    """A SNES with prefix `elastic_` for `equations`.

    The tangent is projected while the going is rough. After full steps with a projected tangent the exact one is
    tried; where Krylov meets a negative direction or the line search has to shorten, the projected one comes back,
    for a pause that grows while the exact tangent gains less energy than the projected one did.

    Parameters
    ----------
    equations : Equations
    regime : str
        Which defaults of `REGIMES` to take.
    exact : bool
        Never project the tangent.
    """

    prefix = "elastic_"

    def __init__(self, equations: Equations, regime: str, exact: bool = False) -> None:
        self.on_iteration: Callable[[int, float], None] | None = None
        self._equations, self._exact, self._regime = equations, exact, regime
        self._choice = _Tangent(full_step=2 if equations.has_energy else 1)
        self._polisher: PETSc.SNES | None = None
        self.snes = self._snes(self.prefix, {})
        if equations.has_energy:
            self.snes.setObjective(self._energy)
            self.snes.setConvergenceTest(self._converged)
        self.snes.setMonitor(self._monitor)

    def _snes(self, prefix: str, more: Mapping[str, object]) -> PETSc.SNES:
        snes = PETSc.SNES().create(self._equations.comm)
        snes.setOptionsPrefix(prefix)
        snes.setFunction(self._residual, self._equations.vector.duplicate())
        snes.setJacobian(self._tangent, self._equations.matrix)
        with defaults(prefix, {**ALWAYS, **REGIMES[self._regime], **more}):
            snes.setFromOptions()
        return snes

    def _energy(self, snes: Any, x: PETSc.Vec) -> float:
        self._choice.evaluations += 1
        self._choice.energy = self._equations.energy(x)
        return self._choice.energy

    def _residual(self, snes: Any, x: PETSc.Vec, out: PETSc.Vec) -> None:
        if not self._equations.has_energy:
            self._choice.evaluations += 1
        self._equations.residual(x, out)

    def _tangent(self, snes: Any, x: PETSc.Vec, a: PETSc.Mat, out: PETSc.Mat) -> None:
        reason = snes.getKSP().getConvergedReason() if snes.getIterationNumber() else 0
        projected = self._choice.project(reason) if snes == self.snes else False
        self._equations.tangent(x, out, projected and not self._exact)

    def _converged(self, snes: Any, iteration: int, norms: tuple[float, float, float]) -> int:
        """PETSc's own test, and an end where the energy no longer falls though the residual could."""
        reasons, (x, step, residual) = PETSc.SNES.ConvergedReason, norms
        rtol, atol, stol, _ = snes.getTolerances()
        if iteration == 0:
            self._first, self._stalled, self._last = residual, 0, np.inf
        energy = self._choice.energy
        if energy is not None and iteration:
            self._stalled = self._stalled + 1 if self._last - energy <= ROUNDING * abs(energy) else 0
            self._last = energy
        if not np.isfinite(residual):
            return reasons.DIVERGED_FNORM_NAN
        if residual <= atol:
            return reasons.CONVERGED_FNORM_ABS
        if iteration and residual <= rtol * self._first:
            return reasons.CONVERGED_FNORM_RELATIVE
        if iteration and step < stol * x:
            return reasons.CONVERGED_SNORM_RELATIVE
        if self._stalled >= 2 and residual <= POLISHED * atol:
            return reasons.DIVERGED_LINE_SEARCH
        return reasons.CONVERGED_ITERATING

    def _monitor(self, snes: Any, iteration: int, norm: float) -> None:
        if self.on_iteration is not None:
            self.on_iteration(iteration, norm)

    def solve(self, x: PETSc.Vec, tolerance: float, iterations: int) -> Figures:
        """Improve `x` until |F| <= `tolerance` [N]; where it does not, the figures' reason is negative.

        A tolerance below what rounding leaves of the inertia is raised to that.
        """
        total = Figures()
        tolerance = max(tolerance, self._equations.rounding())
        while True:
            self._choice.restart()
            total = total + self._run(self.snes, x, tolerance, iterations - total.newton)
            if total.reason != PETSc.SNES.ConvergedReason.DIVERGED_LINE_SEARCH or not self._equations.has_energy:
                return total
            on_exact = not self._choice.projected
            if total.residual <= POLISHED * tolerance:
                total = total + self._polish(x, tolerance)
            if total.reason > 0 or not on_exact or total.newton >= iterations:
                return total

    def _run(self, snes: PETSc.SNES, x: PETSc.Vec, tolerance: float, iterations: int) -> Figures:
        user = PETSc.Options(self.prefix)  # who asks for other tolerances gets them
        snes.setTolerances(
            rtol=user.getReal("snes_rtol", 0.0),
            atol=user.getReal("snes_atol", tolerance),
            stol=user.getReal("snes_stol", 0.0),
            max_it=min(iterations, user.getInt("snes_max_it", iterations)),
        )
        try:
            snes.solve(None, x)
        except PETSc.Error as error:
            raise StepFailure(f"PETSc error {error.ierr} in the solve") from error
        krylov = snes.getLinearSolveIterations()
        return Figures(snes.getIterationNumber(), krylov, snes.getFunctionNorm(), snes.getConvergedReason())

    def _polish(self, x: PETSc.Vec, tolerance: float) -> Figures:
        """A few iterations on the residual alone, where the energy's last digits no longer tell better from worse."""
        if self._polisher is None:
            self._polisher = self._snes(f"{self.prefix}polish_", POLISH)
            self._polisher.setKSP(self.snes.getKSP())
        kept = x.copy()
        self._choice.projected = False
        figures = self._run(self._polisher, x, tolerance, 10)
        if figures.reason <= 0:
            kept.copy(x)
        kept.destroy()
        return figures

    def solve_linear(self, matrix: PETSc.Mat, right: PETSc.Vec, x: PETSc.Vec) -> None:
        """x = matrix⁻¹ right by the Krylov solver of the SNES."""
        ksp = self.snes.getKSP()
        ksp.setOperators(matrix)
        ksp.solve(right, x)

    def reasons(self) -> str:
        """SNES's and KSP's reasons in PETSc's words."""
        return f"SNES {_name(PETSc.SNES.ConvergedReason, self.snes.getConvergedReason())}, KSP " + _name(
            PETSc.KSP.ConvergedReason, self.snes.getKSP().getConvergedReason()
        )

    def destroy(self) -> None:
        """Free the solvers."""
        self.snes.destroy()
        if self._polisher is not None:
            self._polisher.destroy()


def _name(kind: Any, value: int) -> str:
    names = [name for name in vars(kind) if name.isupper() and getattr(kind, name) == value]
    return max(names, key=len) if names else str(value)
