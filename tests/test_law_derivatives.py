"""Appendix B.4: Ψ, P and ∂P/∂F belong together, for every law, extension and dimension.

For δ small, f(x + δ) - f(x) - (∇f(x + δ) + ∇f(x))·δ/2 = O(|δ|³). With a wrong derivative it is O(|δ|): a step
ten times smaller must bring the error down a thousand times, or to rounding.
"""

import numpy as np
import pytest
import sympy as sp

from extremal.forms.kernel import Kernel
from extremal.forms.laws import ENERGIES, custom, law

I1, I2, J, i1, i2, s1, s2, s3, mu, lam, a = sp.symbols("I1 I2 J i1 i2 s1 s2 s3 mu lam a")
d = sp.Symbol("d")
OGDEN = {
    2: mu / a * (s1**a + s2**a - 2) - mu * sp.log(J) + lam / 2 * sp.log(J) ** 2,
    3: mu / a * (s1**a + s2**a + s3**a - 3) - mu * sp.log(J) + lam / 2 * sp.log(J) ** 2,
}
CUSTOM = {
    "in i1, J": {n: mu * (i1 - d) ** 2 / 3 - mu * sp.log(J) / 2 + lam * (J - 1) ** 2 for n in (2, 3)},
    "in i1, i2, J": {3: mu * (i1 * i2 / J - 9) + lam / 2 * (sp.log(J) + i1 - 3) ** 2},
    "in I1, I2, J": {
        2: mu / 2 * (I1 / J - 2) ** 2 + lam * (J - 1 / J) ** 2,
        3: mu / 2 * (I1 * I2 / J**2 - 9) + lam * (J - 1 / J) ** 2,
    },
    "Ogden in stretches": OGDEN,
}
CASES = [(name, n) for name in ENERGIES for n in (2, 3)] + [
    (name, n) for name, of in CUSTOM.items() for n in of
]
THRESHOLD = {"none": 0.0, "c1": 0.4, "c2": 0.9}


def material(name, dimension):
    """Law and its parameters but ε and k."""
    if name in ENERGIES:
        made = law(name, dimension)
        return made, [0.4, 1.7, 0.3][: len(made.parameters)]
    energy = CUSTOM[name][dimension]
    extra = ("a",) if a in energy.free_symbols else ()
    return custom(energy, dimension, extra), [0.4, 1.7, *([1.3] if extra else [])]


def states(extension, dimension, count=200):
    """Random F, most of them flattened or inverted where the law is extended, none near the kink or a threshold."""
    rng = np.random.default_rng(5)
    F = np.eye(dimension) + rng.uniform(0.1, 1.0, size=(40 * count, 1, 1)) * rng.normal(
        size=(40 * count, dimension, dimension)
    )
    σ = np.linalg.svd(F, compute_uv=False)
    determinant = np.linalg.det(F)
    σ[:, -1] *= np.sign(determinant)
    good = (σ[:, -1] + σ[:, -2] > 0.05) & (σ[:, 0] < 4)
    if extension == "none":
        good &= σ[:, -1] > 0.3
    if extension == "c1":
        good &= np.abs(σ - 0.4).min(axis=1) > 0.02
    if extension == "c2":
        good &= np.abs(determinant - 0.9) > 0.05
    assert good.sum() >= count
    return F[good][:count]


@pytest.mark.parametrize("extension", ["none", "c1", "c2"])
@pytest.mark.parametrize("name, dimension", CASES, ids=[f"{name} {n}D" for name, n in CASES])
def test_derivatives_are_those_of_the_energy(name, dimension, extension):
    made, values = material(name, dimension)
    kernel = Kernel(made, extension)
    parameters = np.array([[*values, THRESHOLD[extension], 20.0]])
    F = states(extension, dimension)
    n, size = len(F), dimension**2
    x = (F - np.eye(dimension)).reshape(n, size)
    direction = np.random.default_rng(6).normal(size=(n, size))
    direction /= np.linalg.norm(direction, axis=1)[:, None]

    def at(G):
        Ψ, P, A = np.empty(n), np.empty((n, size)), np.empty((n, size, size))
        kernel.evaluate(np.ascontiguousarray(G), parameters, energy=Ψ, stress=P)
        kernel.evaluate(np.ascontiguousarray(G), parameters, tangent=A, project=False)
        return Ψ, P, A

    Ψ0, P0, A0 = at(x)
    errors = []
    for step in (3e-3, 3e-4):
        δ = step * direction
        Ψ1, P1, A1 = at(x + δ)
        energy = np.abs(Ψ1 - Ψ0 - np.einsum("ni,ni->n", P0 + P1, δ) / 2)
        stress = np.linalg.norm(P1 - P0 - np.einsum("nij,nj->ni", A0 + A1, δ) / 2, axis=1)
        errors.append(np.array([energy, stress]))
    size_of_terms = np.array([np.abs(Ψ0) + 1, np.linalg.norm(P0, axis=1) + 1])
    coarse, fine = (np.median(e / size_of_terms, axis=1) for e in errors)
    assert (fine < coarse / 700).all()
    # 3e-3³ = 2.7e-8 times third derivatives; a derivative that is wrong by 1e-6 would show
    assert (errors[1] <= 4e-3 * errors[0].max(axis=1, keepdims=True) + 1e-13 * size_of_terms).all()
    assert np.allclose(A0, A0.transpose(0, 2, 1), rtol=0, atol=1e-12 * np.abs(A0).max())


def test_a_wrong_derivative_would_be_found():
    """The check itself: a stress off by one part in a thousand makes the error fall tenfold only."""
    kernel = Kernel(law("neo_hookean", 3), "c2")
    parameters = np.array([[0.4, 1.7, 0.9, 0.0]])
    x = (states("c2", 3, 20) - np.eye(3)).reshape(20, 9)
    direction = np.random.default_rng(6).normal(size=(20, 9))
    errors = []
    for step in (3e-3, 3e-4):
        Ψ, P = np.empty((2, 20)), np.empty((2, 20, 9))
        for k, G in enumerate((x, x + step * direction)):
            kernel.evaluate(np.ascontiguousarray(G), parameters, energy=Ψ[k], stress=P[k])
        P *= 1 + 1e-3
        errors.append(
            np.median(np.abs(Ψ[1] - Ψ[0] - step * np.einsum("ni,ni->n", P[0] + P[1], direction) / 2))
        )
    assert errors[1] > errors[0] / 30
