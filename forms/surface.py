"""The surface of a body, which every rank knows as a whole."""

from __future__ import annotations

from typing import Any

import dolfinx
import numpy as np
from numpy.typing import NDArray
from petsc4py import PETSc

from . import compat
from .space import Space

# a facet of second degree is cut at the nodes on its edges; corners first, then the edge opposite each
_CUTS = {2: ((0, 2), (2, 1)), 3: ((0, 5, 4), (1, 3, 5), (2, 4, 3), (3, 4, 5))}


class Surface:
    """Nodes of the surface and the segments (in the plane) or triangles between them, the same on every rank.

    Of second degree, facets are cut at their nodes: between nodes the surface is straight.

    Parameters
    ----------
    space : Space
    held : (n,) int
        Degrees of freedom with prescribed displacement.

    Attributes
    ----------
    nodes : (n,) int64
        Canonical numbers, ascending among those which can move and among the others.
    movable : int
        How many can move in some direction; they come first.
    facets : (m, d) int32
        Rows of `nodes`.
    rest : (n, d)
        Reference positions [m].
    dofs : (n * d,) int64
        Global degrees of freedom.
    free : (n * d,) bool
        Which of them have no prescribed displacement.
    """

    def __init__(self, space: Space, held: NDArray) -> None:
        self._space, self._comm, d = space, space.comm, space.dimension
        index_map = space.vectors.dofmap.index_map
        listed = np.concatenate(self._comm.allgather(space.nodes[_facets(space)]))
        numbers = np.unique(listed)
        mine = np.flatnonzero(np.isin(space.nodes[: index_map.size_local], numbers))
        free = space.free(held)[mine]
        first = index_map.local_range[0]
        told = self._comm.allgather((space.nodes[mine], space.positions[mine], first + mine, free))
        nodes, rest, rows, loose = (np.concatenate(part) for part in zip(*told))
        order = np.lexsort((nodes, ~loose.any(axis=1)))
        self.nodes, self.rest = nodes[order], np.asfortranarray(rest[order])
        self.movable = int(loose.any(axis=1).sum())
        self.dofs = (rows[order, None] * d + np.arange(d)).ravel()
        self.free = loose[order].ravel()
        place = np.empty(numbers.max(initial=-1) + 1, dtype=np.int32)
        place[self.nodes] = np.arange(len(self.nodes))
        facets = place[np.sort(listed, axis=1)]
        self.facets = np.asfortranarray(facets[np.lexsort(facets.T)])
        self._order, self._counts = order, [len(part[0]) * d for part in told]
        self._local = (mine[:, None] * d + np.arange(d)).ravel()
        start = sum(self._counts[: self._comm.rank])
        gathered = np.empty_like(order)
        gathered[order] = np.arange(len(order))
        own = gathered[start // d : start // d + len(mine)]
        self._own = (own[:, None] * d + np.arange(d)).ravel()

    def gather(self, values: NDArray) -> NDArray[np.float64]:
        """Local values (local nodes * d,) at the nodes of the surface, (n, d) on every rank (collective)."""
        out = np.empty(sum(self._counts))
        self._comm.Allgatherv(np.ascontiguousarray(values[self._local]), (out, self._counts))
        return np.asfortranarray(out.reshape(-1, self._space.dimension)[self._order])

    def add(self, values: NDArray, out: PETSc.Vec) -> None:
        """out += values (n * d,), the same on every rank, where this rank owns them."""
        out.array[self._local] += values[self._own]


def _facets(space: Space) -> NDArray[Any]:
    """Local nodes of each exterior facet of this rank, cut where they are of second degree, shape (m, d)."""
    mesh, d = space.mesh, space.dimension
    mesh.topology.create_connectivity(d - 1, d)
    mesh.topology.create_connectivity(d, d - 1)
    facets = np.asarray(dolfinx.mesh.exterior_facet_indices(mesh.topology))
    cells_of, facets_of = mesh.topology.connectivity(d - 1, d), mesh.topology.connectivity(d, d - 1)
    cells = np.array([cells_of.links(f)[0] for f in facets], dtype=np.int64)
    dofs = compat.cell_dofs(space.vectors, space.cells)[cells]
    listed = np.array([facets_of.links(c) for c in cells]).reshape(len(cells), d + 1)
    opposite = np.argmax(listed == facets[:, None], axis=1) if len(facets) else np.zeros(0, dtype=int)
    out = [np.zeros((0, d), dtype=np.int64)]
    for i in range(d + 1):
        corners = [k for k in range(d + 1) if k != i]
        here = dofs[opposite == i]
        if space.degree == 1:
            out.append(here[:, corners])
            continue
        edges = [tuple(sorted(edge)) for edge in compat.edges(d)]
        if d == 2:
            middles = [tuple(corners)]
        else:
            middles = [tuple(c for c in corners if c != apart) for apart in corners]
        nodes = here[:, corners + [d + 1 + edges.index(middle) for middle in middles]]
        out += [nodes[:, list(cut)] for cut in _CUTS[d]]
    return np.concatenate(out)
