"""The decomposition F = U diag(σ) Vᵀ with its sign convention, and when it is not needed (6.2.1, 6.3.1)."""

import numpy as np
import pytest
import sympy as sp

from extremal.forms.kernel import Kernel
from extremal.forms.laws import custom, law

ROUNDING = 2e-15


def rotations(d, count, seed):
    q, r = np.linalg.qr(np.random.default_rng(seed).normal(size=(count, d, d)))
    q *= np.sign(np.einsum("nii->ni", r))[:, None, :]
    q[:, :, 0] *= np.sign(np.linalg.det(q))[:, None]
    return q


def with_stretches(σ, seed=0):
    """F with the given stretches (n, d), turned at random on both sides."""
    n, d = σ.shape
    return np.einsum("nij,nj,nkj->nik", rotations(d, n, seed), σ, rotations(d, n, seed + 1))


def matrices(kind, d):
    rng = np.random.default_rng(11)
    F = rng.normal(size=(300, d, d))
    if kind == "random":
        return F
    if kind.startswith("scale"):
        return float(kind.split()[1]) * F
    if kind.startswith("rank"):
        rank = int(kind.split()[1])
        return np.einsum("nik,njk->nij", F[:, :, :rank], rng.normal(size=(300, d, d))[:, :, :rank])
    if kind == "repeated":
        return with_stretches(np.repeat(rng.uniform(0.5, 2, size=(300, 1)), d, axis=1))
    if kind == "graded":
        return with_stretches(10.0 ** rng.uniform(-7, 7, size=(300, d)))
    corners = rng.integers(-1, 2, size=(300, d, d))  # many repeated, zero and opposite stretches
    return corners.astype(float)


KINDS = ["random", "corners", "repeated", "graded", "rank 0", "rank 1", "rank 2", "scale 1e-9", "scale 1e9"]


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("kind", KINDS)
def test_decomposition_obeys_the_convention(kind, d):
    if kind == "rank 2" and d == 2:
        pytest.skip("full rank in two dimensions")
    kernel = Kernel(law("corotated", d), "none")
    given = matrices(kind, d)
    G = np.ascontiguousarray((given - np.eye(d)).reshape(-1, d * d))
    F = G.reshape(-1, d, d) + np.eye(d)  # as the kernel adds it
    U, σ, V = kernel.decomposition(G)
    size = np.maximum(np.abs(σ).max(axis=1), np.finfo(float).tiny)

    rebuilt = np.einsum("nij,nj,nkj->nik", U, σ, V)
    assert (np.abs(rebuilt - F).max(axis=(1, 2)) <= ROUNDING * size).all()
    for Q in (U, V):
        assert np.abs(np.einsum("nij,nik->njk", Q, Q) - np.eye(d)).max() <= ROUNDING
        assert np.abs(np.linalg.det(Q) - 1).max() <= ROUNDING
    assert (np.diff(σ[:, :-1], axis=1) <= 0).all() and (σ[:, :-1] >= 0).all()
    assert (σ[:, -2] - np.abs(σ[:, -1]) >= -ROUNDING * size).all()
    # the last stretch carries the sign of det F wherever rounding leaves that a sign
    determinant = np.linalg.det(F / size[:, None, None])
    clear = np.abs(determinant) > 1e-14
    assert (np.sign(σ[clear, -1]) == np.sign(determinant[clear])).all()
    assert np.abs(np.abs(σ) - np.linalg.svd(F, compute_uv=False)).max() <= ROUNDING * size.max()
    assert np.array_equal(kernel.stretches(G), σ)


@pytest.mark.parametrize("d", [2, 3])
def test_nothing_turned_stays_where_it_is(d):
    """F = 0 gives R = U Vᵀ = I: a body collapsed to a point unfolds the way it was."""
    kernel = Kernel(law("corotated", d), "none")
    U, σ, V = kernel.decomposition(-np.eye(d).reshape(1, -1))
    assert np.array_equal(U[0] @ V[0].T, np.eye(d))
    assert np.array_equal(σ, np.zeros((1, d)))


def test_any_number_of_points_gives_the_same():
    """Points are taken eight at a time; the last, incomplete pack is no different."""
    kernel = Kernel(law("neo_hookean", 3), "c2")
    G = np.random.default_rng(2).normal(size=(19, 9))
    parameters = np.array([[0.4, 1.7, 0.9, 0.0]])
    together, single = np.empty((19, 9)), np.empty((1, 9))
    kernel.evaluate(G, parameters, stress=together)
    for k in range(19):
        kernel.evaluate(G[k : k + 1].copy(), parameters, stress=single)
        assert np.array_equal(single[0], together[k])


