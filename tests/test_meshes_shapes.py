"""Generated bodies have the right size, names, orientation and order, and are the same every time."""

import math

import numpy as np
import pytest

from extremal.meshes import SHAPES, MeshData, MeshError, generate
from extremal.meshes.check import repair
from extremal.meshes.quality import facet_measures

BOX = {"left", "right", "front", "back", "bottom", "top"}
FLAT = {"left", "right", "bottom", "top"}
π = math.pi
CREATURE = {"feet", "legs", "head", "ears", "tail", "trunk"}

# shape, parameters, exact volume [m³] or area [m²] (None: not in closed form), boundaries
BODIES = [
    ("box", {"size": [1, 2, 3], "cell_size": 0.5}, 6, BOX),
    ("box", {"size": [1, 2], "cell_size": 0.3, "dimension": 2}, 2, FLAT),
    ("box", {"cell_size": 0.3, "structured": True}, 1, BOX),
    ("bar", {"cell_size": 0.5}, 4, BOX),
    ("bar", {"dimension": 2}, 4, FLAT),
    ("mattress", {}, 0.8, FLAT),
    ("mattress", {"dimension": 3}, 0.4, BOX),
    ("mattress", {"structured": False}, 0.8, FLAT),
    ("sphere", {"radius": 2, "cell_size": 0.5}, 4 / 3 * π * 8, {"top", "bottom"}),
    ("sphere", {"dimension": 2, "cell_size": 0.2}, π, {"top", "bottom"}),
    ("cylinder", {"radius": 0.5, "length": 3}, π * 0.75, {"bottom", "top", "side"}),
    ("tube", {"length": 1}, π * 0.16, {"bottom", "top", "inner", "outer"}),
    ("tube", {"dimension": 2}, π * 0.16, {"inner", "outer"}),
    ("torus", {}, 2 * π * π * 0.0625, {"left", "right"}),
    ("torus", {"straight": 1.0}, π * 0.0625 * (2 * π + 2), {"left", "right"}),
    ("creature", {"cell_size": 0.15}, None, CREATURE),
    ("creature", {"cell_size": 0.15, "dimension": 2}, None, CREATURE),
    ("fish", {}, None, {"tail", "fin", "body"}),
    ("fish", {"dimension": 2}, None, {"tail", "fin", "body"}),
    ("triangle", {"size": 2}, math.sqrt(3), {"base", "left", "right"}),
    ("triangle", {"corners": [[0, 0], [3, 0], [0, 2]]}, 3, {"base", "left", "right"}),
    ("tetrahedron", {}, math.sqrt(2) / 12, {"base", "front", "left", "right"}),
    ("simplex", {"dimension": 2}, math.sqrt(3) / 4, {"base", "left", "right"}),
    ("simplex", {"dimension": 3}, math.sqrt(2) / 12, {"base", "front", "left", "right"}),
]
IDS = [f"{shape}-{i}" for i, (shape, *_) in enumerate(BODIES)]


def areas(data: MeshData) -> dict[str, float]:
    measures = facet_measures(data.points, data.facets)
    return {name: float(measures[data.facet_tags == tag].sum()) for name, tag in data.boundary_names.items()}


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("shape, parameters, volume, names", BODIES, ids=IDS)
def test_bodies_have_their_volume_and_named_boundaries(shape, parameters, volume, names, order):
    data = generate(shape, order=order, **parameters)
    assert data.order == order
    assert data.volumes().min() > 0
    assert set(data.boundary_names) == names
    if volume is not None:
        # chords of curved sides: relative error (h/r)²/24 and more in first order, fourth power in second
        assert data.volumes().sum() == pytest.approx(volume, rel=0.12 if order == 1 else 2e-2)
    repaired = repair(data, shape)
    assert repaired.notes == ()
    assert len(repaired.facets) == len(data.facets), "every facet belongs to an element and has one tag"
    assert all(area > 0 for area in areas(data).values())
    # each exterior facet has a tag: the closed boundary's area vectors add up to zero, and none is missing
    facets = np.sort(
        np.concatenate([np.delete(data.corners, i, 1) for i in range(data.dimension + 1)]), axis=1
    )
    _, count = np.unique(facets, axis=0, return_counts=True)
    assert int((count == 1).sum()) == len(data.facets)


