"""Splines and the compact grid: weights as printed, every touched node once, memory that follows the particles."""

import itertools

import numpy as np
import pytest
from snow_reference import BOTH, SPLINE, cloud, dense, laid_out, lattice, to_particles

from extremal.mpm.particles import Particles

H = 0.1


def weights(x, spline):
    """Weights of one particle at x (d,), and its nodes."""
    grid, _ = laid_out(p := Particles.at(np.atleast_2d(x), 1.0), H, spline)
    mass, momentum = grid.zeros(), grid.zeros(len(x))
    grid.call("to_grid", p.position, p.velocity, p.mass, mass, momentum)
    return mass, grid


def interpolated(grid, p, nodal):
    """Value and gradient at the particles of a node field (count, d)."""
    value, gradient, _ = to_particles(grid, p, nodal, nodal, 0.0)
    return value, gradient.reshape(-1, p.dimension, p.dimension)


@pytest.mark.parametrize("spline", ["cubic", "quadratic"])
def test_reference_splines_are_b_splines(spline):
    N, slope = SPLINE[spline]
    x = np.linspace(-2.5, 2.5, 2001)
    assert np.allclose(sum(N(x % 1 + k) for k in range(-3, 4)), 1, atol=1e-14)
    assert np.allclose((N(x + 1e-6) - N(x - 1e-6)) / 2e-6, slope(x), atol=2e-6)  # kinks of N'' at knots


@pytest.mark.parametrize("d, spline", BOTH)
def test_weights_and_gradients_are_those_of_the_printed_splines(d, spline):
    rng = np.random.default_rng(d)
    p, _ = cloud(rng, d, 200, H)
    grid, _ = laid_out(p, H, spline)
    w, dw = dense(grid, p.position, spline)
    mass, momentum = grid.zeros(), grid.zeros(d)
    grid.call("to_grid", p.position, p.velocity, p.mass, mass, momentum)
    assert np.allclose(mass, w.T @ p.mass, rtol=0, atol=1e-14 * mass.max())
    assert np.allclose(momentum, w.T @ (p.mass[:, None] * p.velocity), rtol=0, atol=1e-13 * np.abs(momentum).max())
    nodal = rng.normal(size=(grid.count, d))
    value, gradient = interpolated(grid, p, nodal)
    assert np.allclose(value, w @ nodal, rtol=0, atol=1e-13)
    assert np.allclose(gradient, np.einsum("ia,pib->pab", nodal, dw), rtol=0, atol=1e-12 / H)


@pytest.mark.parametrize("d, spline", BOTH)
def test_constants_and_linear_fields_are_reproduced(d, spline):
    rng = np.random.default_rng(10 + d)
    p, _ = cloud(rng, d, 300, H)
    grid, _ = laid_out(p, H, spline)
    A, c = rng.normal(size=(d, d)), rng.normal(size=d)
    value, gradient = interpolated(grid, p, grid.positions() @ A.T + c)
    assert np.allclose(value, p.position @ A.T + c, rtol=0, atol=1e-13)
    assert np.allclose(gradient, A, rtol=0, atol=1e-12)


@pytest.mark.parametrize("d, spline", BOTH)
def test_gradients_are_derivatives_of_the_values(d, spline):
    rng = np.random.default_rng(20 + d)
    p, _ = cloud(rng, d, 60, H)
    p.position = (np.floor(p.position / H * 2) + rng.uniform(0.2, 0.8, p.position.shape)) * H / 2  # away from knots
    grid, _ = laid_out(p, H, spline)
    nodal = rng.normal(size=(grid.count, d))
    _, gradient = interpolated(grid, p, nodal)
    step = 1e-5 * H
    for k in range(d):
        there = []
        for sign in (1, -1):
            q = p.take(np.arange(len(p)))
            q.position[:, k] += sign * step
            there.append(interpolated(grid, q, nodal)[0])
        # second order, and N''' is of order 1/h^3: (step/h)^2/6 of a gradient of order 1/h
        assert np.allclose((there[0] - there[1]) / (2 * step), gradient[:, :, k], atol=1e-9 / H)


