"""Snow by other means: dense weights as printed in 7.3, laws with F and R explicit (appendix B.6), and small bodies."""

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray
from scipy.linalg import polar

from extremal.mpm import kernel
from extremal.mpm.grid import Grid
from extremal.mpm.law import Law, table
from extremal.mpm.particles import Particles

BOTH = [(2, "cubic"), (2, "quadratic"), (3, "cubic"), (3, "quadratic")]


def cubic(x: NDArray) -> NDArray:
    """N(x) of 7.3."""
    a = np.abs(x)
    inner, outer = a**3 / 2 - a**2 + 2 / 3, -(a**3) / 6 + a**2 - 2 * a + 4 / 3
    return np.where(a < 1, inner, np.where(a < 2, outer, 0))


def quadratic(x: NDArray) -> NDArray:
    """The quadratic B-spline."""
    a = np.abs(x)
    return np.where(a < 0.5, 0.75 - a**2, np.where(a < 1.5, (1.5 - a) ** 2 / 2, 0))


def cubic_slope(x: NDArray) -> NDArray:
    """N'(x)."""
    a = np.abs(x)
    return np.sign(x) * np.where(a < 1, 1.5 * a**2 - 2 * a, np.where(a < 2, -(a**2) / 2 + 2 * a - 2, 0))


def quadratic_slope(x: NDArray) -> NDArray:
    """The quadratic B-spline's derivative."""
    a = np.abs(x)
    return np.sign(x) * np.where(a < 0.5, -2 * a, np.where(a < 1.5, a - 1.5, 0))


SPLINE = {"cubic": (cubic, cubic_slope), "quadratic": (quadratic, quadratic_slope)}


def dense(grid: Grid, x: NDArray, spline: str) -> tuple[NDArray, NDArray]:
    """w[p, i] and grad w[p, i, d] of every particle at every active node."""
    N, slope = SPLINE[spline]
    away = x[:, None, :] / grid.h - grid.node[None]
    values, slopes = N(away), slope(away) / grid.h
    d = x.shape[1]
    gradient = np.stack(
        [np.prod([slopes[..., e] if e == k else values[..., e] for e in range(d)], axis=0) for k in range(d)], axis=-1
    )
    return values.prod(axis=-1), gradient


def rotation(rng: np.random.Generator, d: int) -> NDArray:
    """A random rotation (d, d)."""
    q, r = np.linalg.qr(rng.normal(size=(d, d)))
    q = q * np.sign(np.diag(r))
    if np.linalg.det(q) < 0:
        q[:, 0] *= -1
    return q


def pack(a: NDArray) -> NDArray:
    """Upper triangles by rows of symmetric a (n, d, d)."""
    return np.ascontiguousarray(a[(slice(None), *np.triu_indices(a.shape[-1]))])


def unpack(packed: NDArray, d: int) -> NDArray:
    """Symmetric matrices (n, d, d) of their upper triangles."""
    i, j = np.triu_indices(d)
    full = np.empty((len(packed), d, d))
    full[:, i, j] = full[:, j, i] = packed
    return full


def left_stretch(F: NDArray) -> NDArray:
    """sqrt(F Fᵀ) of each F (n, d, d)."""
    return np.array([polar(f, side="left")[1] for f in F])


def energy(law: Law, F: NDArray) -> float:
    """Ψ(F) (7.1), or Neo-Hookean, before hardening."""
    μ, λ = law.lame
    J = np.linalg.det(F)
    if law.name == "neo_hookean":
        return μ / 2 * (np.sum(F**2) - len(F)) - μ * np.log(J) + λ / 2 * np.log(J) ** 2
    return μ * np.sum((F - polar(F)[0]) ** 2) + λ / 2 * (J - 1) ** 2


def stress(law: Law, F: NDArray) -> NDArray:
    """∂Ψ/∂F (B.6)."""
    μ, λ = law.lame
    J, inverse = np.linalg.det(F), np.linalg.inv(F).T
    if law.name == "neo_hookean":
        return μ * (F - inverse) + λ * np.log(J) * inverse
    return 2 * μ * (F - polar(F)[0]) + λ * (J - 1) * J * inverse


def stress_change(law: Law, F: NDArray, δF: NDArray) -> NDArray:
    """∂²Ψ/∂F∂F : δF (B.6)."""
    μ, λ = law.lame
    J, inverse = np.linalg.det(F), np.linalg.inv(F).T
    δJ = J * np.sum(inverse * δF)
    δinverse = -inverse @ δF.T @ inverse
    if law.name == "neo_hookean":
        return μ * (δF - δinverse) + λ * (δJ / J * inverse + np.log(J) * δinverse)
    R, S = polar(F)
    # Rᵀ δF - δFᵀ R = A S + S A with A = Rᵀ δR skew: a small linear system
    d = len(F)
    eye = np.eye(d)
    skew = R.T @ δF
    skew = skew - skew.T
    A = np.linalg.solve(np.kron(eye, S) + np.kron(S, eye), skew.ravel()).reshape(d, d)
    δcofactor = δJ * inverse + J * δinverse
    return 2 * μ * (δF - R @ A) + λ * δJ * J * inverse + λ * (J - 1) * δcofactor


