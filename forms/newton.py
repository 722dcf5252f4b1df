"""SNES as it is used here: Newton on an energy, with reasons and places when it fails."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Protocol

from petsc4py import PETSc

# Tuned defaults, put in the options database where the user has not spoken (see docs/petsc.md for the figures).
DEFAULTS: Mapping[str, object] = {
    "snes_type": "newtonls",
    "snes_linesearch_type": "bt",
    "snes_linesearch_order": 3,
    "snes_linesearch_max_it": 40,
    "snes_max_linear_solve_fail": 1_000_000_000,
    "ksp_rtol": 1e-4,
    "ksp_max_it": 1000,
    "ksp_type": "cg",
    "pc_type": "pbjacobi",
}
# Follower pressure makes the matrix unsymmetric and leaves no energy to search along.
UNSYMMETRIC: Mapping[str, object] = {"ksp_type": "gmres", "ksp_gmres_restart": 100}


class StepFailure(ArithmeticError):
    """A step has no solution that could be found; the message says why and where, in one line."""


class Equations(Protocol):
    """What `Newton` solves: the minimum of `energy`, or a zero of `residual` where there is no energy."""

    has_energy: bool

    def energy(self, x: PETSc.Vec) -> float: ...

    def residual(self, x: PETSc.Vec, out: PETSc.Vec) -> None: ...

    def tangent(self, x: PETSc.Vec, out: PETSc.Mat, projected: bool) -> None: ...


@dataclass
class Figures:
    """What a solve took, and how it ended."""

    newton: int = 0
    krylov: int = 0
    residual: float = 0.0
    reason: int = 0

    def __add__(self, other: Figures) -> Figures:
        return Figures(self.newton + other.newton, self.krylov + other.krylov, other.residual, other.reason)


class _Smoothness:
    """Whether the tangent should be projected, from how the last iteration went."""

    def __init__(self, full_step: int) -> None:
        self._full_step = full_step
        self._patience = 1
        self.restart()

    def restart(self) -> None:
        self.projected = True
        self.evaluations = 0
        self._wait = self._patience

    def project(self, reason: int) -> bool:
        """The choice for the coming iteration; `reason` is Krylov's of the last one, 0 if there is none."""
        easy = reason != 0 and self.evaluations <= self._full_step
        negative = reason in (
            PETSc.KSP.ConvergedReason.DIVERGED_INDEFINITE_MAT,
            PETSc.KSP.ConvergedReason.DIVERGED_INDEFINITE_PC,
        )
        self.evaluations = 0
        if self.projected:
            self._wait -= easy
            if self._wait < 0:
                self.projected = False
        elif negative or not easy:
            self.projected = True
            self._patience = min(2 * self._patience, 16)
            self._wait = self._patience
        return self.projected


def set_defaults(prefix: str, table: Mapping[str, object]) -> None:
    """Put options in PETSc's database where it has none of that name."""
    options = PETSc.Options(prefix)
    for name, value in table.items():
        if not options.hasName(name):
            options.setValue(name, value)


class Newton:
    """A SNES with prefix `elastic_` for `equations`.

    The tangent is projected while the going is rough. After a full step from a projected tangent the exact one is
    tried; where Krylov meets a negative direction or the line search has to shorten, the projected one comes back
    for twice as many iterations as the time before.

    Parameters
    ----------
    equations : Equations
    vector, matrix : PETSc.Vec, PETSc.Mat
        Of the right layout; used for the residual and the tangent.
    symmetric : bool
        Whether the tangent is.
    """

    prefix = "elastic_"

    def __init__(self, equations: Equations, vector: PETSc.Vec, matrix: PETSc.Mat, symmetric: bool = True) -> None:
        self.on_iteration: Callable[[int, float], None] | None = None
        self._equations = equations
        table = dict(DEFAULTS) if symmetric else {**DEFAULTS, **UNSYMMETRIC}
        set_defaults(self.prefix, table)
        self.snes = snes = PETSc.SNES().create(matrix.comm)
        snes.setOptionsPrefix(self.prefix)
        snes.setFunction(self._residual, vector)
        snes.setJacobian(self._tangent, matrix)
        if equations.has_energy:
            snes.setObjective(self._energy)
        snes.setMonitor(self._monitor)
        snes.setFromOptions()
        self._smooth = _Smoothness(full_step=2 if equations.has_energy else 1)

    def _energy(self, snes: Any, x: PETSc.Vec) -> float:
        self._smooth.evaluations += 1
        return self._equations.energy(x)

    def _residual(self, snes: Any, x: PETSc.Vec, out: PETSc.Vec) -> None:
        if not self._equations.has_energy:
            self._smooth.evaluations += 1
        self._equations.residual(x, out)

    def _tangent(self, snes: Any, x: PETSc.Vec, a: PETSc.Mat, out: PETSc.Mat) -> None:
        reason = snes.getKSP().getConvergedReason() if snes.getIterationNumber() else 0
        self._equations.tangent(x, out, self._smooth.project(reason))

    def _monitor(self, snes: Any, iteration: int, norm: float) -> None:
        if self.on_iteration is not None:
            self.on_iteration(iteration, norm)

    def solve(self, x: PETSc.Vec, tolerance: float, iterations: int) -> Figures:
        """Improve `x` until |F| <= `tolerance` [N]; where it does not, the figures' reason is negative."""
        total = Figures()
        while True:
            self._smooth.restart()
            self.snes.setTolerances(rtol=0.0, atol=tolerance, stol=0.0, max_it=iterations - total.newton)
            try:
                self.snes.solve(None, x)
            except PETSc.Error as error:
                raise StepFailure(f"PETSc error {error.ierr} in the solve") from error
            total = total + Figures(
                self.snes.getIterationNumber(),
                self.snes.getLinearSolveIterations(),
                self.snes.getFunctionNorm(),
                self.snes.getConvergedReason(),
            )
            stuck_on_exact = total.reason < 0 and not self._smooth.projected and self._equations.has_energy
            if not stuck_on_exact or total.newton >= iterations:
                return total

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
        """Free the SNES."""
        self.snes.destroy()


def _name(kind: Any, value: int) -> str:
    names = [name for name in vars(kind) if name.isupper() and getattr(kind, name) == value]
    return max(names, key=len) if names else str(value)
