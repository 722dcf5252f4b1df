"""What sweeps compute: power laws with their confidence, the front, how far a run is from its reference."""

import math

import numpy as np
import pytest

from extremal.app.sweep import norms
from extremal.app.sweep.fits import front, power_law


def test_fits_recover_known_slopes_and_their_confidence():
    random = np.random.default_rng(1)
    x = np.logspace(0, 3, 12)
    exact = power_law(x, 5 * x**-1.5)
    assert (exact.slope, exact.level) == pytest.approx((-1.5, 5))
    inside = 0
    for _ in range(200):
        fit = power_law(x, 5 * x**-1.5 * np.exp(0.3 * random.standard_normal(12)))
        inside += fit.low <= -1.5 <= fit.high
    assert 180 <= inside <= 199  # 95% of 200, three standard deviations either way


def test_two_points_have_a_slope_without_confidence_and_one_has_none():
    fit = power_law([1, 10], [1, 100])
    assert fit.slope == pytest.approx(2)
    assert math.isinf(fit.low)
    assert power_law([3, 3], [1, 2]) is None
    # one above the other: the slope would be 7e4, and 2 to that power no number
    assert power_law([3, 3.00003], [1, 2]) is None
    assert power_law([1, 2, 3], [1, 0, math.nan]) is None


def test_front_keeps_what_no_other_point_beats():
    assert front([3, 1, 2, 2, 4], [0.2, 0.9, 0.5, 0.4, 0.3]) == [1, 3, 0]
    assert front([], []) == []
    assert front([1, 2], [0.1, 0.0999]) == [0]  # no better


def test_histories_are_compared_over_time():
    t = np.linspace(0, 1, 101)
    fine = (t, np.sin(t))
    assert norms.of_histories(fine, fine) == 0
    assert norms.of_histories((t, 1.1 * np.sin(t)), fine) == pytest.approx(0.1)
    # every tenth time only: straight lines between them are wrong by dt²/8 at most
    assert norms.of_histories((t[::10], np.sin(t[::10])), fine) < 0.1**2 / 8


def test_fields_are_interpolated_at_the_points_of_the_run():
    random = np.random.default_rng(0)
    corners = np.array([[i, j, k] for i in (0, 1) for j in (0, 1) for k in (0, 1)], dtype=float)
    known = np.vstack([corners, random.uniform(0, 1, (200, 3))])
    points = random.uniform(0, 1, (50, 3))
    linear = lambda x: x @ np.array([[1.0, 2.0, 0.0], [0.0, 1.0, 3.0], [1.0, 0.0, 1.0]])  # noqa: E731
    reference = norms.Interpolated(known, linear(known))
    assert norms.of_fields(points, 1.02 * linear(points), reference) == pytest.approx(0.02)
    assert norms.of_fields(known, 1.02 * linear(known), reference) == pytest.approx(0.02)
    points, known = points * [1, 1, 0], known * [1, 1, 0]
    assert norms.of_fields(points, linear(points), norms.Interpolated(known, linear(known))) < 1e-12


def test_a_front_is_where_a_hundredth_of_the_mass_is_ahead():
    x = np.random.default_rng(1).permutation(np.arange(1000.0))[:, None] * [1, -1]
    m = np.ones(1000)
    assert norms.front(x, m, 0) == 989 and norms.front(x, m, 1) == -10
    m[x[:, 0] == 995] = 50  # one heavy particle
    assert norms.front(x, m, 0) == 995


def test_shares_of_pairs_are_compared_event_by_event():
    there = {(1, "a", "b"): 0.75, (1, "a", "c"): 0.25, (2, "b", "c"): 1.0}
    here = {(1, "a", "b"): 0.5, (1, "a", "d"): 0.5, (2, "b", "c"): 1.0}
    assert norms.of_shares(there, there) == 0
    assert norms.of_shares(here, there) == pytest.approx(0.25)  # half of event 1's, nothing of event 2's


def test_densities_count_the_mass_in_the_wrong_cell():
    x = np.array([[0.5, 0.5], [1.5, 0.5], [-0.5, 0.5], [0.5, 0.5]])
    moved = x + [[0, 0], [0, 0], [0, 0], [2, 0]]
    m = np.full(4, 0.25)
    assert norms.of_densities((x, m), (x, m), 1.0) == 0
    assert norms.of_densities((moved, m), (x, m), 1.0) == pytest.approx(0.5)  # a quarter is missing, and too much
