"""Residual and tangent of the elastic problem against UFL's own derivatives of the energy."""

import numpy as np
import pytest
import ufl
from mpi4py import MPI
from petsc4py import PETSc

from extremal import meshes
from extremal.forms import compat
from extremal.forms.laws import law
from extremal.forms.material import Material, lame_parameters
from extremal.forms.problem import ElasticProblem


def energy(name, F, d, μ, λ):
    """Ψ as textbooks print it; plane strain in 2D."""
    J, C = ufl.det(F), F.T * F
    first = ufl.tr(C)
    if name == "neo_hookean":
        return μ / 2 * (first - d) - μ * ufl.ln(J) + λ / 2 * ufl.ln(J) ** 2
    second = (first**2 - ufl.tr(C * C)) / 2
    if d == 2:
        first, second = first + 1, second + first
    deviatoric = first * J ** (-2 / 3) - 3 + second * J ** (-4 / 3) - 3
    return μ / 4 * deviatoric + (λ + 2 * μ / 3) / 2 * (J - 1) ** 2


@pytest.mark.mpi
@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("name", ["neo_hookean", "mooney_rivlin"])
def test_forces_and_tangent_are_the_derivatives_ufl_finds(name, d, degree, comm: MPI.Intracomm):
    mesh = meshes.box(size=[1.0] * d, cell_size=0.5, dimension=d) if comm.rank == 0 else None
    domain = meshes.distribute(comm, mesh)
    material = Material(law(name, d), {"young_modulus": 1.0, "poisson_ratio": 0.4}, extension="none")
    problem = ElasticProblem(
        domain, {region: material for region in domain.region_names}, degree=degree, exact_tangent=True
    )
    problem.start()
    space, u = problem.space, problem.space.u
    x = space.positions
    u.x.array[:] = (0.1 * np.sin(3 * x[:, ::-1] + np.arange(d)) + 0.2 * x).ravel()

    μ, λ = lame_parameters(1.0, 0.4)
    total = energy(name, ufl.Identity(d) + ufl.grad(u), d, μ, λ) * space.dx
    residual = ufl.derivative(total, u)
    expected = compat.form(residual)
    b = compat.vector(expected)
    b.set(0.0)
    compat.add_vector(b, expected)
    b.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
    form = compat.form(ufl.derivative(residual, u))
    A = compat.matrix(form)
    compat.add_matrix(A, form, [])
    A.assemble()

    at, force, tangent = b.duplicate(), b.duplicate(), A.duplicate()
    compat.vector_of(u).copy(at)
    problem.equations.residual(at, force)
    problem.equations.tangent(at, tangent, projected=False)
    force.axpy(-1.0, b)
    assert force.norm() <= 1e-12 * b.norm()
    size = A.norm()
    tangent.axpy(-1.0, A)
    assert tangent.norm() <= 1e-12 * size
