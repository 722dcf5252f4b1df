"""Several bodies from the mesh of one: places, names, and what stays the same."""

from __future__ import annotations

import numpy as np
import pytest

from extremal.meshes import Copies, check_mesh, copies, generate


def box(d, **more):
    return generate("box", size=1.0, cell_size=0.5, dimension=d, structured=True, **more)


@pytest.mark.parametrize(("d", "order"), [(2, 1), (2, 2), (3, 1), (3, 2)])
def test_a_copy_is_the_body_turned_about_its_middle_and_moved(d, order):
    one = box(d, order=order)
    shift, angle = np.arange(1.0, d + 1), 0.3
    two = copies(one, [Copies(), Copies(shift, (0.0, 0.0, angle))])
    n = len(one.points)
    np.testing.assert_array_equal(two.points[:n], one.points)
    np.testing.assert_array_equal(two.cells, np.vstack([one.cells, one.cells + n]))
    np.testing.assert_allclose(two.volumes(), np.tile(one.volumes(), 2), rtol=1e-12)
    middle = one.points.mean(axis=0)
    np.testing.assert_allclose(two.points[n:].mean(axis=0), middle + shift, rtol=1e-12)
    x, y = (one.points - middle)[:, :2].T
    turned = np.column_stack([np.cos(angle) * x - np.sin(angle) * y, np.sin(angle) * x + np.cos(angle) * y])
    np.testing.assert_allclose(two.points[n:, :2], (middle + shift)[:2] + turned, atol=1e-12)


def test_bodies_share_names_unless_they_have_their_own():
    one = box(3)
    all_of_them = copies(one, [Copies(), Copies((2.0, 0.0, 0.0)), Copies((4.0, 0.0, 0.0), name="last")])
    assert list(all_of_them.region_names) == ["body", "last_body"]
    sizes = [int((all_of_them.regions == tag).sum()) for tag in all_of_them.region_names.values()]
    assert sizes == [2 * len(one.cells), len(one.cells)]
    for name, tag in one.boundary_names.items():
        count = int((one.facet_tags == tag).sum())
        for whole, times in ((name, 2), (f"last_{name}", 1)):
            found = all_of_them.facets[all_of_them.facet_tags == all_of_them.boundary_names[whole]]
            assert len(found) == times * count
            x = all_of_them.points[found].mean(axis=(0, 1))[0]
            assert (x > 4 - 1e-9) == (times == 1)
    check_mesh(all_of_them, "bodies")


@pytest.mark.parametrize("d", [2, 3])
def test_a_lattice_of_bodies_each_turned_at_random(d):
    placed = Copies((0.0,) * d, count=(2, 3, 2)[:d], spacing=(2.0, 3.0, 4.0)[:d], tumbled=5)
    one, lattice = box(d), copies(box(d), [placed])
    number = int(np.prod(placed.count))
    bodies = lattice.points.reshape(number, -1, d)
    expected = [[2.0 * i, 3.0 * j, 4.0 * k][:d] for i in range(2) for j in range(3) for k in range(2 if d == 3 else 1)]
    np.testing.assert_allclose(bodies.mean(axis=1) - one.points.mean(axis=0), expected, atol=1e-12)
    shapes = bodies - bodies.mean(axis=1, keepdims=True)
    assert len(np.unique(shapes[:, 0].round(6), axis=0)) == number  # no two are turned alike
    np.testing.assert_allclose(lattice.volumes().sum(), number * one.volumes().sum(), rtol=1e-12)
    np.testing.assert_array_equal(lattice.points, copies(box(d), [placed]).points)
