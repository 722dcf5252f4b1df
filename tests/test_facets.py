"""Distances to closed surfaces of triangles and segments: those of the shapes that they enclose."""

import numpy as np
import pytest
from numpy.typing import NDArray

from extremal.obstacles.facets import Facets, boundary
from extremal.obstacles.geometry import central_gradient
from extremal.obstacles.shapes import Box

SIZES = {2: (1.0, 0.4), 3: (1.0, 0.4, 0.6)}


def simplices(dimension: int, cells: int = 4) -> tuple[NDArray, NDArray]:
    """Points and simplices of a box from the origin, cut into cubes and these along their diagonals."""
    from itertools import permutations

    counts = (cells,) * dimension
    grid = np.stack(np.meshgrid(*[np.arange(cells + 1)] * dimension, indexing="ij"), axis=-1).reshape(-1, dimension)
    first = np.stack(np.meshgrid(*[np.arange(cells)] * dimension, indexing="ij"), axis=-1).reshape(-1, dimension)
    found = []
    for order in permutations(range(dimension)):
        corners = [first]
        for axis in order:
            corners.append(corners[-1] + np.eye(dimension, dtype=int)[axis])
        found.append(np.stack([np.ravel_multi_index(c.T, [n + 1 for n in counts]) for c in corners], axis=1))
    return grid * np.array(SIZES[dimension]) / cells, np.concatenate(found)


def around(dimension: int, count: int = 500) -> NDArray:
    size = np.array(SIZES[dimension])
    return np.random.default_rng(1).uniform(-0.5 * size, 1.5 * size, (count, dimension))


@pytest.mark.parametrize("dimension", [2, 3])
def test_distance_to_the_surface_of_a_box_is_that_of_the_box(dimension: int) -> None:
    points, cells = simplices(dimension)
    box, x = Box(np.zeros(dimension), SIZES[dimension]), around(dimension)
    # places beside edges and corners, and on the surface itself, are the ones whose side could be mistaken
    size = np.array(SIZES[dimension])
    x = np.vstack([x, size * (1 + 0.1 * np.eye(dimension)), -0.05 * size[None], 1.01 * size[None], points])
    found = Facets(points, boundary(points, cells)).nearest(x)
    assert found.phi == pytest.approx(box.distance(x), abs=1e-14)
    away = box.distance(x) > 1e-3
    assert found.normal[away] == pytest.approx(box.normal(x[away]), abs=1e-12)


@pytest.mark.parametrize("dimension", [2, 3])
def test_distance_to_a_bent_body_is_the_least_to_any_facet_and_its_gradient_the_normal(dimension: int) -> None:
    points, cells = simplices(dimension)
    facets = boundary(points, cells)
    bent = points.copy()
    bent[:, 1] += 0.8 * points[:, 0] ** 2
    surface, x = Facets(bent, facets), around(dimension, 300)
    found = surface.nearest(x)
    parts = np.array([p for p in np.ndindex(*(21,) * dimension) if sum(p) == 20]) / 20
    dense = np.einsum("pk,fkd->fpd", parts, bent[facets]).reshape(-1, dimension)
    sampled = np.array([np.linalg.norm(dense - one, axis=1).min() for one in x])
    # the places looked at are at most 0.03 m apart: twentieths of edges of up to 0.5 m
    assert (np.abs(found.phi) <= sampled + 1e-12).all() and (sampled - np.abs(found.phi) < 0.03).all()
    place = np.einsum("nk,nkd->nd", found.weights, bent[found.nodes])
    assert found.weights.sum(axis=1) == pytest.approx(1) and found.weights.min() >= 0
    assert np.linalg.norm(x - place, axis=1) == pytest.approx(np.abs(found.phi), abs=1e-14)
    # differences over 1e-6 m see a kink at a few of the points
    slope = central_gradient(lambda y: surface.nearest(y).phi, x, 1e-6)
    assert np.mean(np.abs(slope - found.normal).max(axis=1) < 1e-4) > 0.97


@pytest.mark.parametrize("dimension", [2, 3])
def test_normal_of_what_is_on_the_surface_but_for_rounding_is_that_of_the_surface(dimension: int) -> None:
    points, cells = simplices(dimension)
    surface = Facets(points, boundary(points, cells))
    x = np.full((2, dimension), 0.13)
    x[:, 0] = [3e-18, -3e-18]
    assert surface.nearest(x).normal == pytest.approx(np.tile(-np.eye(dimension)[0], (2, 1)), abs=1e-12)


@pytest.mark.parametrize("dimension", [2, 3])
def test_what_is_far_from_all_elements_is_outside(dimension: int) -> None:
    points, cells = simplices(dimension)
    bent = points.copy()
    bent[:, 1] += 0.8 * points[:, 0] ** 2
    surface, x = Facets(bent, boundary(points, cells), cells), around(dimension, 3000)
    near = surface.near(x, 0.01)
    assert 0 < len(near) < len(x) / 2
    assert set(np.flatnonzero(surface.nearest(x).phi <= 0.01)) <= set(near)


@pytest.mark.parametrize("dimension", [2, 3])
def test_facets_look_outwards_however_the_elements_are_numbered(dimension: int) -> None:
    points, cells = simplices(dimension)
    swapped = cells.copy()
    swapped[::2, :2] = cells[::2, 1::-1]
    for listed in (cells, swapped):
        surface = Facets(points, boundary(points, listed))
        assert surface.nearest(points.mean(axis=0)[None]).phi[0] < 0
        assert len(surface.facets) == (16 if dimension == 2 else 6 * 16 * 2)
