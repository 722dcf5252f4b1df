"""Energies of chapter 6 in multiple precision, by other formulas than the kernel's.

Everything follows from Ψ as a function of the singular values of F: those come from mpmath's decomposition,
the extensions are written as sections 6.3.1 and 6.3.2 print them, and P and ∂P/∂F are differences of Ψ(F).
With 160 digits and steps of 1e-25 about 50 digits of P and ∂P/∂F are right.
"""

from functools import cache
from itertools import combinations

import mpmath as mp
import numpy as np

DIGITS = 160
STEP = mp.mpf(10) ** -25

LAWS = ("neo_hookean", "corotated", "fixed_corotated", "st_venant_kirchhoff", "mooney_rivlin")
NEEDS_POSITIVE_J = ("neo_hookean", "mooney_rivlin")
SHARE = mp.mpf(0.3)  # Mooney-Rivlin: the part of μ/2 that belongs to I2


def base(law, σ, μ, λ):
    """Ψ of a built-in law at stretches σ: sections 6.2.3, 6.2.4, 6.4; textbook forms of the others."""
    d, J = len(σ), mp.fprod(σ)
    if law == "neo_hookean":
        return μ / 2 * (sum(s * s for s in σ) - d) - μ * mp.log(J) + λ / 2 * mp.log(J) ** 2
    if law == "corotated":
        return μ * sum((s - 1) ** 2 for s in σ) + λ / 2 * sum(s - 1 for s in σ) ** 2
    if law == "fixed_corotated":
        return μ * sum((s - 1) ** 2 for s in σ) + λ / 2 * (J - 1) ** 2
    if law == "st_venant_kirchhoff":
        green = [(s * s - 1) / 2 for s in σ]
        return μ * sum(e * e for e in green) + λ / 2 * sum(green) ** 2
    full = [*σ, mp.mpf(1)][:3]  # plane strain: the third stretch is one
    bar = [s * mp.cbrt(1 / J) for s in full]
    squares = [b * b for b in bar]
    first, second = sum(squares), sum(a * b for a, b in combinations(squares, 2))
    return μ / 2 * ((1 - SHARE) * (first - 3) + SHARE * (second - 3)) + (λ + 2 * μ / 3) / 2 * (J - 1) ** 2


@cache
def threshold_root(σ, ε):
    """s in (0, 1) with Π(1 + s(σi - 1)) = ε; started from floating-point numbers, finished by Newton."""
    d = [s - 1 for s in σ]
    if len(d) == 2:
        polynomial = [1 - ε, d[0] + d[1], d[0] * d[1]]
    else:
        polynomial = [1 - ε, sum(d), d[0] * d[1] + d[1] * d[2] + d[0] * d[2], d[0] * d[1] * d[2]]
    scale = max(1, *(abs(float(x)) for x in d))
    found = np.roots([float(c) / scale**k for k, c in enumerate(polynomial)])
    x = mp.mpf(float(found[np.abs(found.imag) < 1e-6].real.max())) * scale
    for _ in range(60):
        change = mp.polyval(polynomial, x) / mp.polyval(_slope(polynomial), x)
        x -= change
        if abs(change) < abs(x) * mp.mpf(10) ** (5 - DIGITS):
            return 1 / x
    raise ArithmeticError("no root")


def _slope(polynomial):
    n = len(polynomial) - 1
    return [c * (n - k) for k, c in enumerate(polynomial[:-1])]


def extended(law, extension, σ, μ, λ, ε, k):
    """Ψext (for "ife": the work of the stress along the ray)."""

    def Ψ(s):
        return base(law, s, μ, λ)

    if extension == "c1":
        below = [i for i, s in enumerate(σ) if s < ε]
        return _c1(Ψ, list(σ), below, ε) + k / 2 * sum((σ[i] - ε) ** 2 for i in below)
    if extension == "none" or mp.fprod(σ) >= ε:
        return Ψ(σ)
    s = threshold_root(tuple(σ), ε)
    h = mp.sqrt(sum((x - 1) ** 2 for x in σ))
    u = [(x - 1) / h for x in σ]
    q = [1 + s * (x - 1) for x in σ]
    h *= 1 - s
    f = [Ψ([a + t * b for a, b in zip(q, u, strict=True)]) for t in (-STEP, 0, STEP)]
    return f[1] + h * (f[2] - f[0]) / (2 * STEP) + h * h / 2 * (f[2] - 2 * f[1] + f[0]) / STEP**2


def _c1(Ψ, σ, below, ε):
    """Ψ continued linearly in each stretch below ε from ε, one after the other."""
    if not below:
        return Ψ(σ)
    i, rest = below[0], below[1:]

    def at(x):
        return _c1(Ψ, [*σ[:i], x, *σ[i + 1 :]], rest, ε)

    return at(ε) + (σ[i] - ε) * (at(ε + STEP) - at(ε - STEP)) / (2 * STEP)


def decompose(F):
    """U, σ, V with F = U diag(σ) Vᵀ, U and V rotations, the last stretch signed."""
    U, s, Vt = mp.svd_r(F)
    d, σ = F.rows, list(s)
    for factor, axis in ((U, 1), (Vt, 0)):
        if determinant(factor) < 0:
            σ[-1] = -σ[-1]
            for i in range(d):
                if axis:
                    factor[i, d - 1] = -factor[i, d - 1]
                else:
                    factor[d - 1, i] = -factor[d - 1, i]
    return U, σ, Vt.T


def determinant(F):
    """det F; mpmath's own fails on singular matrices."""
    if F.rows == 2:
        return F[0, 0] * F[1, 1] - F[0, 1] * F[1, 0]
    cycles = ((0, 1, 2), (1, 2, 0), (2, 0, 1))
    return sum(F[0, i] * (F[1, j] * F[2, k] - F[1, k] * F[2, j]) for i, j, k in cycles)


def stretches(F):
    """Stretches with the sign convention."""
    σ = sorted(mp.svd_r(F, compute_uv=False), reverse=True)
    return (*σ[:-1], -σ[-1] if determinant(F) < 0 else σ[-1])


def exact(gradient):
    """F = I + G in multiple precision."""
    d = int(np.sqrt(np.size(gradient)))
    return mp.eye(d) + mp.matrix(np.reshape(gradient, (d, d)).tolist())


class Stencil:
    """Stretches of F and of F with steps in one or two entries, for first and second differences."""

    def __init__(self, F):
        self.size = F.rows * F.rows
        self.σ = {(): stretches(F)}
        n = range(self.size)
        for key in [(m,) for m in n] + list(combinations(n, 2)):
            for sign in (1, -1):
                moved = F.copy()
                for m in key:
                    moved[m // F.rows, m % F.rows] += sign * STEP
                self.σ[(*key, sign)] = stretches(moved)

    def differentiate(self, Ψ):
        """Ψ, P (d*d,), ∂P/∂F (d*d, d*d) as floating-point numbers."""
        f = {key: Ψ(σ) for key, σ in self.σ.items()}
        n = self.size
        P, A = np.empty(n), np.empty((n, n))
        for a in range(n):
            P[a] = (f[a, 1] - f[a, -1]) / (2 * STEP)
            A[a, a] = (f[a, 1] - 2 * f[()] + f[a, -1]) / STEP**2
        for a, b in combinations(range(n), 2):
            total = f[a, b, 1] + f[a, b, -1] + 2 * f[()] - f[a, 1] - f[a, -1] - f[b, 1] - f[b, -1]
            A[a, b] = A[b, a] = total / (2 * STEP**2)
        return float(f[()]), P, A
