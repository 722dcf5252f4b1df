"""An elastic displacement chosen freely, whose body force follows from the energy: the error is known exactly.

u(x) has stretches between about 0.6 and 1.7; the Neo-Hookean body of E = 1 Pa is held on its boundary where u says and
carries b = -Div P(F). P = 2 Ψ_1 F + Ψ_J cof F with Ψ = μ/2 (I1 - d) - μ ln J + λ/2 (ln J)², so 2 Ψ_1 = μ and
Ψ_J = (λ ln J - μ)/J; cof F has no divergence, and so Div P = μ Δu + cof F ∇Ψ_J.
"""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Callable

    from mpi4py import MPI
    from numpy.typing import NDArray

    from extremal.forms import ElasticProblem

KEYS: dict[str, Any] = {
    "dimension": 3,
    "degree": 1,
    "divisions": 4,  # of an edge of the unit cube
    "poisson_ratio": 0.3,
    "norm": "H1",  # of the error: "L2" for the displacement, "H1" for its gradient
    "tolerance": 1e-8,
}


def run(settings: dict[str, Any], comm: MPI.Comm) -> dict[str, Any]:
    """Error of the displacement or its gradient in L2, relative to the exact one (collective)."""
    from extremal import forms, meshes

    d, degree = settings["dimension"], settings["degree"]
    exact, gradient, force = solution(d, settings["poisson_ratio"])
    data = None
    if comm.rank == 0:
        data = meshes.generate("box", cell_size=1 / settings["divisions"], dimension=d, structured=True)
    domain = meshes.distribute(comm, data)
    moduli = {"young_modulus": 1.0, "poisson_ratio": settings["poisson_ratio"]}
    material = forms.Material(forms.law("neo_hookean", d), moduli, threshold=0.3)  # J stays above
    problem = forms.ElasticProblem(
        domain,
        dict.fromkeys(domain.region_names, material),
        degree=degree,
        prescribed=[forms.Prescribed(boundary=("surface",), motion=lambda x, t: t * exact(x))],
        body_force=lambda x, t: t * force(x),
        tolerance=settings["tolerance"],
    )
    problem.start()
    began, spent = time.monotonic(), time.process_time()
    figures = problem.advance(1.0)
    wall, seconds = time.monotonic() - began, time.process_time() - spent
    field, slope = errors(problem, exact, gradient)
    cells = comm.allreduce(problem.space.cells)
    size = problem.size
    problem.destroy()
    return {
        "error": field if settings["norm"] == "L2" else slope,
        "size": size,
        "seconds": seconds,
        "wall_seconds": wall,
        "iterations": {key: int(n) for key, n in figures.items() if key.endswith("_iterations")},
        "diagnostics": {"L2": field, "H1": slope, "cells": int(cells)},
    }


def solution(dimension: int, poisson_ratio: float) -> tuple[Callable, Callable, Callable]:
    """u (n, d), ∂u/∂x (n, d, d) and b (n, d) as functions of x (n, d); E = 1 Pa."""
    import numpy as np
    import sympy as sp

    x, y, z = X = sp.symbols("x y z", real=True)
    waves = [sp.sin(2 * x + y - z) / 4, sp.cos(x - 2 * y) / 5, sp.sin(x + y + z) / 5]
    if dimension == 2:
        waves = [sp.sin(2 * x + y) / 4, sp.cos(x - 2 * y) / 5 + x * y / 5]
    variables, u = X[:dimension], sp.Matrix(waves)
    mu = 1 / (2 * (1 + poisson_ratio))
    lam = poisson_ratio / ((1 + poisson_ratio) * (1 - 2 * poisson_ratio))
    H = u.jacobian(variables)
    F = H + sp.eye(dimension)
    J = F.det()
    Ψ_J = (lam * sp.log(J) - mu) / J
    slope = sp.Matrix([sp.diff(Ψ_J, c) for c in variables])
    laplace = sp.Matrix([sum(sp.diff(c, s, 2) for s in variables) for c in waves])
    b = -(mu * laplace + F.cofactor_matrix() * slope)

    def numeric(entries: Any, shape: tuple[int, ...]) -> Callable:
        function = sp.lambdify(variables, list(entries), cse=True)

        def at(points: NDArray) -> NDArray:
            columns = points[:, :dimension].T
            return np.stack([np.broadcast_to(v, len(points)) for v in function(*columns)], 1).reshape(-1, *shape)

        return at

    return numeric(u, (dimension,)), numeric(H, (dimension, dimension)), numeric(b, (dimension,))


def errors(problem: ElasticProblem, exact: Callable, gradient: Callable) -> tuple[float, float]:
    """Relative L2 norms of u - u_exact and of its gradient, by a rule four degrees finer than the elements."""
    import numpy as np
    import ufl

    from extremal.forms import compat

    space, d = problem.space, problem.space.dimension
    points, weights = compat.rule(d, 2 * space.degree + 4)
    cells = np.arange(space.cells, dtype=np.int32)

    def at(what: Any) -> NDArray:
        found = compat.evaluate(compat.expression(what, points), space.mesh, cells)
        return np.asarray(found).reshape(-1, *what.ufl_shape)

    x = at(ufl.SpatialCoordinate(space.mesh))
    volume = at(abs(ufl.JacobianDeterminant(space.mesh)) * ufl.as_vector([1.0]))
    w = (volume.reshape(space.cells, -1) * weights).ravel()

    def relative(found: NDArray, wanted: NDArray) -> float:
        parts = [w @ (values.reshape(len(x), -1) ** 2).sum(axis=1) for values in (found - wanted, wanted)]
        over, under = (space.comm.allreduce(float(part)) for part in parts)
        return float(np.sqrt(over / under))

    return relative(at(space.u), exact(x)), relative(at(ufl.grad(space.u)), gradient(x))
