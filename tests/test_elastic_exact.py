"""Bodies whose equilibrium is known in closed form, or by an ordinary differential equation."""

from dataclasses import replace

import numpy as np
import pytest
from elastic_bodies import lame, material, on, problem
from mpi4py import MPI
from scipy.integrate import solve_bvp
from scipy.optimize import fsolve

from extremal import forms, meshes
from extremal.forms import Prescribed

COMM = MPI.COMM_SELF
SMALL = 1e-6  # load over Young's modulus: what is left of the nonlinearity is of that size
ROLLERS = {2: ("left", "bottom"), 3: ("left", "front", "bottom")}


def rollers(d):
    """Each lower side slides in its own plane."""
    return [Prescribed(boundary=(side,), components=(k,)) for k, side in enumerate(ROLLERS[d])]


def constant(*values):
    return lambda x, t: np.tile(values, (len(x), 1))


def solved(domain, stuff, steps=1, **how):
    """Positions (n, d) and displacements (n, d) at equilibrium, the load brought up in equal steps."""
    body = problem(domain, stuff, **{"tolerance": 1e-13, **how})
    for _ in range(steps):
        body.advance(1 / steps)
    d = body.space.dimension
    return body.space.positions, body.motion.u.reshape(-1, d).copy()


@pytest.mark.parametrize(
    "law", ["neo_hookean", "corotated", "fixed_corotated", "st_venant_kirchhoff", "mooney_rivlin"]
)
@pytest.mark.parametrize("d", [2, 3])
def test_small_tension_stretches_and_narrows_as_hooke_says(d, law):
    """ε = σ/E and -ν σ/E; in plane strain (1 - ν²) σ/E and -ν (1 + ν) σ/E."""
    nu = 0.3
    domain = on(COMM, "box", cell_size=0.5, dimension=d, structured=True)
    traction = [(("right",), constant(SMALL, 0, 0) if d == 3 else constant(SMALL, 0))]
    x, u = solved(domain, material(d, nu, law=law), prescribed=rollers(d), tractions=traction)
    along, across = (1.0, -nu) if d == 3 else (1 - nu**2, -nu * (1 + nu))
    strains = [along] + [across] * (d - 1)
    assert u == pytest.approx(SMALL * x * strains, abs=1e-5 * SMALL)


@pytest.mark.parametrize("d", [2, 3])
def test_small_pressure_shrinks_by_the_bulk_modulus(d):
    """ε = -p (1 - 2ν)/E in every direction; in plane strain -p (1 + ν)(1 - 2ν)/E."""
    nu = 0.3
    domain = on(COMM, "box", cell_size=0.5, dimension=d, structured=True)
    sides = ("right", "back", "top") if d == 3 else ("right", "top")
    pressure = [(sides, lambda x, t: np.full(len(x), SMALL))]
    x, u = solved(domain, material(d, nu), prescribed=rollers(d), pressures=pressure)
    strain = -(1 - 2 * nu) * (1 if d == 3 else 1 + nu)
    assert u == pytest.approx(SMALL * strain * x, abs=1e-5 * SMALL)


@pytest.mark.parametrize("d", [2, 3])
def test_small_shear_follows_the_shear_modulus(d):
    """Tractions τ along four sides turn a square into a rhombus with γ = τ/μ."""
    mu, _ = lame(1, 0.3)
    domain = on(COMM, "box", cell_size=0.5, dimension=d, structured=True)
    up, along = ((0, 0, SMALL), (SMALL, 0, 0)) if d == 3 else ((0, SMALL), (SMALL, 0))
    tractions = [(("right",), constant(*up)), (("left",), constant(*-np.array(up)))]
    tractions += [(("top",), constant(*along)), (("bottom",), constant(*-np.array(along)))]
    last = d - 1
    held = [
        Prescribed(where=lambda x: np.abs(x).max(axis=1) < 1e-9),
        Prescribed(where=lambda x: np.abs(x[:, 1:]).max(axis=1) < 1e-9, components=(last,)),
    ]
    if d == 3:
        held.append(Prescribed(boundary=("front",), components=(1,)))
    x, u = solved(domain, material(d, 0.3), prescribed=held, tractions=tractions)
    exact = np.zeros_like(x)
    exact[:, 0] = SMALL / mu * x[:, last]
    assert u == pytest.approx(exact, abs=1e-5 * SMALL)


