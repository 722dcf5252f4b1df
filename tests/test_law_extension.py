"""The extensions where regions meet, and what they do to inverted states (6.3, B.2.1, B.3.7)."""

from itertools import combinations

import numpy as np
import pytest
from scipy.optimize import brentq, minimize

from extremal.forms.kernel import Kernel
from extremal.forms.laws import ENERGIES, law
from extremal.forms.material import Material, lame_parameters

μ, λ, K = 0.4, 1.7, 20.0


def response(name, extension, ε, σ, k=K, lame=(μ, λ)):
    made = law(name, len(σ))
    values = [*lame, 0.3][: len(made.parameters)]
    Ψ, g, H = Kernel(made, extension).response(np.array([σ]), [*values, ε, k])
    return Ψ[0], g[0], H[0]


def limits(name, extension, ε, at, way):
    """Ψ, g, H on both sides of `at` along `way`, continued to it from two steps: errors are O(step²)."""
    step = 1e-7
    sides = []
    for sign in (1, -1):
        near, far = (response(name, extension, ε, at + sign * n * step * way) for n in (1, 2))
        sides.append([2 * a - b for a, b in zip(near, far)])
    return sides


@pytest.mark.parametrize(
    "σ", [(1.4, 0.64), (0.95, 0.95), (1.5, 1.0, 0.6), (1.2, 1.2, 0.62), (0.97, 0.97, 0.97)]
)
@pytest.mark.parametrize("name", ENERGIES)
def test_c2_stress_and_its_derivative_are_continuous_across_the_threshold(name, σ):
    σ = np.array(σ)
    σ *= (0.9 / σ.prod()) ** (1 / len(σ))
    for way in (σ - 1, np.ones(len(σ)), np.arange(1.0, len(σ) + 1)):
        above, below = limits(name, "c2", 0.9, σ, way / np.linalg.norm(way))
        for one, other in zip(above, below):
            assert np.abs(one - other).max() <= 1e-9 * (1 + np.abs(one).max())


