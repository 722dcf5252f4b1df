"""Laws without F, R or a singular value decomposition give what appendix B.6 and (7.12) give with them."""

import numpy as np
import pytest
from scipy.linalg import sqrtm
from snow_reference import (
    cloud,
    dense,
    elastic_energy,
    energy,
    flow,
    laid_out,
    left_stretch,
    pack,
    particle_loop,
    rotation,
    stress,
    stress_change,
    unpack,
)

from extremal.mpm.law import Law, LawError

H = 0.1
DIMS = pytest.mark.parametrize("d", [2, 3])
SPLINES = pytest.mark.parametrize("spline", ["cubic", "quadratic"])
LAWS = pytest.mark.parametrize(
    "law",
    [
        Law("fixed_corotated", 5.0, 0.3),
        Law("neo_hookean", 5.0, 0.3),
        Law("snow", 5.0, 0.2, hardening=10.0, hardening_cap=2.5),
    ],
    ids=lambda law: law.name,
)


def factors(law, p):
    """Hardening (7.2), capped, times the particle's own stiffness."""
    if not law.is_plastic:
        return p.stiffness
    return p.stiffness * np.exp(np.clip(law.hardening * (1 - p.plastic), -law.hardening_cap, law.hardening_cap))


def scene(law, d, spline, seed, n=12):
    """Deformed particles on their grid, F sorted with them, and a reference for Φ of (7.4)."""
    rng = np.random.default_rng(seed)
    p, F = cloud(rng, d, n, H)
    p.plastic = rng.uniform(0.6, 1.4, n)  # some beyond the cap
    grid, rows = laid_out(p, H, spline)
    return p, grid, Potential(law, p, F[rows], dense(grid, p.position, spline)[1])


class Potential:
    """Φ(x̂) of (7.4), its gradient (B.2) and Hessian's action (B.3), term by term."""

    def __init__(self, law, p, F, dw):
        self.law, self.F, self.dw, self.weight = law, F, dw, p.volume * factors(law, p)

    def _pulled(self, u):
        return np.einsum("ia,pib->pab", u, self.dw)

    def deformed(self, u):
        return (np.eye(self.F.shape[-1]) + self._pulled(u)) @ self.F

    def value(self, u):
        return sum(w * energy(self.law, f) for w, f in zip(self.weight, self.deformed(u)))

    def _spread(self, P):
        return np.einsum("p,pac,pbc,pib->ia", self.weight, np.array(P), self.F, self.dw)

    def gradient(self, u):
        return self._spread([stress(self.law, f) for f in self.deformed(u)])

    def hessian(self, u, δu):
        δF = self._pulled(δu) @ self.F
        return self._spread([stress_change(self.law, f, δf) for f, δf in zip(self.deformed(u), δF)])


def kernel_force(p, grid, law):
    force = grid.zeros(p.dimension)
    particle_loop(grid, "force", p, law, force)
    return force


def kernel_hessian(p, grid, law, u, scale=1.0):
    out = grid.zeros(p.dimension)
    particle_loop(grid, "hessian", p, law, scale, np.ascontiguousarray(u), out)
    return out


@DIMS
@SPLINES
@LAWS
def test_force_and_hessian_are_those_of_appendix_b6(d, spline, law):
    p, grid, Φ = scene(law, d, spline, seed=d)
    u = np.random.default_rng(1).normal(size=(grid.count, d))
    force, action = kernel_force(p, grid, law), kernel_hessian(p, grid, law, u)
    rest = np.zeros_like(u)
    wanted, change = Φ.gradient(rest), Φ.hessian(rest, u)
    assert np.abs(force + wanted).max() < 1e-13 * np.abs(wanted).max()
    assert np.abs(action - change).max() < 1e-12 * np.abs(change).max()
    assert kernel_hessian(p, grid, law, u, 0.125) == pytest.approx(action / 8, rel=1e-12, abs=1e-15)
    total = elastic_energy(grid, p, law).sum()
    assert total == pytest.approx(Φ.value(rest), rel=1e-13)


@DIMS
@SPLINES
@LAWS
def test_force_is_the_derivative_of_the_energy_to_third_order(d, spline, law):
    p, grid, Φ = scene(law, d, spline, seed=10 + d)
    u = np.random.default_rng(2).normal(size=(grid.count, d)) * H
    rest, begin = np.zeros_like(u), elastic_energy(grid, p, law).sum()
    force = kernel_force(p, grid, law)
    errors = []
    for size in (4e-3, 2e-3, 1e-3):  # B.4
        δ = size * u
        errors.append(abs(Φ.value(δ) - begin - 0.5 * np.sum((Φ.gradient(δ) - force) * δ)))
    assert errors[0] > 1e-13 * begin  # there is something to see
    assert np.log2(errors[0] / errors[1]) > 2.8 or errors[1] < 1e-14 * begin
    assert np.sum(force * rest) == 0


