"""The projected tangent, frame indifference and isotropy (sections 6.1, B.1)."""

import numpy as np
import pytest
from test_law_svd import rotations

from extremal.forms.kernel import Kernel
from extremal.forms.laws import ENERGIES, law

CASES = [
    (name, extension)
    for name in ENERGIES
    for extension in ("none", "c1", "c2", "ife")
    if extension != "none" or name not in ("neo_hookean", "mooney_rivlin")
]
THRESHOLD = {"none": 0.0, "c1": 0.4, "c2": 0.9, "ife": 0.9}


def parameters(made, extension):
    return np.array([[*[0.4, 1.7, 0.3][: len(made.parameters)], THRESHOLD[extension], 20.0]])


def states(d, count=150):
    """Random F of all kinds, rest among them."""
    rng = np.random.default_rng(3)
    G = rng.uniform(0, 1.5, size=(count, 1)) * rng.normal(size=(count, d * d))
    G[0] = 0
    return G


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("name, extension", CASES)
def test_projection_cuts_the_negative_eigenvalues_and_nothing_else(name, extension, d):
    made = law(name, d)
    kernel, G = Kernel(made, extension), states(d)
    n, size = G.shape
    exact, projected = np.empty((n, size, size)), np.empty((n, size, size))
    kernel.evaluate(G, parameters(made, extension), tangent=exact, project=False)
    kernel.evaluate(G, parameters(made, extension), tangent=projected)
    values, vectors = np.linalg.eigh(exact)
    scale = np.abs(values).max(axis=1)
    clamped = np.einsum("nik,nk,njk->nij", vectors, np.maximum(values, 0), vectors)
    # LAPACK's and our eigenvectors are each good to a few roundings of the largest eigenvalue
    assert (np.abs(projected - clamped).max(axis=(1, 2)) <= 1e-13 * scale).all()
    assert (np.linalg.eigvalsh(projected)[:, 0] >= -1e-14 * scale).all()
    positive = values[:, 0] > 1e-12 * scale
    assert positive.any() and not positive.all()
    assert np.array_equal(projected[positive], exact[positive])


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("name, extension", CASES)
def test_stress_turns_with_the_body_and_with_the_material(name, extension, d):
    """P(Q F R) = Q P(F) R for rotations Q and R; Ψ does not change."""
    made = law(name, d)
    kernel, F = Kernel(made, extension), states(d).reshape(-1, d, d) + np.eye(d)
    σ = kernel.stretches(np.ascontiguousarray((F - np.eye(d)).reshape(-1, d * d)))
    F = F[σ[:, -1] + σ[:, -2] > 1e-2]
    n = len(F)
    Q, R = rotations(d, n, 20), rotations(d, n, 21)
    found = []
    for at in (F, Q @ F @ R):
        Ψ, P = np.empty(n), np.empty((n, d * d))
        G = np.ascontiguousarray((at - np.eye(d)).reshape(n, d * d))
        kernel.evaluate(G, parameters(made, extension), energy=Ψ, stress=P)
        found.append((Ψ, P.reshape(n, d, d)))
    (Ψ1, P1), (Ψ2, P2) = found
    # the turned F is rounded: an error of the stiffness times that rounding, up to 1/(σ2 + σ3) times more
    terms = 100 * (1 + np.linalg.norm(P1, axis=(1, 2)))
    assert (np.abs(Ψ1 - Ψ2) <= 1e-13 * terms * (1 + np.linalg.norm(F, axis=(1, 2)))).all()
    assert (np.linalg.norm(P2 - Q @ P1 @ R, axis=(1, 2)) <= 1e-13 * terms).all()


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("name", ENERGIES)
def test_small_strains_are_linear_elasticity(name, d):
    """At rest Ψ = P = 0 and ∂P/∂F : δ = μ(δ + δᵀ) + λ tr(δ) I."""
    made = law(name, d)
    size = d * d
    Ψ, P, A = np.empty(1), np.empty((1, size)), np.empty((1, size, size))
    kernel = Kernel(made, "none")
    kernel.evaluate(np.zeros((1, size)), parameters(made, "none"), energy=Ψ, stress=P)
    kernel.evaluate(np.zeros((1, size)), parameters(made, "none"), tangent=A, project=False)
    identity = np.eye(d)
    linear = 0.4 * (
        np.einsum("ik,jl->ijkl", identity, identity) + np.einsum("il,jk->ijkl", identity, identity)
    )
    linear += 1.7 * np.einsum("ij,kl->ijkl", identity, identity)
    assert abs(Ψ[0]) <= 1e-16 and np.abs(P).max() <= 1e-15
    assert np.abs(A[0] - linear.reshape(size, size)).max() <= 1e-14
