"""Cases of snow and of networks: exact solutions are exact, errors fall as theory says."""

import numpy as np
import pytest
from mpi4py import MPI

from extremal.app.errors import InputError
from extremal.app.studies.cases import hawkes_ranks, snow_bar, snow_vortex
from extremal.app.sweep import recommend

SERIAL = MPI.COMM_SELF


def point(case, comm=SERIAL, **settings):
    """What the case reports for its defaults with these settings."""
    unknown = settings.keys() - case.KEYS.keys()
    assert not unknown, unknown
    return case.run({**case.KEYS, **settings}, comm)


# ---------------------------------------------------------------------------------------- bar


@pytest.mark.parametrize("spline", ["cubic", "quadratic"])
def test_a_bars_displacement_converges_with_order_two(spline):
    errors = [point(snow_bar, cell_size=h, spline=spline)["error"] for h in (0.1, 0.05, 0.025)]
    orders = np.log2(np.divide(errors[:-1], errors[1:]))
    assert (orders > 1.8).all() and errors[-1] < 0.01


def test_a_bars_implicit_steps_are_of_first_order_and_counted():
    coarse, fine = (point(snow_bar, cell_size=0.025, beta=1.0, time_step=dt) for dt in (4e-3, 1e-3))
    assert coarse["error"] / fine["error"] == pytest.approx(4, rel=0.2)  # the grid's 0.9% is in both
    assert (coarse["steps"], fine["steps"]) == (50, 200)
    assert coarse["iterations"]["krylov_iterations"] > 50
    # (7.9) damps a mode by β ω² Δt/2
    assert fine["diagnostics"]["damping"] == pytest.approx(snow_bar.FREQUENCY**2 * 1e-3 / 2, rel=0.03)


def test_measured_volumes_make_a_bar_too_stiff():
    seeded, measured = (point(snow_bar, volumes=v, norm="frequency")["error"] for v in ("seeded", "measured"))
    assert measured > 5 * seeded


def test_a_step_that_is_too_long_is_a_failure_and_a_lattice_needs_a_square():
    with pytest.raises(ArithmeticError, match="cross too many cells"):
        point(snow_bar, time_step=2e-3)
    with pytest.raises(InputError, match="per_cell = 5: must be a square"):
        point(snow_bar, per_cell=5)


@pytest.mark.mpi
def test_cases_of_snow_are_the_same_on_any_number_of_ranks(comm):
    for case, more in ((snow_bar, {"periods": 0.1}), (snow_vortex, {"end": 0.05})):
        alone = point(case, **more)
        shared = point(case, comm, **more)
        assert shared["size"] == alone["size"]
        assert shared["error"] == pytest.approx(alone["error"], rel=1e-6)


# ---------------------------------------------------------------------------------------- vortex


def test_the_vortexs_force_is_that_of_its_motion_and_its_energy():
    """b = ∂²x/∂t² - Div P/ρ with P of the Neo-Hookean energy, worked out in Cartesian coordinates by sympy."""
    import sympy as sp

    X, Y, t, A = sp.symbols("X Y t A", real=True)
    s = sp.sqrt(X**2 + Y**2) - 1
    angle = A * sp.sin(sp.pi * t / snow_vortex.PERIOD) * (1 - 32 * s**2 + 256 * s**4)
    x = sp.Matrix([[sp.cos(angle), -sp.sin(angle)], [sp.sin(angle), sp.cos(angle)]]) @ sp.Matrix([X, Y])
    ν, E = sp.Rational(3, 10), 1000
    assert (snow_vortex.POISSON, snow_vortex.STIFF) == (0.3, 1000)
    μ, λ = E / (2 * (1 + ν)), E * ν / ((1 + ν) * (1 - 2 * ν))
    F = x.jacobian([X, Y])
    J = F.det()
    inverse = F.adjugate().T / J
    P = μ * (F - inverse) + λ * sp.log(J) * inverse
    force = x.diff(t, 2) - (P[:, 0].diff(X) + P[:, 1].diff(Y)) / snow_vortex.DENSITY
    wanted = sp.lambdify((X, Y, t, A), [force, x, x.diff(t)], cse=True)
    random = np.random.default_rng(3)
    R, Θ = random.uniform(0.76, 1.24, 5), random.uniform(0, 6.28, 5)
    places = np.column_stack([R * np.cos(Θ), R * np.sin(Θ)])
    for at in places:
        for name, values in zip(("force", "place", "velocity"), wanted(*at, 0.3, 0.7)):
            found = getattr(snow_vortex, name)(at[None], 0.3, 0.7)[0]
            assert found == pytest.approx(np.ravel(values), rel=1e-9, abs=1e-9), name


def test_the_vortex_converges():
    """Order 1.7 at these cells; two from the next on, see docs/accuracy.md."""
    coarse, fine = (point(snow_vortex, cell_size=h, end=0.25)["error"] for h in (0.05, 0.025))
    assert np.log2(coarse / fine) > 1.5 and fine < 0.03


# ---------------------------------------------------------------------------------------- recommendations


def test_what_to_set_for_a_snow_drop_is_answered_from_the_shipped_fronts(monkeypatch, tmp_path):
    """Each error has a paragraph of its own, those that cannot be had included."""
    monkeypatch.setattr(recommend, "OWN", tmp_path)
    said = recommend.recommend("app/scenes/snowball_drop.toml", 1e-2, None).split("\n\nsnow-")
    assert "petsc.snow_ksp_rtol = " in said[0]  # the algebra is good enough
    refused = {words.partition(":")[0] for words in said if "no point has an error of 1% or less" in words}
    assert refused == {"drop-density", "drop-front", "drop-mesh", "drop-step"}
    reasons = {words.partition(":")[0]: words for words in said}
    assert "the reference is only 2 times as large" in reasons["drop-step"]
    assert "by its slope 1% would take about" in reasons["drop-mesh"]  # its reference has 27 times the particles
    assert "no clear relation" in reasons["drop-density"] and "would take years" in reasons["drop-front"]


# ---------------------------------------------------------------------------------------- networks


def small(**settings):
    """The error with 40 sets of 8 incomplete events."""
    return point(hawkes_ranks, data="small", sets=40, **settings)


def test_first_candidates_of_the_exact_posterior_lose_nothing():
    """Nothing lost is told as half an event."""
    found = small(method="enumeration")
    assert found["diagnostics"] == {"other_first_candidates": 0, "incomplete_events": 320}
    assert found["error"] == 0.5 / 320


def test_more_samples_lose_less_and_disagree_more_than_they_lose():
    few, many = (small(method="Gibbs", stop=n) for n in (1, 100))
    assert few["error"] > 4 * many["error"]  # 1/samples, were it not for the burn-in
    assert small(method="Gibbs", stop=1, error="disagreement")["error"] > few["error"]


def test_a_proven_gap_leaves_few_flips_whatever_the_solver():
    for solver in ("sweeps", "blmvm", "tron"):
        loose, tight = (small(error="flips", solver=solver, stop=gap)["error"] for gap in (1e-1, 1e-8))
        assert tight <= 2 / 320 and tight <= loose
