"""Whether a mesh can be computed with: what can be put right is; the rest is an error that names a place."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from .data import MeshData, MeshError
from .gmsh_model import FLIP, check_curved
from .quality import cell_volumes
from .rows import number_rows

# An element is flat when d! x volume is below this part of (longest edge)^d: the noise of its coordinates.
FLAT = 1e-10
# Nodes coincide when they are closer than this part of the mesh's extent.
COINCIDENT = 1e-12
# Beyond this [m] volumes leave the range of numbers.
LARGEST_COORDINATE = 1e50


def check_mesh(data: MeshData, name: str) -> list[str]:
    """Notes on what `repair` would change or found worth knowing; the same errors."""
    return list(repair(replace(data, notes=()), name).notes)


def repair(data: MeshData, name: str) -> MeshData:
    """Check a mesh and put right what can be.

    Put right, with a note: negatively oriented elements, nodes that no element uses, tagged facets that
    belong to no element. Noted: several separate pieces, several regions.

    Parameters
    ----------
    data : MeshData
        The mesh as it came.
    name : str
        What messages begin with, usually the file.

    Returns
    -------
    MeshData
        Fit for `distribute`, with its notes.

    Raises
    ------
    MeshError
        For no elements, nodes out of range or not finite, elements that use a node twice, have no volume or
        are folded, coinciding nodes, duplicate or overlapping elements, facets of more than two elements or
        in two boundaries. Elements and nodes are numbered from 0, in the order of the file.
    """
    _check_indices(data, name)
    _check_flat(data, name)
    notes = []
    negative = cell_volumes(data.points, data.corners, 1) < 0
    if negative.any():
        cells = data.cells.copy()
        cells[negative] = cells[negative][:, FLIP[data.dimension, data.order]]
        data = replace(data, cells=cells)
        notes.append(_counted(int(negative.sum()), "negatively oriented element", "re-oriented"))
    _check_distinct(data, name)
    check_curved(data, name)
    data, strange = _with_own_facets(data, name, _check_facets(data, name))
    # Last, so that messages count nodes as the file does.
    data, unused = _without_unused_nodes(data)
    notes += strange + unused
    pieces = _pieces(data)
    if pieces > 1:
        notes.append(f"the mesh has {pieces} separate pieces")
    if len(data.region_names) > 1:
        notes.append("the mesh has the regions " + ", ".join(data.region_names))
    return replace(data, notes=(*data.notes, *notes))


def _counted(count: int, noun: str, what: str) -> str:
    return f"{count} {noun}{'' if count == 1 else 's'} {what}"


def _more(count: int) -> str:
    return f" (and {count - 1} more)" if count > 1 else ""


def _at(points: NDArray[np.float64], nodes: Sequence[int] | NDArray[np.int64]) -> str:
    """Position of some nodes' centre."""
    return "(" + ", ".join(f"{x:.6g}" for x in points[nodes].mean(axis=0)) + ")"


def _list(nodes: Sequence[int] | NDArray[np.int64]) -> str:
    return ", ".join(str(int(node)) for node in nodes)


def _check_indices(data: MeshData, name: str) -> None:
    """Elements exist, refer to existing nodes, each once; coordinates are numbers."""
    cells = data.cells
    if len(cells) == 0:
        raise MeshError(f"{name}: the mesh has no elements")
    check_nodes(data.points, cells, name, "element")
    ordered = np.sort(cells, axis=1)
    twice = np.flatnonzero((ordered[:, 1:] == ordered[:, :-1]).any(axis=1))
    if len(twice):
        raise MeshError(
            f"{name}: element {twice[0]} (nodes {_list(cells[twice[0]])}) uses a node twice"
            f"{_more(len(twice))}"
        )


def check_nodes(points: NDArray[np.float64], cells: NDArray[np.int64], name: str, noun: str) -> None:
    """Cells (triangles, ... by the noun) refer to nodes that exist, and these have usable coordinates.

    Raises
    ------
    MeshError
        Naming the first cell or node for which this is not so.
    """
    n = len(points)
    outside = np.flatnonzero(((cells < 0) | (cells >= n)).any(axis=1))
    if len(outside):
        cell = cells[outside[0]]
        node = cell[(cell < 0) | (cell >= n)][0]
        raise MeshError(f"{name}: {noun} {outside[0]} uses node {node}, but nodes are numbered 0 to {n - 1}")
    used = np.unique(cells)
    wrong = used[~(np.abs(points[used]) < LARGEST_COORDINATE).all(axis=1)]
    if len(wrong):
        values = ", ".join(f"{x:g}" for x in points[wrong[0]])
        raise MeshError(
            f"{name}: node {wrong[0]} has coordinates ({values}){_more(len(wrong))}; "
            f"finite numbers below {LARGEST_COORDINATE:g} are accepted"
        )


def _without_unused_nodes(data: MeshData) -> tuple[MeshData, list[str]]:
    used = np.zeros(len(data.points), dtype=bool)
    used[data.cells] = True
    unused = int((~used).sum())
    if unused == 0:
        return data, []
    number = np.cumsum(used) - 1
    data = replace(data, points=data.points[used], cells=number[data.cells], facets=number[data.facets])
    return data, [_counted(unused, "node", "removed that no element uses")]


