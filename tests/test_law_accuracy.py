"""Ψ, P and ∂P/∂F of the kernel against references with 50 digits, from rest to the worst states.

One tolerance: 1e-13 of the terms that are added up. A function of F evaluated in floating point cannot do
better than answer for an F whose entries are a rounding away, so the terms are |Ψ| + |P||F|, |P| + |A||F|
and |A| + |∂A/∂F||F|; the last derivative is |A| over the distance in which A changes, σi + σj near the kink
and, for C1, σi - σj of two stretches on both sides of ε. (The terms of Mooney-Rivlin's energy do not vanish
at rest one by one: there |A||F|² counts as well.) 1e-13 is 450 roundings. From σi + σj < 1e-6 on the
tangent is clamped on purpose (appendix B.1) and not compared.
"""

from functools import cache

import law_reference as reference
import mpmath as mp
import numpy as np
import pytest

from extremal.forms.kernel import Kernel
from extremal.forms.laws import law

TOLERANCE = 1e-13
μ, λ = 0.34, 3.1  # E = 1, ν = .45
THRESHOLD = {"none": 0.0, "c1": 0.4, "c2": 0.9, "ife": 0.9}
STIFFNESS = 20.0
TURN = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])  # exact in floating point


def rotation(seed, d):
    q, r = np.linalg.qr(np.random.default_rng(seed).normal(size=(d, d)))
    q *= np.sign(np.diag(r))
    if np.linalg.det(q) < 0:
        q[:, 0] = -q[:, 0]
    return q


def turned(σ):
    d = len(σ)
    return rotation(1, d) @ np.diag(σ) @ rotation(2, d)


def volume(J, shape):
    """Stretches in the proportions `shape` with the product J."""
    shape = np.array(shape)
    return turned(shape * (J / np.prod(shape)) ** (1 / len(shape)))


SPACE = {
    "rest": np.eye(3),
    "small strain": np.eye(3) + 1e-9 * rotation(3, 3),
    "generic": turned([1.6, 1.1, 0.8]),
    "two equal": np.diag([1.5, 1.5, 0.75]) @ TURN,
    "two equal below": TURN @ np.diag([1.5, 0.25, 0.25]),
    "three equal": 1.25 * TURN,
    "three equal below": 0.25 * TURN,
    "nearly equal": turned([0.7 + 1e-3, 0.7, 0.7 - 1e-7]),
    "nearly equal below": turned([0.3 + 1e-3, 0.3, 0.3 - 1e-6]),
    "J above threshold": volume(0.9 + 1e-12, [1.2, 1.0, 0.9]),
    "J below threshold": volume(0.9 - 1e-12, [1.2, 1.0, 0.9]),
    "stretch above threshold": turned([1.3, 0.9, 0.4 + 1e-12]),
    "stretch below threshold": turned([1.3, 0.9, 0.4 - 1e-12]),
    "straddling threshold": turned([0.4 + 1e-4, 0.4 + 1e-6, 0.4 - 2e-6]),
    "flat": np.diag([1.2, 0.0, 0.7]) @ TURN,
    "nearly flat": turned([1.2, 0.7, 1e-9]),
    "inverted": turned([1.3, 0.8, -0.5]),
    "kink 1e-5": turned([1.3, 0.6, -0.6 + 1e-5]),
    "kink 1e-8": turned([1.3, 0.6, -0.6 + 1e-8]),
    "tiny": turned([1.3e-4, 1.0e-4, 0.8e-4]),
    "tiny inverted": turned([1.3e-4, 1.0e-4, -0.8e-4]),
    "huge": turned([1.3e4, 1.0e4, 0.8e4]),
    "huge inverted": turned([1.3e4, 1.0e4, -0.8e4]),
}
PLANE = {
    "rest": np.eye(2),
    "small strain": np.eye(2) + 1e-9 * rotation(3, 2),
    "generic": turned([1.6, 0.8]),
    "two equal": 1.25 * np.array([[0.0, -1.0], [1.0, 0.0]]),
    "two equal below": 0.25 * np.array([[0.0, -1.0], [1.0, 0.0]]),
    "nearly equal": turned([0.7 + 1e-3, 0.7]),
    "nearly equal below": turned([0.3 + 1e-6, 0.3]),
    "J above threshold": volume(0.9 + 1e-12, [1.2, 0.9]),
    "J below threshold": volume(0.9 - 1e-12, [1.2, 0.9]),
    "stretch above threshold": turned([1.3, 0.4 + 1e-12]),
    "stretch below threshold": turned([1.3, 0.4 - 1e-12]),
    "straddling threshold": turned([0.4 + 1e-6, 0.4 - 2e-6]),
    "flat": np.array([[0.0, -1.25], [0.0, 0.0]]),
    "nearly flat": turned([1.2, 1e-9]),
    "inverted": turned([1.3, -0.5]),
    "kink 1e-5": turned([0.6, -0.6 + 1e-5]),
    "kink 1e-8": turned([0.6, -0.6 + 1e-8]),
    "tiny": turned([1.3e-4, 0.8e-4]),
    "tiny inverted": turned([1.3e-4, -0.8e-4]),
    "huge": turned([1.3e4, 0.8e4]),
    "huge inverted": turned([1.3e4, -0.8e4]),
}
STATES = {2: PLANE, 3: SPACE}


