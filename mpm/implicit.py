"""The semi-implicit step: (M + β Δt² H) v = M v* on the nodes this rank owns (7.9), by PETSc's KSP.

As printed, (7.9) is symmetric in the mass inner product only; multiplied by the masses it is symmetric. The unknown is
δ = v - v*, so that an explicit step is the zero guess; nodes that collided keep v*, their rows are projected out.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray
from petsc4py import PETSc

from extremal.native.options import defaults

from .grid import Grid
from .kernel import Kernel
from .particles import Particles
from .sharing import Sharing

PREFIX = "snow_"
# Put in the options database where the user has not spoken. The Hessian may be indefinite under compression, which
# conjugate residuals endure; the natural norm does not let the lightest nodes decide.
DEFAULTS: Mapping[str, object] = {
    "ksp_type": "cr",
    "ksp_norm_type": "natural",
    "ksp_rtol": 1e-3,
    "ksp_max_it": 200,
    "pc_type": "jacobi",
}


class Operator:
    """M + β Δt² H as a PETSc shell matrix on owned nodes.

    Parameters
    ----------
    particles, grid, sharing
        Of this step.
    operator_kernel : Kernel
        Its precision is that of the Hessian's action.
    moduli : (n, 4)
        Of the particles, see snow.h.
    mass : (owned nodes,)
        Of the nodes, with what is attached to them [kg].
    factor : float
        β Δt² [s²].
    free : (owned nodes,) bool
        Nodes that did not collide.
    """

    def __init__(
        self,
        particles: Particles,
        grid: Grid,
        sharing: Sharing,
        operator_kernel: Kernel,
        moduli: NDArray,
        mass: NDArray,
        factor: float,
        free: NDArray,
    ) -> None:
        self._particles, self._grid, self._sharing = particles, grid, sharing
        self._kernel, self._moduli, self._factor = operator_kernel, moduli, factor
        self._d = particles.dimension
        self._mass = mass
        self._free = free
        self._local = np.zeros((sharing.count, self._d), dtype=operator_kernel.real)
        self._out = np.zeros_like(self._local)

    def hessian(self, u: NDArray) -> NDArray:
        """β Δt² H u for owned values (owned nodes, d)."""
        p = self._particles
        self._local[self._sharing.owned] = u
        self._sharing.from_owners(self._local)
        self._out[:] = 0
        grid = self._grid
        self._kernel.call(
            "hessian", grid.cells, grid.start, grid.order, grid.rows, grid.h, p.position, p.stretch, self._moduli,
            self._factor, self._local, self._out,
        )  # fmt: skip
        self._sharing.sum_to_owners(self._out)
        return self._out[self._sharing.owned]

    def mult(self, matrix: PETSc.Mat, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """y = (M + β Δt² H) x on free nodes, M x on collided ones."""
        u = x.array_r.reshape(-1, self._d)
        free = self._free[:, None]
        y.array[:] = (self._mass[:, None] * u + free * self.hessian(u * free)).ravel()

    def getDiagonal(self, matrix: PETSc.Mat, diagonal: PETSc.Vec) -> None:  # noqa: N802 - the name is petsc4py's
        """The masses: PCJACOBI then preconditions by M, which makes the system that of (7.9).

        Corrections are then M⁻¹ times forces that sum to zero: momentum is conserved however early one stops.
        """
        diagonal.array[:] = np.repeat(self._mass, self._d)


def solve(operator: Operator, momentum: NDArray, rounding: float, comm: object) -> tuple[NDArray, int, int]:
    """δ with (M + β Δt² H) δ = `momentum` on free nodes.

    Parameters
    ----------
    operator : Operator
    momentum : (owned nodes, d)
        Right-hand side [kg m/s], zero on collided nodes.
    rounding : float
        Natural norm [kg^½ m/s] at which a residual is nothing but rounding: KSP's absolute tolerance by default.

    Returns
    -------
    delta : (owned nodes, d) [m/s]
    iterations : int
    reason : int
        KSP's; negative where it did not converge.
    """
    size = (momentum.size, PETSc.DECIDE)
    matrix = PETSc.Mat().createPython((size, size), operator, comm=comm)
    matrix.setUp()
    right = PETSc.Vec().createWithArray(np.ascontiguousarray(momentum).ravel(), comm=comm)
    delta = right.duplicate()
    ksp = PETSc.KSP().create(comm)
    ksp.setOptionsPrefix(PREFIX)
    with defaults(PREFIX, {**DEFAULTS, "ksp_atol": rounding}):
        ksp.setOperators(matrix)
        ksp.setFromOptions()
    ksp.solve(right, delta)
    result = delta.array.reshape(momentum.shape).copy()
    figures = ksp.getIterationNumber(), ksp.getConvergedReason()
    for used in (ksp, matrix, right, delta):
        used.destroy()
    return result, *figures