def test_every_shape_is_tested():
    assert set(SHAPES) == {shape for shape, *_ in BODIES}


@pytest.mark.parametrize("shape", SHAPES)
def test_the_same_parameters_give_the_same_mesh(shape):
    first, second = generate(shape), generate(shape)
    for name in ("points", "cells", "facets", "facet_tags", "regions"):
        assert np.array_equal(getattr(first, name), getattr(second, name))


def test_sides_of_a_box_lie_where_their_names_say():
    data = generate("box", size=[1, 2, 3], corner=[5, 6, 7], cell_size=0.5)
    for name, axis, value in [
        ("left", 0, 5),
        ("right", 0, 6),
        ("front", 1, 6),
        ("back", 1, 8),
        ("top", 2, 10),
    ]:
        nodes = data.facets[data.facet_tags == data.boundary_names[name]]
        assert np.allclose(data.points[nodes, axis], value, atol=1e-12)
    assert areas(data) == pytest.approx({"left": 6, "right": 6, "front": 3, "back": 3, "bottom": 2, "top": 2})


def test_cell_size_is_the_edge_length():
    for shape, size in [("box", 0.1), ("sphere", 0.2), ("torus", 0.1)]:
        data = generate(shape, cell_size=size)
        ends = data.points[data.corners]
        i, j = np.triu_indices(4, 1)
        edges = np.linalg.norm(ends[:, i] - ends[:, j], axis=2)
        assert edges.mean() == pytest.approx(size, rel=0.35)  # gmsh's inner edges are some 25% longer
        assert edges.max() < 2.5 * size


@pytest.mark.parametrize("dimension", [2, 3])
def test_second_order_follows_a_curved_surface(dimension):
    exact = π if dimension == 2 else 4 / 3 * π
    error = [
        abs(generate("sphere", dimension=dimension, order=order, cell_size=0.3).volumes().sum() - exact)
        for order in (1, 2)
    ]
    assert error[1] < error[0] / 50


def test_order_two_of_a_sphere_converges_with_fourth_order():
    sizes = [0.5, 0.25]
    errors = [abs(generate("sphere", order=2, cell_size=h).volumes().sum() - 4 / 3 * π) for h in sizes]
    assert math.log(errors[0] / errors[1]) / math.log(2) > 3


def test_structured_second_order_has_nodes_in_the_middle_of_edges():
    linear = generate("mattress", dimension=3, cell_size=0.2)
    quadratic = generate("mattress", dimension=3, cell_size=0.2, order=2)
    assert np.array_equal(linear.cells, quadratic.corners)
    assert quadratic.volumes() == pytest.approx(linear.volumes(), rel=1e-12)


def test_the_axis_of_a_cylinder_can_be_chosen():
    for axis, number in [("x", 0), ("y", 1), ("z", 2)]:
        data = generate("cylinder", radius=0.5, length=4, axis=axis, center=[1, 2, 3])
        assert np.ptp(data.points, axis=0)[number] == pytest.approx(4)
        assert data.points[:, number].mean() == pytest.approx([1, 2, 3][number], abs=0.1)
        top = data.facets[data.facet_tags == data.boundary_names["top"]]
        assert data.points[top, number] == pytest.approx(2 + [1, 2, 3][number])


def test_the_feet_of_a_creature_stand_on_the_ground():
    for dimension in (2, 3):
        data = generate("creature", dimension=dimension, size=2.0, cell_size=0.3)
        feet = data.facets[data.facet_tags == data.boundary_names["feet"]]
        assert np.abs(data.points[feet][..., -1]).max() < 1e-12
        assert data.points[:, -1].min() > -1e-9


@pytest.mark.parametrize("dimension", [2, 3])
def test_a_fish_is_as_long_as_said_and_symmetric_but_for_the_fin_on_its_back(dimension):
    data = generate("fish", dimension=dimension, size=2.0, cell_size=0.06)
    low, high = data.points.min(axis=0), data.points.max(axis=0)
    assert high[0] - low[0] == pytest.approx(2)
    if dimension == 3:
        assert low[1] == pytest.approx(-high[1], rel=1e-2)  # facets cut the widest places off, here and there
    back = data.points[data.facets[data.facet_tags == data.boundary_names["fin"]]]
    assert back[..., -1].max() == high[-1] > -low[-1]