def _check_flat(data: MeshData, name: str) -> None:
    d, corners = data.dimension, data.points[data.corners]
    i, j = np.triu_indices(d + 1, 1)
    longest = np.linalg.norm(corners[:, i] - corners[:, j], axis=2).max(axis=1)
    volumes = np.abs(cell_volumes(data.points, data.corners, 1))
    flat = np.flatnonzero(volumes * math.factorial(d) <= FLAT * longest**d)
    if len(flat):
        nodes = data.corners[flat[0]]
        raise MeshError(
            f"{name}: element {flat[0]} (nodes {_list(nodes)}) at {_at(data.points, nodes)} has no "
            f"{'area' if d == 2 else 'volume'}{_more(len(flat))}"
        )


def _check_distinct(data: MeshData, name: str) -> None:
    """No two nodes in one place, no two elements with the same corners."""
    used = np.unique(data.cells)
    extent = float(np.ptp(data.points[used], axis=0).max())
    pairs = used[cKDTree(data.points[used]).query_pairs(COINCIDENT * extent, output_type="ndarray")]
    if len(pairs):
        a, b = pairs[np.lexsort((pairs.max(axis=1), pairs.min(axis=1)))[0]]
        raise MeshError(
            f"{name}: nodes {min(a, b)} and {max(a, b)} coincide at {_at(data.points, [a])}"
            f"{_more(len(pairs))}; merge them (in gmsh: Coherence Mesh), or the body comes apart there"
        )
    number = number_rows(np.sort(data.corners, axis=1))
    order = np.argsort(number, kind="stable")
    same = np.flatnonzero(number[order][1:] == number[order][:-1])
    if len(same):
        a, b = order[same[0]], order[same[0] + 1]
        raise MeshError(
            f"{name}: elements {a} and {b} have the same nodes {_list(data.corners[a])}{_more(len(same))}; "
            "remove one of them"
        )


def _check_facets(data: MeshData, name: str) -> NDArray[np.int64]:
    """Facets belong to one or two elements, which lie on different sides.

    Returns
    -------
    NDArray, shape (m (d + 1), d)
        Sorted nodes of all elements' facets.
    """
    d, m = data.dimension, len(data.cells)
    facets = np.concatenate([np.delete(data.corners, i, axis=1) for i in range(d + 1)])
    number = number_rows(np.sort(facets, axis=1))
    count = np.bincount(number)
    if count.max() > 2:
        worst = int(np.flatnonzero(count > 2)[0])
        there = np.flatnonzero(number == worst)
        nodes = np.sort(facets[there[0]])
        raise MeshError(
            f"{name}: facet (nodes {_list(nodes)}) at {_at(data.points, nodes)} is shared by the elements "
            f"{_list(np.sort(there % m))}; at most 2 can meet at a facet{_more(int((count > 2).sum()))}"
        )
    # Seen from well-oriented elements on its two sides a facet turns opposite ways.
    sign = _parity(facets) * np.repeat([(-1) ** i for i in range(d + 1)], m)
    total = np.bincount(number, weights=sign)
    overlapping = np.flatnonzero(np.abs(total) > 1)
    if len(overlapping):
        there = np.flatnonzero(number == overlapping[0])
        a, b = np.sort(there % m)
        raise MeshError(
            f"{name}: elements {a} and {b} overlap: they lie on the same side of their common facet "
            f"(nodes {_list(np.sort(facets[there[0]]))}){_more(len(overlapping))}"
        )
    return np.sort(facets, axis=1)


def _parity(rows: NDArray[np.int64]) -> NDArray[np.int64]:
    """Sign of the permutation that sorts each row."""
    i, j = np.triu_indices(rows.shape[1], 1)
    return 1 - 2 * ((rows[:, i] > rows[:, j]).sum(axis=1) % 2)


def _with_own_facets(data: MeshData, name: str, facets: NDArray[np.int64]) -> tuple[MeshData, list[str]]:
    """Tagged facets, each once, with one tag, and a facet of an element."""
    if len(data.facets) == 0:
        return data, []
    tagged = np.sort(data.facets, axis=1)
    number = number_rows(np.vstack([tagged, facets]))
    own = np.isin(number[: len(tagged)], number[len(tagged) :])
    names = {tag: n for n, tag in data.boundary_names.items()}
    _, first, inverse = np.unique(number[: len(tagged)], return_index=True, return_inverse=True)
    differs = np.flatnonzero(data.facet_tags != data.facet_tags[first][inverse.reshape(-1)])
    if len(differs):
        k = differs[0]
        other = data.facet_tags[first][inverse.reshape(-1)[k]]
        raise MeshError(
            f"{name}: facet (nodes {_list(tagged[k])}) is in two boundaries, '{names[int(other)]}' and "
            f"'{names[int(data.facet_tags[k])]}'; one is accepted (unions are written as lists of names, and "
            "'surface' is the whole boundary)"
        )
    kept = np.zeros(len(tagged), dtype=bool)
    kept[first] = True
    kept &= own
    strange = int((~own).sum())
    notes = [_counted(strange, "boundary facet", "removed that belong to no element")] if strange else []
    return replace(data, facets=data.facets[kept], facet_tags=data.facet_tags[kept]), notes


def _pieces(data: MeshData) -> int:
    """Number of pieces that share no node."""
    n, m = len(data.points), len(data.cells)
    k = data.corners.shape[1]
    graph = coo_array(
        (np.ones(m * (k - 1)), (np.repeat(data.corners[:, 0], k - 1), data.corners[:, 1:].ravel())),
        shape=(n, n),
    )
    labels = connected_components(graph, directed=False)[1]
    return len(np.unique(labels[data.corners[:, 0]]))
