"""Every unusable mesh is refused with one line that names the file, the place and what is accepted."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from extremal.meshes import MeshData, MeshError, check_mesh, generate, repair

CUBE = np.array([[x, y, z] for z in (0, 1) for y in (0, 1) for x in (0, 1)], dtype=float)
TETS = [[0, 1, 3, 7], [0, 3, 2, 7], [0, 2, 6, 7], [0, 6, 4, 7], [0, 4, 5, 7], [0, 5, 1, 7]]
SIDES = [
    [0, 2, 3],
    [0, 3, 1],
    [4, 5, 7],
    [4, 7, 6],
    [0, 1, 5],
    [0, 5, 4],
    [2, 6, 7],
    [2, 7, 3],
    [0, 4, 6],
    [0, 6, 2],
]
SIDES += [[1, 3, 7], [1, 7, 5]]


def mesh(
    points: Sequence | np.ndarray = CUBE,
    cells: Sequence | np.ndarray = TETS,
    facets: Sequence = (),
    tags: Sequence[int] = (),
    order: int = 1,
) -> MeshData:
    points = np.array(points, dtype=float)
    d = points.shape[1]
    return MeshData(
        points=points,
        cells=np.array(cells, dtype=np.int64),
        order=order,
        regions=np.ones(len(cells), dtype=np.int32),
        facets=np.array(facets, dtype=np.int64).reshape(-1, d),
        facet_tags=np.array(tags, dtype=np.int32),
        region_names={"body": 1},
        boundary_names={"a": 1, "b": 2},
    )


def moved(node: int, to: Sequence[float], points: np.ndarray = CUBE) -> np.ndarray:
    points = points.copy()
    points[node] = to
    return points


def test_a_good_mesh_has_no_notes():
    assert check_mesh(mesh(), "cube") == []


SQUARE = [[0, 0], [1, 0], [1, 1], [0, 1]]
FOLDED = generate("triangle", order=2)
FOLDED = replace(FOLDED, points=moved(3, [0.5, 0.8], FOLDED.points))

BAD = {
    "no elements": (
        mesh(cells=np.zeros((0, 4))),
        "the mesh has no elements",
    ),
    "node number too large": (
        mesh(cells=[[0, 1, 2, 8]]),
        "element 0 uses node 8, but nodes are numbered 0 to 7",
    ),
    "negative node number": (
        mesh(cells=[*TETS, [0, -1, 2, 3]]),
        "element 6 uses node -1, but nodes are numbered 0 to 7",
    ),
    "not a number": (
        mesh(moved(3, [1, np.nan, 0])),
        "node 3 has coordinates (1, nan, 0); finite numbers below 1e+50 are accepted",
    ),
    "infinite": (
        mesh(moved(3, [1, np.inf, 0])),
        "node 3 has coordinates (1, inf, 0); finite numbers below 1e+50 are accepted",
    ),
    "astronomical": (
        mesh(moved(3, [1, 1e60, 0])),
        "node 3 has coordinates (1, 1e+60, 0); finite numbers below 1e+50 are accepted",
    ),
    "node twice": (
        mesh(cells=[*TETS, [0, 1, 1, 7]]),
        "element 6 (nodes 0, 1, 1, 7) uses a node twice",
    ),
    "flat tetrahedron": (
        mesh(cells=[*TETS, [0, 1, 2, 3]]),
        "element 6 (nodes 0, 1, 2, 3) at (0.5, 0.5, 0) has no volume",
    ),
    "flat, small and far away": (
        mesh(np.vstack([CUBE, 100 + 1e-6 * CUBE]), [*TETS, [8, 9, 10, 11], [8, 9, 10, 11]]),
        "element 6 (nodes 8, 9, 10, 11) at (100, 100, 100) has no volume (and 1 more)",
    ),
    "flat triangle": (
        mesh([*SQUARE, [2, 0]], [[0, 1, 2], [0, 1, 4]]),
        "element 1 (nodes 0, 1, 4) at (1, 0) has no area",
    ),
    "coinciding nodes": (
        mesh(np.vstack([CUBE, CUBE[7:]]), [*TETS[:5], [0, 5, 1, 8]]),
        "nodes 7 and 8 coincide at (1, 1, 1); merge them (in gmsh: Coherence Mesh), "
        "or the body comes apart there",
    ),
    "element twice": (
        mesh(cells=[*TETS, [3, 1, 0, 7]]),
        "elements 0 and 6 have the same nodes 0, 1, 3, 7; remove one of them",
    ),
    "three elements at a facet": (
        mesh(np.vstack([CUBE, [[0.5, 0.2, 3]]]), [*TETS, [0, 3, 7, 8]]),
        "facet (nodes 0, 3, 7) at (0.666667, 0.666667, 0.333333) is shared by the elements 0, 1, 6; "
        "at most 2 can meet at a facet",
    ),
    "overlapping elements": (
        mesh([[0, 0], [1, 0], [0, 1], [0.3, 2]], [[0, 1, 2], [0, 1, 3]]),
        "elements 0 and 1 overlap: they lie on the same side of their common facet (nodes 0, 1)",
    ),
    "facet in two boundaries": (
        mesh(facets=[SIDES[0], SIDES[1], SIDES[0][::-1]], tags=[1, 1, 2]),
        "facet (nodes 0, 2, 3) is in two boundaries, 'a' and 'b'; one is accepted "
        "(unions are written as lists of names, and 'surface' is the whole boundary)",
    ),
    "folded second-order element": (
        FOLDED,
        "second-order element 0 near (0.5, 0.422008) is folded by its curved sides; "
        "use smaller elements or first order",
    ),
}


@pytest.mark.parametrize("case", BAD)
def test_unusable_meshes_are_refused(case):
    data, message = BAD[case]
    with pytest.raises(MeshError) as error:
        repair(data, "mesh")
    assert str(error.value) == f"mesh: {message}"


def test_thin_elements_are_accepted():
    assert check_mesh(mesh(CUBE * [1, 1, 1e-6]), "slab") == []


REPAIRED = {
    "negative orientation": (
        mesh(cells=[[1, 0, 3, 7], *TETS[1:5], [0, 5, 7, 1]]),
        ["2 negatively oriented elements re-oriented"],
    ),
    "unused node": (
        mesh(np.vstack([[[9, 9, 9]], CUBE]), np.array(TETS) + 1),
        ["1 node removed that no element uses"],
    ),
    "strange facet": (
        mesh(facets=[SIDES[0], [0, 1, 6]], tags=[1, 2]),
        ["1 boundary facet removed that belong to no element"],
    ),
    "facet given twice": (mesh(facets=[SIDES[0], SIDES[0]], tags=[1, 1]), []),
    "two pieces": (
        mesh(np.vstack([CUBE, CUBE + 3]), np.vstack([TETS, np.array(TETS) + 8])),
        ["the mesh has 2 separate pieces"],
    ),
}


@pytest.mark.parametrize("case", REPAIRED)
def test_what_can_be_put_right_is_put_right_and_noted(case):
    data, notes = REPAIRED[case]
    good = repair(data, "mesh")
    assert list(good.notes) == notes == check_mesh(data, "mesh")
    assert good.volumes().min() > 0
    assert good.volumes().sum() == pytest.approx(np.abs(data.volumes()).sum())
    assert good.cells.max() == len(good.points) - 1
    assert len(good.facets) == len(good.facet_tags) <= 1
    assert check_mesh(good, "mesh") == [note for note in notes if "pieces" in note]


@pytest.mark.parametrize("dimension", [2, 3])
def test_negative_second_order_elements_keep_their_curved_sides(dimension):
    data = generate("sphere", dimension=dimension, order=2, cell_size=0.5)
    d = dimension
    swap = [1, 0, 2, 3, 5, 4] if d == 2 else [1, 0, 2, 3, 4, 6, 5, 9, 8, 7]
    mirrored = replace(data, cells=data.cells[:, swap])
    assert mirrored.volumes().max() < 0
    good = repair(mirrored, "sphere")
    assert good.volumes() == pytest.approx(data.volumes())
    assert good.notes == (f"{len(data.cells)} negatively oriented elements re-oriented",)
