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

    def tangent(self, x: PETSc.Vec, out: PETSc.Mat) -> None: ...


@dataclass
class Figures:
    """What a solve took, and how it ended."""

    newton: int = 0
    krylov: int = 0
    residual: float = 0.0
    reason: int = 0

    def __add__(self, other: Figures) -> Figures:
        return Figures(self.newton + other.newton, self.krylov + other.krylov, other.residual, other.reason)


def set_defaults(prefix: str, table: Mapping[str, object]) -> None:
    """Put options in PETSc's database where it has none of that name."""
    options = PETSc.Options(prefix)
    for name, value in table.items():
        if not options.hasName(name):
            options.setValue(name, value)


class Newton:
    """A SNES with prefix `elastic_` for `equations`.

    Parameters
    ----------
    equations : Equations
    vector, matrix : PETSc.Vec, PETSc.Mat
        Of the right layout; used for the residual and the tangent.
    near_null_space : PETSc.NullSpace or None
    """

    prefix = "elastic_"

    def __init__(self, equations: Equations, vector: PETSc.Vec, matrix: PETSc.Mat, symmetric: bool = True) -> None:
        self.on_iteration: Callable[[int, float], None] | None = None
        self._equations = equations
        table = dict(DEFAULTS) if symmetric else {**DEFAULTS, **UNSYMMETRIC}
        set_defaults(self.prefix, table)
        self.snes = snes = PETSc.SNES().create(matrix.comm)
        snes.setOptionsPrefix(self.prefix)
        snes.setFunction(lambda _, x, f: equations.residual(x, f), vector)
        snes.setJacobian(lambda _, x, a, p: equations.tangent(x, p), matrix)
        if equations.has_energy:
            snes.setObjective(lambda _, x: equations.energy(x))
        snes.setMonitor(self._monitor)
        snes.setFromOptions()

    def _monitor(self, snes: Any, iteration: int, norm: float) -> None:
        if self.on_iteration is not None:
            self.on_iteration(iteration, norm)

    def solve(self, x: PETSc.Vec, tolerance: float, iterations: int) -> Figures:
        """Improve `x` until |F| <= `tolerance` [N]; never raises, the reason is in the figures."""
        snes = self.snes
        snes.setTolerances(rtol=0.0, atol=tolerance, stol=0.0, max_it=iterations)
        try:
            snes.solve(None, x)
        except PETSc.Error as error:
            raise StepFailure(f"PETSc error {error.ierr} in the solve") from error
        return Figures(
            snes.getIterationNumber(), snes.getLinearSolveIterations(), snes.getFunctionNorm(), snes.getConvergedReason()
        )

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