@pytest.mark.parametrize("d, spline", BOTH)
def test_weights_are_never_negative_and_sum_to_one_even_at_cell_faces(d, spline):
    faces = [k * H for k in (-3, -1, 0, 1, 7)] + [(k + 0.5) * H for k in (-2, 0, 3)]
    places = [y for x in faces for y in (np.nextafter(x, -1), x, np.nextafter(x, 1))]
    places += [1e-300, -1e-300, 1e-17, -1e-17, 5e-5 * H, (1 - 1e-16) * H]
    for x in places:
        mass, grid = weights(np.full(d, x), spline)
        assert (mass >= 0).all() and mass.sum() == pytest.approx(1, abs=4e-16 * 4**d)
        assert mass @ grid.positions() == pytest.approx(np.full(d, x), abs=1e-15)


@pytest.mark.parametrize("d, spline", BOTH)
def test_nodes_are_numbered_as_a_dictionary_would(d, spline):
    rng = np.random.default_rng(30 + d)
    x = np.vstack([rng.normal(size=(150, d)) * 5 * H, rng.normal(size=(50, d)) * H + 70 * H])
    p = Particles.at(x, 1.0)
    grid, _ = laid_out(p, H, spline)
    width = {"cubic": 4, "quadratic": 3}[spline]
    first = np.floor(p.position / H).astype(int) - 1 if width == 4 else np.floor(p.position / H - 0.5).astype(int)
    stencil = list(itertools.product(range(width), repeat=d))
    touched = sorted({tuple(f + np.array(s)) for f in first for s in stencil})
    assert [tuple(n) for n in grid.node] == touched
    number = {node: k for k, node in enumerate(touched)}
    assert grid.cells == len({tuple(f) for f in first}) == len(grid.start) - 1
    for c in range(grid.cells):
        mine = first[grid.start[c] : grid.start[c + 1]]
        assert (mine == grid.base[c]).all()
        rows = [number[tuple(grid.base[c] + np.array([*s, 0]))] for s in itertools.product(range(width), repeat=d - 1)]
        assert list(grid.rows[c]) == rows
        for row, s in zip(rows, itertools.product(range(width), repeat=d - 1)):
            assert number[tuple(grid.base[c] + np.array([*s, width - 1]))] == row + width - 1


@pytest.mark.parametrize("d, spline", BOTH)
def test_find_knows_each_node_and_no_other(d, spline):
    rng = np.random.default_rng(40 + d)
    grid, _ = laid_out(Particles.at(rng.normal(size=(40, d)) * 6 * H, 1.0), H, spline)
    assert (grid.find(grid.node) == np.arange(grid.count)).all()
    known = {tuple(n) for n in grid.node}
    asked = rng.integers(-40, 40, (3000, d)).astype(np.int32)
    found = grid.find(asked)
    assert [f >= 0 for f in found] == [tuple(a) in known for a in asked]
    assert (grid.node[found[found >= 0]] == asked[found >= 0]).all()


@pytest.mark.parametrize("d, spline", BOTH)
def test_particles_are_sorted_by_cell_then_number_whatever_their_order(d, spline):
    rng = np.random.default_rng(50 + d)
    x = rng.normal(size=(5000 if d == 3 else 1500, d)) * 3 * H
    orders = []
    for shuffle in (np.arange(len(x)), rng.permutation(len(x))):
        p = Particles.at(x, rng.uniform(1, 2)).take(shuffle)
        grid, rows = laid_out(p, H, spline)
        keys = [*grid.base[np.repeat(np.arange(grid.cells), np.diff(grid.start))].T, p.ident]
        assert (np.lexsort(keys[::-1]) == np.arange(len(p))).all()
        assert (p.position == x[p.ident]).all() and (shuffle[rows] == p.ident).all()
        orders.append(p.ident.copy())
    assert (orders[0] == orders[1]).all()