def cloud(rng: np.random.Generator, d: int, n: int, h: float, spread: float = 0.2) -> tuple[Particles, NDArray]:
    """`n` deformed particles in a few cells, and their F_E (n, d, d)."""
    p = Particles.at(rng.uniform(-2 * h, 2 * h, (n, d)), rng.uniform(0.5, 1.5, n) * h**d, rng.normal(size=(n, d)))
    F = np.array([rotation(rng, d) @ (np.eye(d) + spread * rng.uniform(-1, 1, (d, d))) for _ in range(n)])
    p.volume = rng.uniform(0.5, 1.5, n) * h**d
    p.stretch = pack(left_stretch(F))
    p.stiffness = rng.uniform(0.5, 2, n)
    return p, F


def laid_out(p: Particles, h: float, spline: str, precision: str = "double") -> tuple[Grid, NDArray]:
    """The grid of a lone process; `p` is sorted, the old rows come along."""
    loops = kernel.load(MPI.COMM_SELF, p.dimension, spline, precision)
    before = p.ident.copy()
    grid = Grid(loops, h, p)
    where = {ident: k for k, ident in enumerate(before)}
    return grid, np.array([where[i] for i in p.ident])


def moduli(grid: Grid, p: Particles, law: Law) -> tuple[NDArray, NDArray]:
    """Moduli of snow.h (n, 4); the largest entry of a velocity and the fastest wave [m/s]."""
    out, fastest = np.empty((len(p), kernel.MODULI)), np.empty(2)
    loops = kernel.load(MPI.COMM_SELF, p.dimension, grid.kernel.spline)
    loops.call(
        "moduli", len(p), p.velocity, p.stretch, p.plastic, p.volume, p.stiffness, p.body, table([law]), out, fastest
    )
    return out, fastest


def particle_loop(grid: Grid, name: str, p: Particles, law: Law, *rest: object) -> None:
    """A kernel loop over particles and their moduli."""
    grid.call(name, p.position, p.stretch, moduli(grid, p, law)[0], *rest)


def to_particles(
    grid: Grid, p: Particles, new: NDArray, old: NDArray, flip: float, dt: float = 0.0
) -> tuple[NDArray, NDArray, NDArray]:
    """Velocities (n, d) and their gradients (n, d²) after steps 7 and 8; the extremes of kernel.c."""
    d = p.dimension
    velocity, gradient, extremes = np.empty((len(p), d)), np.empty((len(p), d * d)), np.empty(3)
    grid.call("to_particles", p.position, new, old, flip, dt, p.velocity, velocity, gradient, extremes)
    return velocity, gradient, extremes


def flow(grid: Grid, p: Particles, law: Law, gradient: NDArray, dt: float) -> float:
    """Step 7 of 7.3.1; the energy that plastic flow took [J]."""
    taken = np.zeros(1)
    grid.kernel.call(
        "flow", len(p), np.ascontiguousarray(gradient), dt, p.volume, p.stiffness, p.body, table([law]), p.stretch,
        p.plastic, taken,
    )  # fmt: skip
    return float(taken[0])


def elastic_energy(grid: Grid, p: Particles, law: Law) -> NDArray:
    """Elastic energy of each particle [J]."""
    out = np.zeros(len(p))
    grid.kernel.call("energy", len(p), p.stretch, p.plastic, p.volume, p.stiffness, p.body, table([law]), out)
    return out


def lattice(low: NDArray, high: NDArray, spacing: float) -> NDArray:
    """Points at the middles of cubes of `spacing` that fill a box."""
    counts = np.round((np.asarray(high) - np.asarray(low)) / spacing).astype(int)
    axes = [low[k] + spacing * (np.arange(n) + 0.5) for k, n in enumerate(counts)]
    return np.stack([a.ravel() for a in np.meshgrid(*axes, indexing="ij")], axis=1)


def ball(d: int, h: float, radius: float, center: object = 0.0, velocity: object = 0.0, density: float = 400.0):
    """A ball of about 2^d particles a cell, jittered; a disc in the plane."""
    x = lattice([-radius] * d, [radius] * d, h / 2)
    x = x + np.random.default_rng(7).uniform(-0.2, 0.2, x.shape) * h / 2
    x = x[np.linalg.norm(x, axis=1) < radius] + np.asarray(center)
    return Particles.at(x, density * (h / 2) ** d, velocity)


def together(*parts: Particles) -> Particles:
    """Several bodies, numbered through."""
    p = Particles.join(list(parts))
    p.ident = np.arange(len(p))
    return p


def share(p: Particles, comm: MPI.Comm) -> Particles:
    """Every size-th particle."""
    return p.take(np.arange(comm.rank, len(p), comm.size))