mu, lam, J, s1, s2, s3 = sp.symbols("mu lam J s1 s2 s3")
IN_STRETCHES = {
    2: mu / 2 * (s1**2 + s2**2 - 2) - mu * sp.log(s1 * s2) + lam / 2 * sp.log(s1 * s2) ** 2,
    3: mu / 2 * (s1**2 + s2**2 + s3**2 - 3) - mu * sp.log(J) + lam / 2 * sp.log(J) ** 2,
}


def allowed(σ, extension, ε):
    """Where the notes on 6.3.1 allow to do without stretches: for C1, J > 0 and J² >= ε² I2 (2D: I1)."""
    J = σ.prod(axis=1)
    squares = σ**2
    if extension == "c1":
        bound = squares.sum(axis=1) if σ.shape[1] == 2 else (J[:, None] ** 2 / squares).sum(axis=1)
        return (J > 0) & (J**2 >= ε**2 * bound)
    return J >= ε


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("extension, ε", [("c1", 0.4), ("c2", 0.9), ("ife", 0.9)])
def test_stretches_are_left_out_exactly_where_they_may_be(extension, ε, d):
    rng = np.random.default_rng(8)
    σ = np.sort(rng.uniform(-0.2, 2.0, size=(500, d)), axis=1)[:, ::-1]
    σ = σ[σ[:, -1] + σ[:, -2] > 0.05]
    F = with_stretches(σ)
    G = np.ascontiguousarray((F - np.eye(d)).reshape(-1, d * d))
    parameters = np.array([[0.4, 1.7, ε, 20.0]])
    kernel = Kernel(law("neo_hookean", d), extension)
    one, skipped = np.empty((1, d * d)), []
    for g in G:
        skipped.append(kernel.evaluate(g.reshape(1, -1), parameters, stress=one))
    assert np.array_equal(np.array(skipped, dtype=bool), allowed(σ, extension, ε))
    assert 0.2 < np.mean(skipped) < 0.9
    if extension == "c1":  # and every stretch there is indeed above ε
        assert (σ[np.array(skipped, dtype=bool)].min(axis=1) >= ε).all()


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("extension, ε", [("none", 0.0), ("c1", 0.4), ("c2", 0.9), ("ife", 0.9)])
def test_stress_without_stretches_is_the_stress_with_them(extension, ε, d):
    """Against the same energy written in stretches, which cannot do without."""
    rng = np.random.default_rng(9)
    least = 0.05 if extension == "none" else -0.5
    σ = np.sort(rng.uniform(least, 2.0, size=(400, d)), axis=1)[:, ::-1]
    σ = σ[σ[:, -1] + σ[:, -2] > 0.1]
    G = np.ascontiguousarray((with_stretches(σ) - np.eye(d)).reshape(-1, d * d))
    parameters = np.array([[0.4, 1.7, ε, 20.0]])
    found = []
    for made in (law("neo_hookean", d), custom(IN_STRETCHES[d], d)):
        kernel = Kernel(made, extension)
        Ψ, P = np.empty(len(G)), np.empty((len(G), d * d))
        found.append((kernel.evaluate(G, parameters, energy=Ψ, stress=P), Ψ, P))
    (some, Ψ1, P1), (none, Ψ2, P2) = found
    assert some > 0 and none == 0
    terms = np.linalg.norm(P1, axis=1) + 2 + (1 / np.abs(σ[:, -1]) ** 2 if extension == "none" else 0)
    assert (np.abs(Ψ1 - Ψ2) <= 1e-13 * terms).all()
    assert (np.linalg.norm(P1 - P2, axis=1) <= 1e-13 * terms).all()


@pytest.mark.parametrize("size", [1e-9, 1e-5, 1e-2])
def test_rounding_lets_no_tiny_state_pass_for_an_undeformed_one(size):
    """Both sides of J² >= ε² I2 vanish for F -> 0: C1 must not take the law itself there."""
    G = size * rotations(3, 50, 4) - np.eye(3)
    parameters = np.array([[0.4, 1.7, 0.4, 20.0]])
    P = np.empty((50, 9))
    kernel = Kernel(law("neo_hookean", 3), "c1")
    assert kernel.evaluate(np.ascontiguousarray(G.reshape(50, 9)), parameters, stress=P) == 0
    assert np.isfinite(P).all()