@pytest.mark.parametrize("σ", [(1.4, 0.9 / 1.4), (1.5, 1.0, 0.6)])
@pytest.mark.parametrize("name", ENERGIES)
def test_ife_stress_is_continuous_and_its_derivative_frozen(name, σ):
    σ = np.array(σ) * (0.9 / np.prod(σ)) ** (1 / len(σ))
    above, below = limits(name, "ife", 0.9, σ, σ - 1)
    assert np.abs(above[1] - below[1]).max() <= 1e-9 * (1 + np.abs(above[1]).max())
    inverted = 1 + 3.0 * (σ - 1)
    _, g, H = response(name, "ife", 0.9, inverted)
    _, g0, H0 = response(name, "none", 0.0, σ)
    assert np.allclose(H, H0, rtol=1e-12, atol=1e-12)
    assert np.allclose(g, g0 + H0 @ (inverted - σ), rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("name", ENERGIES)
def test_ife_tangent_is_that_of_the_threshold(name, dimension):
    """Not of the stress: that is the inconsistency of the original (6.2)."""
    σ = np.array([1.2, 0.8, -0.3]) if dimension == 3 else np.array([1.2, -0.3])
    made = law(name, dimension)
    values = [μ, λ, 0.3][: len(made.parameters)]
    size = dimension**2
    s = brentq(lambda t: np.prod(1 + t * (σ - 1)) - 0.9, 0, 1, xtol=1e-15)
    found = []
    for extension, at in (("ife", σ), ("none", 1 + s * (σ - 1))):
        A = np.empty((1, size, size))
        G = np.diag(at - 1).reshape(1, size)
        Kernel(made, extension).evaluate(G, np.array([[*values, 0.9, 0.0]]), tangent=A, project=False)
        found.append(A[0])
    assert np.abs(found[0] - found[1]).max() <= 1e-12 * np.abs(found[1]).max()


BOUNDARIES = [
    (dimension, at_edge, below)
    for dimension in (2, 3)
    for at_edge in range(1, dimension + 1)
    for below in range(dimension - at_edge + 1)
]


@pytest.mark.parametrize("dimension, at_edge, below", BOUNDARIES)
@pytest.mark.parametrize("name", ENERGIES)
def test_c1_stress_is_continuous_and_its_derivative_jumps(name, dimension, at_edge, below):
    """Where `at_edge` stretches cross ε while `below` others are under it already."""
    ε = 0.4
    σ = np.array([1.3, 0.9, 0.7][: dimension - at_edge - below] + [ε] * at_edge + [0.1, -0.05][:below])
    edge = np.arange(dimension - at_edge - below, dimension - below)
    way = np.zeros(dimension)
    way[edge] = 1 + 0.3 * np.arange(at_edge)[::-1]  # keeps the order on the upper side
    step = 1e-7
    upper = [response(name, "c1", ε, σ + n * step * way) for n in (1, 2)]
    lower = [response(name, "c1", ε, np.sort(σ - n * step * way)[::-1]) for n in (1, 2)]
    above, under = ([2 * a - b for a, b in zip(*side)] for side in (upper, lower))
    for one, other in zip(above[:2], under[:2]):
        assert np.abs(np.sort(np.atleast_1d(one)) - np.sort(np.atleast_1d(other))).max() <= 1e-9 * (
            1 + np.abs(one).max()
        )
    jump = np.abs(above[2][edge, edge] - under[2][edge, edge])
    assert (jump > 0.1).all()
    assert np.abs(under[2][edge, edge] - K).max() <= 1e-9 * K  # k/2 (σ - ε)² and nothing else


def inverted_minimum(extension, poisson_ratio, stiffness=None, starts=12):
    """Smallest Ψ that L-BFGS finds from far out, over F, with E = 1; None: the default stiffness."""
    material = Material(
        law("neo_hookean", 3),
        {"young_modulus": 1.0, "poisson_ratio": poisson_ratio},
        extension=extension,
        stiffness=stiffness,
    )
    kernel, parameters = Kernel(material.law, extension), material.values(np.zeros((1, 3)))
    Ψ, P = np.empty(1), np.empty((1, 9))

    def energy(x):
        kernel.evaluate(x.reshape(1, 9) - np.eye(3).reshape(1, 9), parameters, energy=Ψ, stress=P)
        return Ψ[0], P[0].copy()

    rng = np.random.default_rng(7)
    least = (np.inf, np.zeros(9))
    for size in np.geomspace(2, 40, starts):
        start = size * rng.normal(size=9) if size < 30 else np.diag([35.0, 35.0, -12.0]).ravel()
        found = minimize(energy, start, jac=True, method="L-BFGS-B", options={"maxiter": 500})
        least = min(least, (found.fun, found.x), key=lambda pair: pair[0])
    σ = kernel.stretches((least[1] - np.eye(3).ravel()).reshape(1, 9))[0]
    return least[0], σ


def test_c1_with_k_of_20_e_prefers_inversion_when_nearly_incompressible():
    """6.4's k = 20 E at ν = .49, ε = .4: a stretched, inverted state has less energy than rest."""
    energy, σ = inverted_minimum("c1", 0.49, stiffness=20.0)
    assert energy < -1
    assert σ[2] < 0 and σ[0] > 10


@pytest.mark.parametrize("poisson_ratio", [0.3, 0.45, 0.49, 0.499])
@pytest.mark.parametrize("extension", ["c1", "c2"])
def test_rest_has_the_least_energy_with_the_default_stiffness(extension, poisson_ratio):
    energy, σ = inverted_minimum(extension, poisson_ratio)
    assert -1e-12 <= energy <= 1e-6 and np.abs(σ - 1).max() < 1e-2
    assert smallest(extension, poisson_ratio) >= 0


def smallest(extension, poisson_ratio, stiffness=None):
    """Smallest Ψ on a grid of stretches up to 10⁴, all signs the convention allows."""
    lame = lame_parameters(1.0, poisson_ratio)
    ε = {"c1": 0.4, "c2": 0.9}[extension]
    k = max(20.0, lame[1] / ε**2) if stiffness is None else stiffness
    axis = np.concatenate([[1e-6], np.geomspace(0.02, 1e4, 45), [1.0]])
    pairs = np.array([(a, b) for a, b in combinations(np.sort(axis)[::-1], 2)] + [(a, a) for a in axis])
    part = np.linspace(-1, 1, 41)
    σ = np.concatenate([np.column_stack([pairs, p * pairs[:, 1]]) for p in part])
    return Kernel(law("neo_hookean", 3), extension).response(σ, [*lame, ε, k])[0].min()


def test_the_grid_sees_the_false_minimum():
    assert smallest("c1", 0.49, stiffness=20.0) < 0