WRONG = [
    ("boks", {}, "unknown shape 'boks': did you mean 'box'? accepted: " + ", ".join(SHAPES)),
    (
        "box",
        {"cellsize": 1},
        "box: unknown parameter 'cellsize': did you mean 'cell_size'? "
        "accepted: size, cell_size, dimension, order, corner, structured",
    ),
    ("box", {"size": -1}, "box: size must be a positive number [m], got -1"),
    ("box", {"size": [1, 2]}, "box: size must be 3 positive lengths [m], got [1, 2]"),
    ("box", {"size": "big"}, "box: size must be 3 positive lengths [m], got 'big'"),
    ("box", {"cell_size": 0}, "box: cell_size must be a positive number [m], got 0"),
    ("box", {"cell_size": float("nan")}, "box: cell_size must be a positive number [m], got nan"),
    ("box", {"cell_size": True}, "box: cell_size must be a positive number [m], got True"),
    ("box", {"cell_size": 2}, "box: cell_size must be at most the smallest side, 1 m, got 2"),
    ("box", {"dimension": 4}, "box: dimension must be 2 or 3, got 4"),
    ("box", {"order": 3}, "box: order must be 1 or 2, got 3"),
    ("box", {"corner": [0, 0]}, "box: corner must be 3 coordinates [m], got [0, 0]"),
    ("box", {"structured": "yes"}, "box: structured must be true or false, got 'yes'"),
    (
        "box",
        {"cell_size": 1e-3},
        "box: cell_size 0.001 would give about 8.5e+09 cells; "
        "at most 2e+07 are accepted, cell_size >= 0.0075",
    ),
    ("mattress", {"size": [1, -1]}, "mattress: size must be a positive number [m], got -1"),
    ("sphere", {"radius": 0}, "sphere: radius must be a positive number [m], got 0"),
    ("sphere", {"cell_size": 3}, "sphere: cell_size must be at most the radius, 1 m, got 3"),
    ("cylinder", {"dimension": 2}, "cylinder: dimension must be 3, got 2"),
    ("cylinder", {"axis": "w"}, "cylinder: axis must be 'x', 'y' or 'z', got 'w'"),
    ("tube", {"inner_radius": 0.5}, "tube: inner_radius must be less than radius 0.5 [m], got 0.5"),
    (
        "tube",
        {"cell_size": 0.3},
        "tube: cell_size must be at most the wall thickness (or length), 0.2 m, got 0.3",
    ),
    ("torus", {"thickness": 3}, "torus: thickness must be less than twice the radius, 2 m, got 3"),
    ("torus", {"straight": -1}, "torus: straight must be a positive number [m], got -1"),
    (
        "creature",
        {"cell_size": 0.5},
        "creature: cell_size must be at most the thickness of its legs, 0.16 m, got 0.5",
    ),
    ("fish", {"cell_size": 0.1}, "fish: cell_size must be at most the thickness of its fins, 0.06 m, got 0.1"),
    ("triangle", {"corners": [[0, 0], [1, 1], [2, 2]]}, "triangle: corners must not lie on one line"),
    (
        "tetrahedron",
        {"corners": [[0, 0, 0]]},
        "tetrahedron: corners must be 4 positions of 3 coordinates [m], got [[0, 0, 0]]",
    ),
    (
        "triangle",
        {"corners": [[0, 0], [1, 1], [2, "a"]]},
        "triangle: corner 3 must be 2 coordinates [m], got [2, 'a']",
    ),
]


@pytest.mark.parametrize("shape, parameters, message", WRONG)
def test_wrong_parameters_are_named(shape, parameters, message):
    with pytest.raises(MeshError) as error:
        generate(shape, **parameters)
    assert str(error.value) == message


def test_generating_prints_nothing(capfd):
    generate("torus")
    with pytest.raises(MeshError):
        generate("box", cell_size=-1)
    assert capfd.readouterr() == ("", "")