@pytest.fixture(autouse=True)
def digits():
    with mp.workdps(reference.DIGITS):
        yield


def gradient(dimension, state):
    return (STATES[dimension][state] - np.eye(dimension)).ravel()


@cache
def stencil(dimension, state):
    return reference.Stencil(reference.exact(gradient(dimension, state)))


def kernel_values(name, extension, dimension, states):
    G = np.array([gradient(dimension, state) for state in states])
    n, size = G.shape
    Ψ, P, A = np.empty(n), np.empty((n, size)), np.empty((n, size, size))
    kernel = Kernel(law(name, dimension), extension)
    kernel.evaluate(G, parameters(name, extension), energy=Ψ, stress=P)
    again = np.empty_like(P)
    kernel.evaluate(G, parameters(name, extension), stress=again, tangent=A, project=False)
    return Ψ, P, again, A


def parameters(name, extension):
    share = [float(reference.SHARE)] if name == "mooney_rivlin" else []
    return np.array([[μ, λ, *share, THRESHOLD[extension], STIFFNESS]])


def usable(name, extension, dimension):
    states = STATES[dimension]
    if extension == "none" and name in reference.NEEDS_POSITIVE_J:
        return [s for s, F in states.items() if np.linalg.det(F) > 0 and "flat" not in s]
    return list(states)


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("extension", ["none", "c1", "c2"])
@pytest.mark.parametrize("name", reference.LAWS)
def test_energy_stress_and_tangent_have_all_their_digits(name, extension, dimension):
    states = usable(name, extension, dimension)
    Ψ, P, again, A = kernel_values(name, extension, dimension, states)
    ε, k = mp.mpf(THRESHOLD[extension]), mp.mpf(STIFFNESS)
    wrong = []
    for n, state in enumerate(states):
        points = stencil(dimension, state)
        Ψ_exact, P_exact, A_exact = points.differentiate(
            lambda σ: reference.extended(name, extension, σ, mp.mpf(μ), mp.mpf(λ), ε, k)  # noqa: B023
        )
        size = np.linalg.norm(STATES[dimension][state], 2)
        force, stiffness = np.linalg.norm(P_exact), np.linalg.norm(A_exact)
        σ = points.σ[()]
        gap = float(σ[-2] + σ[-1])
        distance = min([gap, *(float(a - b) for a in σ for b in σ if extension == "c1" and a >= ε > b)])
        terms = abs(Ψ_exact) + force * size + (stiffness * size**2 if name == "mooney_rivlin" else 0)
        errors = {
            "energy": abs(Ψ[n] - Ψ_exact) / (terms + 1e-16 * stiffness * size**2),
            "stress": np.linalg.norm(P[n] - P_exact) / (force + stiffness * size),
            "stress from stretches": np.linalg.norm(again[n] - P_exact) / (force + stiffness * size),
        }
        if gap > 1e-6:
            errors["tangent"] = np.linalg.norm(A[n] - A_exact) / (stiffness * (1 + size / distance))
        wrong += [f"{state}: {what} {error:.1e}" for what, error in errors.items() if not error <= TOLERANCE]
    assert not wrong