@pytest.mark.parametrize("d, spline", BOTH)
def test_the_density_of_a_lattice_is_exact_inside(d, spline):
    per = 2
    x = lattice([0.0] * d, [10 * H] * d, H / per)
    p = Particles.at(x, 400 * (H / per) ** d)
    grid, _ = laid_out(p, H, spline)
    mass, momentum = grid.zeros(), grid.zeros(d)
    grid.call("to_grid", p.position, p.velocity, p.mass, mass, momentum)
    density = np.empty(len(p))
    grid.call("density", p.position, mass, density)
    deep = ((p.position > 3.5 * H) & (p.position < 6.5 * H)).all(axis=1)
    # sums of a cubic B-spline over a lattice of spacing h/2 are constant; of a quadratic one too (refinability)
    assert deep.any() and np.allclose(density[deep], 400, rtol=1e-13)
    assert (density < 400 * (1 + 1e-13)).all()


@pytest.mark.parametrize("d, spline", BOTH)
def test_single_precision_loops_agree_to_single_precision(d, spline):
    rng = np.random.default_rng(60 + d)
    p, _ = cloud(rng, d, 100, H)
    results = []
    for precision in ("double", "single"):
        q = p.take(np.arange(len(p)))
        grid, _ = laid_out(q, H, spline, precision)
        real = grid.kernel.real
        mass, momentum = grid.zeros(0, real), grid.zeros(d, real)
        grid.call("to_grid", q.position, q.velocity, q.mass, mass, momentum)
        results.append(np.column_stack([mass, momentum]))
    assert results[1].dtype == np.float32
    assert np.abs(results[0] - results[1]).max() < 1e-6 * np.abs(results[0]).max()


@pytest.mark.parametrize("d, spline", BOTH)
def test_numbering_by_sorting_is_numbering_by_bits(d, spline, monkeypatch):
    x = np.random.default_rng(5).normal(size=(500, d)) * 5 * H
    one, _ = laid_out(Particles.at(x, 1.0), H, spline)
    monkeypatch.setattr("extremal.mpm.grid.MOST_WORDS", 0)
    monkeypatch.setattr("extremal.mpm.grid.WORDS_PER_PARTICLE", 0)
    two, _ = laid_out(Particles.at(x, 1.0), H, spline)
    assert one._keys is None and two._keys is not None
    for name in ("count", "cells", "start", "base", "rows", "node"):
        assert np.array_equal(getattr(one, name), getattr(two, name))
    asked = np.random.default_rng(6).integers(-60, 60, (2000, d)).astype(np.int32)
    assert np.array_equal(one.find(asked), two.find(asked))


def test_particles_too_far_apart_for_any_numbering_are_refused():
    with pytest.raises(FloatingPointError, match=r"spread over \d+ x \d+ x \d+ cells"):
        laid_out(Particles.at([[-9e7] * 3, [9e7] * 3], 1.0), 0.1001, "cubic")


@pytest.mark.parametrize("d, spline", BOTH)
def test_stray_particles_do_not_cost_the_box_around_them(d, spline):
    far = np.vstack([np.zeros(d), np.full(d, 1e5 * H), [-3e5 * H] + [2e5 * H] * (d - 1), np.full(d, 0.1 * H)])
    p = Particles.at(far, 1.0)
    grid, _ = laid_out(p, H, spline)
    width = {"cubic": 4, "quadratic": 3}[spline]
    assert 3 * width**d <= grid.count <= 4 * width**d
    assert (grid.find(grid.node) == np.arange(grid.count)).all()
    assert (grid.find(grid.node + np.int32(1000)) == -1).all()
    mass, momentum = grid.zeros(), grid.zeros(d)
    grid.call("to_grid", p.position, p.velocity, p.mass, mass, momentum)
    assert mass.sum() == pytest.approx(4, abs=1e-13)
    assert np.allclose(mass @ grid.positions() / 1e5, far.sum(axis=0) / 1e5, atol=1e-12)