@pytest.mark.parametrize("law, d", [("neo_hookean", 3), ("neo_hookean", 2), ("st_venant_kirchhoff", 3)])
def test_large_tension_follows_the_law(law, d):
    """P1 = ∂Ψ/∂σ1 = t and P2 = 0, solved for two stretches."""
    mu, lam = lame(1, 0.3)
    t = 1.5

    def stresses(s):
        full = np.array([s[0], s[1], s[1]]) if d == 3 else np.array(s)
        if law == "neo_hookean":
            P = mu * (full - 1 / full) + lam * np.log(full.prod()) / full
        else:
            E = (full**2 - 1) / 2
            P = full * (2 * mu * E + lam * E.sum())
        return [P[0] - t, P[1]]

    stretches = fsolve(stresses, [1.5, 0.9], xtol=1e-13)
    domain = on(COMM, "box", cell_size=0.5, dimension=d, structured=True)
    traction = [(("right",), constant(t, 0, 0) if d == 3 else constant(t, 0))]
    x, u = solved(
        domain,
        material(d, 0.3, law=law, threshold=0.3),
        prescribed=rollers(d),
        tractions=traction,
        tolerance=1e-9,
    )
    assert u == pytest.approx(x * (np.array([stretches[0]] + [stretches[1]] * (d - 1)) - 1), abs=1e-7)


@pytest.mark.parametrize("d", [2, 3])
def test_a_hanging_bar_stretches_under_its_weight(d):
    """u = ρ g/E (L x - x²/2) for ν = 0, which P2 holds exactly."""
    domain = on(COMM, "bar", size=[2.0] + [0.5] * (d - 1), cell_size=0.5, dimension=d, structured=True)
    stuff = material(d, 0.0, young_modulus=3.0, density=2.0)
    x, u = solved(
        domain,
        stuff,
        degree=2,
        prescribed=[Prescribed(boundary=("left",))],
        gravity=[SMALL, 0, 0],
        tolerance=1e-14,
    )
    exact = np.zeros_like(x)
    exact[:, 0] = 2 * SMALL / 3 * (2 * x[:, 0] - x[:, 0] ** 2 / 2)
    assert u == pytest.approx(exact, abs=1e-5 * SMALL)


def test_a_bar_whose_modulus_varies_stretches_by_the_integral():
    """u = σ ln(1 + x) for E = 1 + x, ν = 0; the modulus is constant in a cell, so the error falls as size²."""
    errors = []
    for n in (8, 16):
        domain = on(COMM, "box", cell_size=1 / n, dimension=2, structured=True)
        stuff = material(2, 0.0, young_modulus=lambda x: 1 + x[:, 0])
        x, u = solved(domain, stuff, prescribed=rollers(2), tractions=[(("right",), constant(SMALL, 0))])
        errors.append(np.abs(u[:, 0] / SMALL - np.log(1 + x[:, 0])).max())
    assert errors[1] < 1e-3
    assert errors[0] / errors[1] > 3


def test_two_regions_in_series_share_the_stress():
    """u = σ (x/E1) in the first half and σ (0.5/E1 + (x - 0.5)/E2) in the second, ν = 0."""
    data = meshes.generate("box", cell_size=0.25, structured=True)
    middle = data.points[data.cells].mean(axis=1)[:, 0]
    data = replace(
        data, regions=np.where(middle < 0.5, 1, 2).astype(np.int32), region_names={"soft": 1, "stiff": 2}
    )
    stuff = {"soft": material(3, 0.0, 1.0), "stiff": material(3, 0.0, 4.0, law="fixed_corotated")}
    body = forms.ElasticProblem(
        meshes.distribute(COMM, data),
        stuff,
        prescribed=rollers(3),
        tractions=[(("right",), constant(SMALL, 0, 0))],
        tolerance=1e-14,
    )
    body.start()
    body.advance(1.0)
    x, u = body.space.positions[:, 0], body.motion.u.reshape(-1, 3)[:, 0]
    assert u == pytest.approx(SMALL * np.where(x < 0.5, x, 0.5 + (x - 0.5) / 4), abs=1e-5 * SMALL)


# -------------------------------------------------------------------------- a tube under pressure, held outside

INNER, OUTER = 0.3, 0.5


def tube(d, degree, cell_size):
    how = {"radius": OUTER, "inner_radius": INNER, "cell_size": cell_size, "dimension": d, "order": degree}
    return on(COMM, "tube", **how, **({"length": 0.1} if d == 3 else {}))


def pressed(domain, pressure, degree, **how):
    """Radii and radial displacement; the ends of a tube in space slide in their planes."""
    held = [Prescribed(boundary=("outer",))]
    if domain.mesh.topology.dim == 3:
        held.insert(0, Prescribed(boundary=("bottom", "top"), components=(2,)))
    x, u = solved(
        domain,
        material(domain.mesh.topology.dim, 0.3, threshold=0.3),
        degree=degree,
        prescribed=held,
        pressures=[(("inner",), lambda x, t: np.full(len(x), pressure * t))],
        **how,
    )
    r = np.linalg.norm(x[:, :2], axis=1)
    return r, (u[:, :2] * x[:, :2]).sum(axis=1) / r


