"""Manufactured solutions: the displacement converges with the order that the elements promise.

A displacement with stretches between about 0.6 and 1.7 is chosen, its body force follows from the energy, and the
boundary is held where the displacement says. Errors must fall as size^(k+1) in L2 and size^k in H1 for elements of
degree k; the fitted slope may fall short by the stated margin. Near incompressibility the margin is larger because
the meshes are too coarse for the last digits of the slope, not because the elements lock: the displacement changes
volume.
"""

import numpy as np
import pytest
import sympy as sp
from elastic_bodies import (
    DIRECT,
    Manufactured,
    X,
    c2_neo_hookean_2d,
    errors,
    material,
    neo_hookean,
    on,
    petsc_options,
    problem,
    slope,
)
from mpi4py import MPI

from extremal.forms import Prescribed

x, y, z = X
WAVES_2D = [sp.sin(2 * x + y) / 4, sp.cos(x - 2 * y) / 5 + x * y / 5]
WAVES_3D = [sp.sin(2 * x + y - z) / 4, sp.cos(x - 2 * y) / 5, sp.sin(x + y + z) / 5]
LONG_WAVES_3D = [sp.sin(x + y - z) / 4, sp.cos(x - y) / 4, sp.sin(x + y + z) / 4]


def observed(displacement, slopes, stuff, degree, divisions):
    """Fitted orders in L2 and H1 of regular meshes with the given numbers of divisions."""
    exact, d = Manufactured(displacement, slopes), len(displacement)
    held = Prescribed(boundary=("surface",), motion=exact.displacement)
    found = []
    for n in divisions:
        domain = on(MPI.COMM_SELF, "box", cell_size=1 / n, dimension=d, structured=True)
        with petsc_options(**DIRECT):
            body = problem(
                domain, stuff, degree=degree, prescribed=[held], body_force=exact.body_force, tolerance=1e-6
            )
        body.advance(1.0)
        found.append(errors(body, exact))
    sizes = 1 / np.array(divisions)
    return tuple(slope(sizes, values) for values in np.array(found).T)


@pytest.mark.parametrize(
    "poisson_ratio, degree, divisions, margin",
    [
        (0.3, 1, (4, 8, 16), 0.05),
        (0.49, 1, (4, 8, 16, 32), 0.05),
        (0.3, 2, (4, 8, 16), 0.05),
        (0.49, 2, (4, 8, 16), 0.15),
    ],
)
def test_plane_displacements_converge_with_the_order_of_the_elements(
    poisson_ratio, degree, divisions, margin
):
    stuff = material(2, poisson_ratio, threshold=0.3)  # J stays above: the base law everywhere
    l2, h1 = observed(WAVES_2D, neo_hookean(1, poisson_ratio, 2), stuff, degree, divisions)
    assert l2 > degree + 1 - margin
    assert h1 > degree - margin


@pytest.mark.parametrize(
    "poisson_ratio, degree, displacement, divisions, margin",
    [
        (0.3, 1, WAVES_3D, (2, 4, 8), 0.1),
        (0.49, 1, WAVES_3D, (2, 4, 8), 0.15),
        (0.3, 2, WAVES_3D, (2, 4), 0.15),
        (0.49, 2, LONG_WAVES_3D, (3, 6), 0.25),
    ],
)
def test_displacements_in_space_converge_with_the_order_of_the_elements(
    poisson_ratio, degree, displacement, divisions, margin
):
    stuff = material(3, poisson_ratio, threshold=0.3)
    l2, h1 = observed(displacement, neo_hookean(1, poisson_ratio, 3), stuff, degree, divisions)
    assert l2 > degree + 1 - margin
    assert h1 > degree - margin


@pytest.mark.parametrize("degree, l2_margin", [(1, 0.05), (2, 0.6)])
def test_orders_hold_where_the_c2_extension_is_active_in_part_of_the_body(degree, l2_margin):
    """The body force has a kink where J = ε, which no mesh follows: of P2's third order in L2 at least 2.4 remain."""
    slopes, threshold = c2_neo_hookean_2d(1, 0.3, 0.9), 0.9
    J = Manufactured(WAVES_2D, slopes).determinant(np.random.default_rng(0).uniform(0, 1, (1000, 2)))
    assert 0.1 < np.mean(J < threshold) < 0.9
    l2, h1 = observed(WAVES_2D, slopes, material(2, 0.3, threshold=threshold), degree, (4, 8, 16, 32))
    assert l2 > degree + 1 - l2_margin
    assert h1 > degree - 0.05
