"""The formulas one would write first, beside ours, at the states in docs/stability.md that break them."""

import numpy as np
import pytest
from mpi4py import MPI

from extremal import forms
from extremal.forms.kernel import Kernel
from extremal.hawkes.energy import Energy
from extremal.hawkes.events import Events, Network
from extremal.hawkes.slots import Slots

pytestmark = pytest.mark.hard
MU, LAMBDA = 1 / 2.6, 0.3 / (1.3 * 0.4)  # E = 1, ν = 0.3


def kernel(extension="none"):
    """The kernel of the Neo-Hookean law and the values of its parameters."""
    material = forms.Material(
        forms.law("neo_hookean", 3), {"young_modulus": 1.0, "poisson_ratio": 0.3}, extension=extension
    )
    return Kernel(material.law, extension, MPI.COMM_SELF), material.values(np.zeros((1, 3)))


def tangent(F, extension="none"):
    made, values = kernel(extension)
    out = np.empty((1, 9, 9))
    made.evaluate((F - np.eye(3)).reshape(1, 9), values, project=False, tangent=out)
    return out[0]


@pytest.mark.parametrize(("gap", "lost"), [(1e-8, 1e-10), (1e-12, 1e-6), (0.0, np.inf)])
def test_difference_quotients_lose_their_digits_at_equal_stretches_and_ours_do_not(gap, lost):
    """(g1 - g2)/(σ1 - σ2) with g = ∂Ψ/∂σ is the stiffness of the shear e12 + e21."""
    σ = np.array([1.1 + gap, 1.1, 0.8])
    product, J = σ[0] * σ[1], σ.prod()
    exact = MU + (MU - LAMBDA * np.log(J)) / product
    g = MU * σ - MU / σ + LAMBDA * np.log(J) / σ
    with np.errstate(invalid="ignore"):
        naive = (g[0] - g[1]) / (σ[0] - σ[1])
    A = tangent(np.diag(σ))
    assert A[1, 1] + A[1, 3] == pytest.approx(exact, rel=1e-14)
    assert not abs(naive / exact - 1) < lost


@pytest.mark.parametrize("gap", [1e-2, 1e-5, 1e-8, 0.0])
def test_the_tangent_at_the_kink_grows_as_one_over_the_gap_and_no_further_than_its_guard(gap):
    """(g2 + g3)/(σ2 + σ3): unguarded it is infinite at the kink, where stress is finite but jumps."""
    eigenvalues = np.linalg.eigvalsh(tangent(np.diag([1.3, 0.6, gap - 0.6]), "c2"))
    assert eigenvalues[0] == pytest.approx(-3.97 / max(gap, 1e-6), rel=1e-2)
    assert eigenvalues[-1] < 3


@pytest.mark.parametrize("flat", [1e-8, 0.0])
def test_rotations_by_eigenvectors_of_ftf_are_none_for_flat_elements_and_our_stress_is_right(flat):
    """U = F V Σ⁻¹ divides by the root of a rounded square; the worst of twenty orientations."""
    made, values = kernel("c2")
    rng = np.random.default_rng(0)
    straight = np.diag([1.2, 0.7, flat])
    naive, ours = [], []
    for _ in range(20):
        Q, S = (np.linalg.qr(rng.normal(size=(3, 3)))[0] for _ in range(2))
        Q, S = Q * np.linalg.det(Q), S * np.linalg.det(S)
        F = Q @ straight @ S
        squares, V = np.linalg.eigh(F.T @ F)
        with np.errstate(invalid="ignore", divide="ignore"):
            U = F @ V / np.sqrt(squares)
        naive.append(np.abs(U.T @ U - np.eye(3)).max())
        stress = np.empty((2, 9))
        made.evaluate(np.stack([F - np.eye(3), straight - np.eye(3)]).reshape(2, 9), values, stress=stress)
        ours.append(np.abs(stress[0].reshape(3, 3) - Q @ stress[1].reshape(3, 3) @ S).max())
    assert not max(naive) < 0.1
    # F itself is rounded by some eps, and the stress changes by some E for a change of F by 1
    assert max(ours) < 1e-13


@pytest.mark.parametrize("offset", [0.0, 1e4, 19675.0])
def test_prefix_sums_of_exponentials_overflow_with_the_calendar_and_the_recursion_does_not(offset):
    """Σ e^(-ω(t - s)) over earlier events as e^(-ωt) Σ e^(ωs); days since 1970 are 19675 in 2023."""
    time, decay = np.array([0.0, 3.0, 7.0]) + offset, 0.1
    with np.errstate(all="ignore"):
        naive = np.exp(-decay * time[2]) * np.exp(decay * time[:2]).sum()
    net = Network.complete(2, 0.1, 1.0 / decay, decay)  # θω = 1
    slots = Slots.build(MPI.COMM_SELF, net, Events(time, np.full((3, 2), -1), float(time[-1])))
    ours = Energy(slots).couple(np.ones(3))[2]
    exact = np.exp(-0.7) + np.exp(-0.4)
    assert ours == pytest.approx(exact, rel=1e-12)
    assert np.isfinite(naive) == (offset == 0)