@pytest.mark.parametrize(
    "d, degree, cell_size, accuracy", [(2, 2, 0.05, 1e-3), (2, 1, 0.025, 1e-2), (3, 2, 0.05, 5e-3)]
)
def test_a_tube_under_a_small_pressure_widens_as_lame_says(d, degree, cell_size, accuracy):
    """u = A (r - b²/r) with A (2(λ + μ) + 2μ b²/a²) = -p."""
    mu, lam = lame(1, 0.3)
    r, u = pressed(tube(d, degree, cell_size), SMALL, degree)
    A = -SMALL / (2 * (lam + mu) + 2 * mu * OUTER**2 / INNER**2)
    exact = A * (r - OUTER**2 / r)
    assert np.abs(u - exact).max() < accuracy * np.abs(exact).max()


def test_a_tube_under_a_large_pressure_follows_the_surface():
    """(R P_r)' = P_t with P_r(a) = -p r/R: pressure acts on the deformed surface, here a quarter wider."""
    mu, lam = lame(1, 0.3)
    pressure = 0.8

    def stress(s, other):
        return mu * (s - 1 / s) + lam * np.log(s * other) / s

    def rates(R, y):  # y = r, R P_r; the radial stretch is the root of P_r
        r, force = y
        turn = r / R
        s = fsolve(lambda s: stress(s, turn) - force / R, np.full(len(R), 0.8))
        return np.array([s, stress(turn, s)])

    R = np.linspace(INNER, OUTER, 21)
    guess = np.array([R + 0.06 * (OUTER - R) / (OUTER - INNER), -pressure * R])
    reference = solve_bvp(rates, lambda a, b: [a[1] + pressure * a[0], b[0] - OUTER], R, guess, tol=1e-6)
    assert reference.success
    r, u = pressed(tube(2, 2, 0.05), pressure, 2, tolerance=1e-9)
    exact = reference.sol(r)[0] - r
    assert exact.max() > 0.2 * INNER
    assert np.abs(u - exact).max() < 2e-3 * exact.max()


@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("d", [2, 3])
def test_pressure_on_a_homogeneously_deformed_body_has_the_force_of_the_deformed_side(d, degree):
    """∫ p n da = p cof(F) N A over two sides of a unit box, F not symmetric."""
    F = np.eye(d) + 0.4 * np.random.default_rng(1).uniform(-1, 1, (d, d))
    domain = on(COMM, "box", cell_size=0.5, dimension=d, structured=True)
    body = problem(domain, degree=degree, pressures=[(("right", "top"), lambda x, t: np.full(len(x), 2.0))])
    body.equations.set_time(1.0)
    body.space.u.x.array[:] = (body.space.positions @ (F - np.eye(d)).T).ravel()
    out = body.equations.vector.duplicate()
    body.equations.pressures[0].add_residual(out)
    normals = np.eye(d)[0] + np.eye(d)[-1]
    assert out.array.reshape(-1, d).sum(axis=0) == pytest.approx(
        2 * np.linalg.det(F) * np.linalg.inv(F).T @ normals
    )


@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("d", [2, 3])
def test_the_tangent_is_the_derivative_of_the_residual(d, degree):
    """With C2 active, inertia, both dampings and a pressure; the error of central differences is about 1e-8."""
    domain = on(COMM, "box", cell_size=0.5, dimension=d, structured=True)
    body = problem(
        domain,
        degree=degree,
        pressures=[(("right", "top"), lambda x, t: 1 + x[:, 0])],
        integrator="bdf2",
        damping=(0.3, 0.2),
        prescribed=[Prescribed(boundary=("left",))],
    )
    random, equations = np.random.default_rng(2), body.equations
    equations.set_time(1.0)
    equations.begin(body.scheme.terms(body.motion, 0.5), body.motion.u)
    x, step, low, high, product = (equations.vector.duplicate() for _ in range(5))
    x.array[:] = 0.1 * random.normal(size=len(x.array))
    step.array[:] = random.normal(size=len(x.array))
    step.array[equations.held] = 0
    equations.tangent(x, equations.matrix, False)
    equations.matrix.mult(step, product)
    h = 1e-6
    equations.residual(x + h * step, high)
    equations.residual(x - h * step, low)
    difference = (high.array - low.array) / (2 * h)
    assert product.array == pytest.approx(difference, abs=1e-6 * np.abs(difference).max())