@DIMS
@SPLINES
@LAWS
def test_hessian_is_the_derivative_of_the_force_to_third_order(d, spline, law):
    p, grid, Φ = scene(law, d, spline, seed=20 + d)
    u = np.random.default_rng(3).normal(size=(grid.count, d)) * H
    force = kernel_force(p, grid, law)
    errors = []
    for size in (8e-3, 4e-3, 2e-3):
        δ = size * u
        average = 0.5 * (Φ.hessian(δ, δ) + kernel_hessian(p, grid, law, δ))
        errors.append(np.abs(Φ.gradient(δ) + force - average).max())
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert (orders > 2.8).all()


@DIMS
@LAWS
def test_hessian_is_symmetric(d, law):
    p, grid, _ = scene(law, d, "cubic", seed=30 + d)
    rng = np.random.default_rng(4)
    a, b = rng.normal(size=(2, grid.count, d))
    one, two = np.sum(a * kernel_hessian(p, grid, law, b)), np.sum(b * kernel_hessian(p, grid, law, a))
    size = np.linalg.norm(a) * np.linalg.norm(kernel_hessian(p, grid, law, b))
    assert abs(one - two) < 1e-14 * size


@DIMS
@LAWS
def test_rotating_the_reference_changes_nothing_and_rotating_space_rotates_the_stress(d, law):
    """W knows nothing of the rotation in F = W Q; the law is isotropic."""
    p, grid, Φ = scene(law, d, "cubic", seed=40 + d)
    Q = rotation(np.random.default_rng(5), d)
    force = kernel_force(p, grid, law)
    turned = Potential(law, p, Φ.F @ Q, Φ.dw)
    assert np.abs(force + turned.gradient(np.zeros_like(force))).max() < 1e-12 * np.abs(force).max()
    assert np.allclose(left_stretch(Φ.F @ Q), unpack(p.stretch, d), atol=1e-13)


@DIMS
def test_force_and_hessian_share_one_cap_of_hardening(d):
    """Where the cap binds, J_P makes no difference to either; each is its uncapped self times the same factor."""
    law, soft = Law("snow", 5.0, hardening=10.0, hardening_cap=3.0), Law("fixed_corotated", 5.0)
    p, grid, _ = scene(law, d, "cubic", seed=50 + d)
    u = np.random.default_rng(6).normal(size=(grid.count, d))
    plain = kernel_force(p, grid, soft), kernel_hessian(p, grid, soft, u), elastic_energy(grid, p, soft)
    for J_P, factor in (
        (1e-300, np.exp(3)), (1e-3, np.exp(3)), (0.7, np.exp(3)), (0.9, np.exp(1)), (1.2, np.exp(-2)),
        (1.3001, np.exp(-3)), (1e3, np.exp(-3)), (1e300, np.exp(-3)),
    ):  # fmt: skip
        p.plastic[:] = J_P
        found = kernel_force(p, grid, law), kernel_hessian(p, grid, law, u), elastic_energy(grid, p, law)
        for one, two in zip(found, plain):
            assert np.abs(one - factor * two).max() < 1e-12 * factor * np.abs(two).max()


@DIMS
@pytest.mark.parametrize("spread", [1e-9, 1e-3, 0.3, "equal", "two equal", "far apart"])
def test_closed_form_square_root_agrees_with_scipy(d, spread):
    rng = np.random.default_rng(70 + d)
    n = 40
    p, _ = cloud(rng, d, n, H)
    grid, _ = laid_out(p, H, "cubic")
    ends = np.ones((n, d))
    if spread == "far apart":
        ends = 10 ** rng.uniform(-2, 1, (n, d))
    elif spread == "two equal":
        ends[:, 0] = rng.uniform(0.2, 3, n)
    elif spread == "equal":
        ends *= rng.uniform(0.2, 3, (n, 1))
    else:
        ends += float(spread) * rng.uniform(-1, 1, (n, d))
    axes = np.array([rotation(rng, d) for _ in range(n)])
    W = np.einsum("pik,pk,pjk->pij", axes, ends, axes)
    p.stretch = pack(W)
    gradient = rng.normal(size=(n, d, d)) * 0.2
    U = np.eye(d) + 0.5 * gradient
    flow(grid, p, Law("fixed_corotated"), gradient, 0.5)
    wanted = np.array([sqrtm(u @ w @ w @ u.T).real for u, w in zip(U, W)])
    found = unpack(p.stretch, d)
    scale = np.abs(wanted).max(axis=(1, 2))[:, None, None]
    # a square root of what is squared loses half the digits of the small stretches when they are far apart
    assert (np.abs(found - wanted) / scale).max() < (1e-9 if spread == "far apart" else 2e-14)


