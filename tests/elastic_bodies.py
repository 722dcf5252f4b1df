"""Small bodies, exact solutions and error norms that the tests of the elastic solver share."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np
import sympy as sp
import ufl
from mpi4py import MPI
from numpy.typing import NDArray
from petsc4py import PETSc

from extremal import forms, meshes
from extremal.forms import compat

X = sp.symbols("x y z", real=True)


@contextmanager
def petsc_options(**table: object) -> Iterator[None]:
    """Options with the prefix `elastic_` for the problems made inside; the database is left as it was."""
    options = PETSc.Options("elastic_")
    before = dict(options.getAll())
    for name, value in table.items():
        options.setValue(name, value)
    try:
        yield
    finally:
        for name in options.getAll():
            if name not in before:
                options.delValue(name)
        for name, value in before.items():
            options.setValue(name, value)


DIRECT = {"ksp_type": "preonly", "pc_type": "lu", "pc_factor_mat_solver_type": "mumps"}


def on(comm: MPI.Intracomm, shape: str, **parameters: Any) -> meshes.Domain:
    """A generated mesh, distributed over `comm` (collective)."""
    return meshes.distribute(comm, meshes.generate(shape, **parameters) if comm.rank == 0 else None)


def material(
    dimension: int,
    poisson_ratio: forms.Field = 0.3,
    young_modulus: forms.Field = 1.0,
    law: str = "neo_hookean",
    **more: Any,
) -> forms.Material:
    """A material of density 1 kg/m³; E = 1 Pa unless given."""
    moduli = {"young_modulus": young_modulus, "poisson_ratio": poisson_ratio}
    return forms.Material(forms.law(law, dimension), moduli, **more)


def problem(domain: meshes.Domain, stuff: forms.Material | None = None, **how: Any) -> forms.ElasticProblem:
    """A problem at rest with one material in all regions, E = 1 Pa, ν = 0.3 and C2 unless given."""
    stuff = stuff or material(domain.mesh.topology.dim)
    made = forms.ElasticProblem(domain, {name: stuff for name in domain.region_names}, **how)
    made.start()
    return made


# ------------------------------------------------------------------------------------------ manufactured solutions


I1, J = sp.symbols("I1 J", positive=True)
Slopes = Callable[[NDArray, NDArray], Sequence[NDArray]]


def slopes_of(energy: sp.Expr, between: dict[sp.Symbol, sp.Expr] | None = None) -> Slopes:
    """First and second derivatives of Ψ(I1, J); `between` are further symbols in it, each in terms of those before."""
    between = between or {}

    def total(expr: sp.Expr, s: sp.Symbol) -> sp.Expr:
        return sp.diff(expr, s) + sum(
            sp.diff(expr, m) * total(b, s) for m, b in between.items() if expr.has(m)
        )

    first = [total(energy, s) for s in (I1, J)]
    second = [total(first[0], I1), total(first[0], J), total(first[1], J)]
    symbols = [I1, J, *between]
    steps = [sp.lambdify(symbols[: 2 + k], b) for k, b in enumerate(between.values())]
    last = sp.lambdify(symbols, [*first, *second], cse=True)

    def at(trace: NDArray, det: NDArray) -> Sequence[NDArray]:
        values = [trace, det]
        for step in steps:
            values.append(step(*values))
        return last(*values)

    return at


class Manufactured:
    """A displacement chosen freely, and the body force b = -Div P(F) that makes it an equilibrium.

    P = 2 Ψ_1 F + Ψ_J cof F and, with a dot for ∂/∂x_j,
    Ṗ = 2 Ψ_1 Ḟ + Ψ_J (cof F)˙ + 2 (Ψ_11 İ1 + Ψ_1J J̇) F + (Ψ_1J İ1 + Ψ_JJ J̇) cof F,  İ1 = 2 F:Ḟ,  J̇ = cof F:Ḟ.

    Parameters
    ----------
    displacement : sequence of d sympy.Expr
        u(x) [m] in the symbols `X`.
    slopes : callable
        I1 = F:F and J, arrays -> Ψ_1, Ψ_J, Ψ_11, Ψ_1J, Ψ_JJ [Pa].
    """

    def __init__(self, displacement: Sequence[sp.Expr], slopes: Slopes) -> None:
        self.dimension = d = len(displacement)
        x = X[:d]
        u = sp.Matrix(displacement)
        H = u.jacobian(x)
        self._u = sp.lambdify(x, list(u), cse=True)
        self._H = sp.lambdify(x, list(H), cse=True)
        self._rates = [sp.lambdify(x, list(H.diff(c)), cse=True) for c in x]
        self._slopes = slopes

    def _matrices(self, function: Callable, x: NDArray) -> NDArray:
        values = [np.broadcast_to(v, len(x)) for v in function(*x.T)]
        return np.stack(values, axis=1).reshape(len(x), self.dimension, -1)

    def displacement(self, x: NDArray, time: float = 1.0) -> NDArray:
        """u (n, d) [m], growing with time from nothing at 0."""
        return time * self._matrices(self._u, x)[:, :, 0]

    def gradient(self, x: NDArray) -> NDArray:
        """∂u/∂x (n, d*d)."""
        return self._matrices(self._H, x).reshape(len(x), -1)

    def body_force(self, x: NDArray, time: float = 1.0) -> NDArray:
        """b (n, d) [N/m³] at time 1."""
        F = self._matrices(self._H, x) + np.eye(self.dimension)
        slopes = self._slopes((F * F).sum(axis=(1, 2)), self.determinant(x))
        p1, pj, p11, p1j, pjj = (np.broadcast_to(s, len(x))[:, None, None] for s in slopes)
        b = np.zeros((len(x), self.dimension))
        for j, rate in enumerate(self._rates):
            f = self._matrices(rate, x)
            di = 2 * (F * f).sum(axis=(1, 2), keepdims=True)
            dj = (cofactor(F) * f).sum(axis=(1, 2), keepdims=True)
            turned = (cofactor(F + f) - cofactor(F - f)) / 2
            P = 2 * p1 * f + pj * turned + 2 * (p11 * di + p1j * dj) * F + (p1j * di + pjj * dj) * cofactor(F)
            b -= P[:, :, j]
        return time * b

    def determinant(self, x: NDArray) -> NDArray:
        """J (n,)."""
        return np.linalg.det(self._matrices(self._H, x) + np.eye(self.dimension))


def cofactor(F: NDArray) -> NDArray:
    """∂J/∂F (n, d, d)."""
    if F.shape[1] == 2:
        return np.stack([F[:, 1, 1], -F[:, 1, 0], -F[:, 0, 1], F[:, 0, 0]], axis=1).reshape(-1, 2, 2)
    return np.stack([np.cross(F[:, (i + 1) % 3], F[:, (i + 2) % 3]) for i in range(3)], axis=1)


def neo_hookean(young_modulus: float, poisson_ratio: float, dimension: int) -> Slopes:
    """Ψ = μ/2 (I1 - d) - μ ln J + λ/2 (ln J)²."""
    return slopes_of(_neo_hookean(young_modulus, poisson_ratio, dimension))


def _neo_hookean(young_modulus: float, poisson_ratio: float, dimension: int) -> sp.Expr:
    mu, lam = lame(young_modulus, poisson_ratio)
    return mu / 2 * (I1 - dimension) - mu * sp.log(J) + lam / 2 * sp.log(J) ** 2


def c2_neo_hookean_2d(young_modulus: float, poisson_ratio: float, threshold: float) -> Slopes:
    """The same in the plane with the C2 extension: Taylor's polynomial of degree 2 along the ray from rest.

    On the ray i1 = 2 + t e1 and J = 1 + t e1 + t² e2 with e1 = i1 - 2, e2 = J - i1 + 1; it meets J = ε at t = q.
    """
    base, t = _neo_hookean(young_modulus, poisson_ratio, 2), sp.Symbol("t")
    e1, e2, q = sp.symbols("e1 e2 q")
    det = 1 + t * e1 + t**2 * e2
    along = base.subs({I1: (2 + t * e1) ** 2 - 2 * det, J: det}, simultaneous=True)
    between = {
        e1: sp.sqrt(I1 + 2 * J) - 2,
        e2: J - e1 - 1,
        q: 2 * (1 - threshold) / (-e1 + sp.sqrt(e1**2 - 4 * e2 * (1 - threshold))),
    }
    taylor = sum(sp.diff(along, t, n).subs(t, q) * (1 - q) ** n / sp.factorial(n) for n in range(3))
    above, below = slopes_of(base), slopes_of(taylor, between)

    def at(trace: NDArray, det: NDArray) -> Sequence[NDArray]:
        with np.errstate(invalid="ignore", divide="ignore"):  # both are evaluated everywhere
            return [np.where(det > threshold, a, b) for a, b in zip(above(trace, det), below(trace, det))]

    return at


def lame(young_modulus: float, poisson_ratio: float) -> tuple[float, float]:
    """μ and λ [Pa]."""
    E, nu = young_modulus, poisson_ratio
    return E / (2 * (1 + nu)), E * nu / ((1 + nu) * (1 - 2 * nu))


def errors(made: forms.ElasticProblem, exact: Any) -> tuple[float, float]:
    """L2 norm of the error [m^(1+d/2)] and of its gradient, by a rule four degrees finer than the elements."""
    space, d = made.space, made.space.dimension
    points, weights = compat.rule(d, 2 * space.degree + 4)
    cells = np.arange(space.cells, dtype=np.int32)

    def at(what: Any) -> NDArray:
        return compat.evaluate(compat.expression(what, points), space.mesh, cells).reshape(
            -1, *what.ufl_shape
        )

    x = at(ufl.SpatialCoordinate(space.mesh))
    w = (
        at(abs(ufl.JacobianDeterminant(space.mesh)) * ufl.as_vector([1.0])).reshape(space.cells, -1) * weights
    ).ravel()
    u = (at(space.u) - exact.displacement(x)) ** 2
    H = (at(ufl.grad(space.u)).reshape(len(x), d * d) - exact.gradient(x)) ** 2
    totals = [space.comm.allreduce(float(w @ part.sum(axis=1))) for part in (u, H)]
    return float(np.sqrt(totals[0])), float(np.sqrt(totals[1]))


def slope(sizes: Sequence[float], values: Sequence[float]) -> float:
    """Fitted order of values ~ size^order."""
    return float(np.polyfit(np.log(sizes), np.log(values), 1)[0])
