"""A law compiled to machine code: energy, stress and stress derivative at quadrature points."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from functools import cache
from pathlib import Path

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

from extremal import native

from .laws import Law, LawError

EXTENSIONS = ("none", "c1", "c2", "ife")
_SOURCES = ("kernel.c", "response.h", "stretches.h", "threshold.h")
_DOUBLES = ctypes.POINTER(ctypes.c_double)


class Kernel:
    """Ψ, P = ∂Ψ/∂F and ∂P/∂F of `law` with `extension` (chapter 6, appendix B).

    Parameters
    ----------
    law : Law
    extension : str
        "none", "c1" (6.3.1), "c2" (6.3.2) or "ife" (stress continued linearly, Irving et al.).
    comm : mpi4py.MPI.Comm, optional
        Collective where given: rank 0 compiles. Compiled code is kept in the user's cache folder.
    """

    def __init__(self, law: Law, extension: str = "c2", comm: MPI.Comm | None = None) -> None:
        if extension not in EXTENSIONS:
            raise LawError(f"extension {extension!r} is unknown: one of {', '.join(EXTENSIONS)}")
        self.law, self.extension, self.dimension = law, extension, law.dimension
        self._library = _load(law, extension, comm or MPI.COMM_SELF)

    def evaluate(
        self,
        gradient: NDArray,
        parameters: NDArray,
        *,
        energy: NDArray | None = None,
        stress: NDArray | None = None,
        tangent: NDArray | None = None,
        project: bool = True,
    ) -> int:
        """Fill those of `energy`, `stress`, `tangent` that are given.

        Parameters
        ----------
        gradient : (n, d*d)
            Displacement gradient at n points [-].
        parameters : (1 or cells, number of law parameters + 2)
            Law parameters, threshold ε and k; n must be a multiple of the number of cells.
        energy : (n,) [Pa]
        stress : (n, d*d) [Pa]
            First Piola-Kirchhoff stress.
        tangent : (n, d*d, d*d) [Pa]
        project : bool
            Cut negative eigenvalues of the tangent.

        Returns
        -------
        int
            Number of points done without a singular value decomposition (ERRATA of 6.3.1: J > ε for C2,
            J² >= ε² I2 for C1).
        """
        n = gradient.shape[0]
        per_cell, stride = (n, 0) if len(parameters) == 1 else (n // len(parameters), parameters.shape[1])
        if n == 0:
            return 0
        return self._library.extremal_evaluate(
            n, per_cell, _pointer(gradient), _pointer(parameters), stride,
            _pointer(energy), _pointer(stress), _pointer(tangent), int(project),
        )  # fmt: skip

    def stretches(self, gradient: NDArray) -> NDArray:
        """(n, d) stretches σ1 >= σ2 >= |σ3|, the last with the sign of det F."""
        out = np.empty((gradient.shape[0], self.dimension))
        self._library.extremal_stretches(len(out), _pointer(gradient), _pointer(out), None, None)
        return out

    def decomposition(self, gradient: NDArray) -> tuple[NDArray, NDArray, NDArray]:
        """U (n, d, d), stretches (n, d), V (n, d, d) with F = U diag(σ) Vᵀ and U, V rotations."""
        n, d = gradient.shape[0], self.dimension
        left, sigma, right = np.empty((n, d, d)), np.empty((n, d)), np.empty((n, d, d))
        self._library.extremal_stretches(
            n, _pointer(gradient), _pointer(sigma), _pointer(left), _pointer(right)
        )
        return left, sigma, right

    def response(self, stretches: NDArray, parameters: Sequence[float]) -> tuple[NDArray, NDArray, NDArray]:
        """Ψ (n,), ∂Ψ/∂σ (n, d), ∂²Ψ/∂σ² (n, d, d) at the given stretches (n, d), sorted downwards."""
        n, d = stretches.shape
        sigma = np.ascontiguousarray(stretches, dtype=float)
        values = np.ascontiguousarray(parameters, dtype=float)
        psi, gradient, hessian = np.empty(n), np.empty((n, d)), np.empty((n, d, d))
        self._library.extremal_response(
            n, _pointer(sigma), _pointer(values), _pointer(psi), _pointer(gradient), _pointer(hessian)
        )
        return psi, gradient, hessian


def _pointer(array: NDArray | None):
    return None if array is None else array.ctypes.data_as(_DOUBLES)


def _load(law: Law, extension: str, comm: MPI.Comm) -> ctypes.CDLL:
    def source() -> str:
        from .symbolic import c_source

        return c_source(law, extension)

    key = f"{law.energy}|{law.parameters}|{law.dimension}|{extension}|{_generator()}"
    try:
        library = native.load(comm, law.name, key, source, include=Path(__file__).parent)
    except native.CompileError as error:
        raise LawError(f"law {law.name!r} did not compile: {error}") from None
    long, integer = ctypes.c_long, ctypes.c_int
    library.extremal_evaluate.argtypes = [long, long, _DOUBLES, _DOUBLES, long, *[_DOUBLES] * 3, integer]
    library.extremal_evaluate.restype = long
    library.extremal_stretches.argtypes = [long, *[_DOUBLES] * 4]
    library.extremal_stretches.restype = None
    library.extremal_response.argtypes = [long, *[_DOUBLES] * 5]
    library.extremal_response.restype = None
    return library


@cache
def _generator() -> str:
    """What the compiled code depends on besides the law."""
    here = Path(__file__).parent
    return "".join((here / name).read_text() for name in ("symbolic.py", "laws.py", *_SOURCES))