def stretch_gradient(Ψ, σ):
    """∂Ψ/∂σ by central differences."""

    def moved(i, step):
        return (*σ[:i], σ[i] + step, *σ[i + 1 :])

    step = reference.STEP
    return [(Ψ(moved(i, step)) - Ψ(moved(i, -step))) / (2 * step) for i in range(len(σ))]


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("extension", ["none", "c1", "c2"])
@pytest.mark.parametrize("name", reference.LAWS)
@pytest.mark.parametrize("factor", [0.0, -1.0], ids=["F = 0", "F = -I"])
def test_stress_on_the_kink_itself_is_that_of_a_decomposition(factor, name, extension, dimension):
    """F = 0 and, in 3D, F = -I have many decompositions: P must be U ∂Ψ V^T of one, and R = I at F = 0."""
    if extension == "none" and name in reference.NEEDS_POSITIVE_J and factor**dimension <= 0:
        pytest.skip("log J has no value")
    d = dimension
    G = (factor - 1) * np.eye(d).reshape(1, -1)
    kernel = Kernel(law(name, d), extension)
    Ψ, P, A = np.empty(1), np.empty((1, d * d)), np.empty((1, d * d, d * d))
    kernel.evaluate(G, parameters(name, extension), energy=Ψ, stress=P)
    U, σ, V = (x[0] for x in kernel.decomposition(G))
    exact = tuple(mp.mpf(x) for x in ((0,) * d if factor == 0 else (1,) * (d - 1) + ((-1) ** d,)))
    ε, k = mp.mpf(THRESHOLD[extension]), mp.mpf(STIFFNESS)

    def energy(s):
        return reference.extended(name, extension, s, mp.mpf(μ), mp.mpf(λ), ε, k)

    g = np.array(stretch_gradient(energy, exact), dtype=float)
    assert np.allclose(σ, np.array(exact, dtype=float), rtol=0, atol=1e-15)
    assert np.allclose(Ψ, float(energy(exact)), rtol=1e-13)
    expected = g[0] * np.eye(d) if factor == 0 else U @ np.diag(g) @ V.T
    assert np.abs(P.reshape(d, d) - expected).max() <= 1e-13 * (1 + np.abs(g).max())
    kernel.evaluate(G, parameters(name, extension), tangent=A)
    assert np.isfinite(A).all()


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("name", reference.LAWS)
def test_stress_continued_linearly_is_g_plus_h_times_the_way(name, dimension):
    """IFE: g(q) + H(q)(σ - q) beyond J = ε, and Ψ is its work along the ray."""
    states = list(STATES[dimension])
    Ψ, P, _, _ = kernel_values(name, "ife", dimension, states)
    wrong = []
    for n, state in enumerate(states):
        F = reference.exact(gradient(dimension, state))
        U, σ, V = reference.decompose(F)
        ε = mp.mpf(THRESHOLD["ife"])
        outside = mp.fprod(σ) < ε
        s = reference.threshold_root(tuple(σ), ε) if outside else mp.mpf(1)
        q = [1 + s * (x - 1) for x in σ]
        way = [(1 - s) * (x - 1) for x in σ]

        def base(x):
            return reference.base(name, x, mp.mpf(μ), mp.mpf(λ))

        def along(t):
            at = [a + t * b for a, b in zip(q, way, strict=True)]  # noqa: B023
            return stretch_gradient(base, tuple(at))

        step = reference.STEP
        change = [(a - b) / (2 * step) for a, b in zip(along(step), along(-step), strict=True)]
        start = along(0)
        g = mp.diag([a + b for a, b in zip(start, change, strict=True)])
        exact = np.array((U * g * V.T).tolist(), dtype=float).ravel()
        work = float(base(q) + sum((a + b / 2) * w for a, b, w in zip(start, change, way, strict=True)))
        size = np.linalg.norm(STATES[dimension][state])
        terms = (μ + λ) * (1 + size**3) + np.linalg.norm(exact) * (1 + size / float(σ[-2] + σ[-1]))
        if not np.linalg.norm(P[n] - exact) <= TOLERANCE * terms:
            wrong.append(f"{state}: stress {np.linalg.norm(P[n] - exact) / terms:.1e}")
        if not abs(Ψ[n] - work) <= TOLERANCE * (abs(work) + terms):
            wrong.append(f"{state}: work {abs(Ψ[n] - work) / terms:.1e}")
    assert not wrong