@DIMS
@pytest.mark.parametrize("size", [3e-3, 0.05, 0.3])
def test_return_mapping_agrees_with_singular_values_over_a_hundred_steps(d, size):
    """W = sqrt(F_E F_Eᵀ) and J_P = det F_P, with F_E and F_P as in (7.11), (7.12)."""
    law, n, dt = Law(), 24, 1e-3
    rng = np.random.default_rng(80 + d)
    p, _ = cloud(rng, d, n, H)
    grid, _ = laid_out(p, H, "cubic")
    p.stretch = pack(np.tile(np.eye(d), (n, 1, 1)))
    E, P = np.tile(np.eye(d), (n, 1, 1)), np.tile(np.eye(d), (n, 1, 1))
    J, flowed = np.ones(n), 0
    for _ in range(100):
        gradient = rng.normal(size=(n, d, d)) * size / dt
        small = np.abs(np.linalg.det(np.eye(d) + dt * gradient)) < 0.1
        gradient[small] = 0
        flow(grid, p, law, gradient, dt)
        trial = (np.eye(d) + dt * gradient) @ E
        flipped = np.linalg.det(trial) < 0
        assert not flipped.any() or size > 0.1
        U, s, Vt = np.linalg.svd(trial)
        clamped = np.clip(s, 1 - law.critical_compression, 1 + law.critical_stretch)
        flowed += int((clamped != s).sum())
        whole = trial @ P
        J *= np.linalg.det(np.eye(d) + dt * gradient)
        E = np.einsum("pik,pk,pkj->pij", U, clamped, Vt)
        P = np.linalg.solve(E, whole)
    assert flowed > 50
    W = np.array([sqrtm(e @ e.T).real for e in E])
    assert np.abs(unpack(p.stretch, d) - W).max() < 1e-12
    assert np.abs(p.plastic / np.abs(J / np.linalg.det(E)) - 1).max() < 1e-11
    if size < 0.1:  # else F_P is too ill-conditioned for a determinant
        assert np.abs(p.plastic / np.linalg.det(P) - 1).max() < 1e-10


@DIMS
def test_flow_takes_energy_and_the_balance_closes(d):
    """What is dissipated is the energy of the trial state less that of the clamped one, and not negative."""
    law, n = Law(), 200
    rng = np.random.default_rng(90 + d)
    p, _ = cloud(rng, d, n, H)
    grid, _ = laid_out(p, H, "cubic")
    p.stretch, p.plastic = pack(np.tile(np.eye(d), (n, 1, 1))), rng.uniform(0.8, 1.2, n)
    elastic = Law("fixed_corotated", law.young_modulus, law.poisson_ratio)
    total = 0.0
    for _ in range(20):
        gradient = 0.01 * rng.normal(size=(n, d, d))
        trial = p.take(np.arange(n))
        flow(grid, trial, elastic, gradient, 1.0)
        before = elastic_energy(grid, trial, law)
        each = 0.0
        taken = flow(grid, p, law, gradient, 1.0)
        after = elastic_energy(grid, p, law)
        flows = np.abs(p.plastic - trial.plastic) > 0
        each = before - after
        assert np.abs(each[~flows]).max(initial=0) < 1e-12 * before.max()
        assert (each[flows] > 0).all()
        assert taken == pytest.approx(each.sum(), rel=1e-11)
        total += taken
    assert total > 0


@DIMS
def test_a_brittle_coarse_snow_may_gain_energy_by_hardening(d):
    """(7.2) stiffens what is under load: with ξ θc large, compression gives energy. The balance says so."""
    law = Law(critical_compression=0.2, hardening=20.0)
    p, _ = cloud(np.random.default_rng(0), d, 1, H)
    grid, _ = laid_out(p, H, "cubic")
    p.stretch = pack(0.8 * np.eye(d)[None])
    assert flow(grid, p, law, -1e-3 * np.eye(d)[None], 1.0) < 0


@DIMS
def test_elastic_bodies_never_flow(d):
    rng = np.random.default_rng(8)
    p, _ = cloud(rng, d, 20, H)
    grid, _ = laid_out(p, H, "cubic")
    assert flow(grid, p, Law("neo_hookean"), 0.3 * rng.normal(size=(20, d, d)), 0.5) == 0
    assert (p.plastic == 1).all()


@pytest.mark.parametrize(
    "key, value",
    [("young_modulus", 0.0), ("young_modulus", float("nan")), ("poisson_ratio", 0.5), ("density", -1.0),
     ("critical_compression", 1.0), ("critical_stretch", 0.0), ("hardening", -1.0), ("hardening_cap", 100.0)],
)  # fmt: skip
def test_a_law_that_cannot_be_is_refused_naming_the_key(key, value):
    with pytest.raises(LawError, match=f"{key} = .*: must be"):
        Law(**{key: value})


def test_an_unknown_law_is_refused_with_those_there_are():
    with pytest.raises(LawError, match="'sand' is unknown: one of snow, fixed_corotated, neo_hookean"):
        Law("sand")
