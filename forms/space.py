"""The displacement's space, its quadrature points and its rank-independent numbering of nodes."""

from __future__ import annotations

from typing import Any

import numpy as np
import ufl
from dolfinx import fem
from numpy.typing import NDArray

from extremal.meshes import Domain

from . import compat

# meshio's (VTK's) order of the nodes in the middle of edges
_VTK_EDGES = {2: ((0, 1), (1, 2), (2, 0)), 3: ((0, 1), (1, 2), (0, 2), (0, 3), (1, 3), (2, 3))}
_CELL_NAMES = {(2, 1): "triangle", (3, 1): "tetra", (2, 2): "triangle6", (3, 2): "tetra10"}


class Space:
    """Continuous displacements of degree 1 or 2 on a domain.

    Nodes have a canonical order, the same on any number of ranks: corners in the order of the mesh as it was given,
    then for degree 2 the edges sorted by their corners. Points are the quadrature points of this rank's cells.

    Attributes
    ----------
    u : dolfinx.fem.Function
        Displacement [m], shape (d,).
    nodes : (local nodes,) int64
        Canonical number of each local node, ghosts included.
    positions : (local nodes, d)
        Reference positions [m].
    point_cells : (points,) int64
        Local cell of each point.
    """

    def __init__(self, domain: Domain, degree: int) -> None:
        self.domain, self.mesh, self.degree = domain, domain.mesh, degree
        self.comm = domain.mesh.comm
        self.dimension = d = domain.mesh.topology.dim
        self.vectors = compat.lagrange(self.mesh, degree, d)
        self.u = fem.Function(self.vectors)
        self.cells = len(domain.original_cells)
        curved = compat.cell_nodes(self.mesh, self.cells).shape[1] > d + 1
        # P1 on straight cells has constant gradients: one point; P2 needs degree 2, curved cells some more
        self.quadrature_degree = 4 if curved else (0 if degree == 1 else 2)
        self.dx = ufl.dx(
            domain=self.mesh,
            metadata={"quadrature_degree": self.quadrature_degree, "quadrature_scheme": "default"},
        )
        points, _ = compat.rule(d, self.quadrature_degree)
        self.per_cell = len(points)
        self._gradient = compat.expression(ufl.grad(self.u), points)
        self._all_cells = np.arange(self.cells, dtype=np.int32)
        scalars = self.function_at_points()
        self.point_of = compat.cell_dofs(scalars.function_space, self.cells)
        self.point_cells = np.empty(self.point_of.size, dtype=np.int64)
        self.point_cells[self.point_of] = np.arange(self.cells)[:, None]
        self.positions = self.vectors.tabulate_dof_coordinates()[:, :d].copy()
        self._number_nodes()

    def function_at_points(self, shape: tuple[int, ...] = ()) -> fem.Function:
        """A function of tensors at the quadrature points; `.x.array` lists them point by point."""
        return fem.Function(compat.quadrature(self.mesh, self.quadrature_degree, shape))

    def gradient(self, out: NDArray) -> None:
        """Displacement gradient at every point, written to `out` (points, d*d), in the order of the points."""
        values = compat.evaluate(self._gradient, self.mesh, self._all_cells)
        out[self.point_of.ravel()] = values.reshape(-1, self.dimension**2)

    def weights(self) -> NDArray:
        """Reference volume of each point [m^d], shape (points,)."""
        size = ufl.JacobianDeterminant(self.mesh)
        points, weights = compat.rule(self.dimension, self.quadrature_degree)
        values = compat.evaluate(compat.expression(abs(size), points), self.mesh, self._all_cells)
        out = np.empty(self.point_of.size)
        out[self.point_of] = values.reshape(self.cells, self.per_cell) * weights
        return out

    def midpoints(self) -> NDArray:
        """Centre of gravity of the corners of each cell [m], shape (cells, 3)."""
        corners = compat.cell_nodes(self.mesh, self.cells)[:, : self.dimension + 1]
        return self.mesh.geometry.x[corners].mean(axis=1)

    # ------------------------------------------------------------------ canonical order

    def _number_nodes(self) -> None:
        d, given = self.dimension, np.asarray(self.mesh.geometry.input_global_indices, dtype=np.int64)
        corners = given[compat.cell_nodes(self.mesh, self.cells)[:, : d + 1]]
        dofs = compat.cell_dofs(self.vectors, self.cells)
        self._corner_numbers = self._union(corners.ravel())
        self.nodes = np.empty(len(self.positions), dtype=np.int64)
        self.nodes[dofs[:, : d + 1]] = np.searchsorted(self._corner_numbers, corners)
        self.node_count = len(self._corner_numbers)
        self._edge_keys = np.zeros(0, dtype=np.int64)
        if self.degree == 2:
            keys = np.stack([self._edge_key(corners, pair) for pair in compat.edges(d)], axis=1)
            self._edge_keys = self._union(keys.ravel())
            self.nodes[dofs[:, d + 1 :]] = self.node_count + np.searchsorted(self._edge_keys, keys)
            self.node_count += len(self._edge_keys)

    def _union(self, numbers: NDArray) -> NDArray:
        parts = self.comm.gather(np.unique(numbers))
        return self.comm.bcast(None if parts is None else np.unique(np.concatenate(parts)))

    @staticmethod
    def _edge_key(corners: NDArray, pair: Any) -> NDArray:
        a, b = corners[:, pair[0]], corners[:, pair[1]]
        return np.minimum(a, b) * (1 << 31) + np.maximum(a, b)

    def free(self, held: NDArray) -> NDArray:
        """Which components of the local nodes are none of the degrees of freedom `held`, (local nodes, d) bool."""
        out = np.ones(len(self.positions) * self.dimension, dtype=bool)
        out[held] = False
        return out.reshape(-1, self.dimension)

    def gather_nodes(self, function: fem.Function) -> NDArray | None:
        """Values at the nodes in canonical order, shape (nodes, components), on rank 0; None elsewhere."""
        block = function.function_space.dofmap.index_map_bs
        owned = function.function_space.dofmap.index_map.size_local
        values = function.x.array.reshape(-1, block)[:owned]
        return self._gather(self.nodes[:owned], values, self.node_count)

    def gather_cells(self, values: NDArray) -> NDArray | None:
        """Values of the cells in the order of the mesh as given, on rank 0; None elsewhere."""
        total = self.comm.allreduce(self.cells)
        return self._gather(self.domain.original_cells, values, total)

    def _gather(self, rows: NDArray, values: NDArray, total: int) -> NDArray | None:
        parts = self.comm.gather((rows, values))
        if parts is None:
            return None
        out = np.empty((total, *values.shape[1:]), dtype=values.dtype)
        for row, value in parts:
            out[row] = value
        return out

    def scatter_nodes(self, values: NDArray | None, function: fem.Function) -> None:
        """Set `function` from rank 0's canonical values (nodes, components)."""
        everywhere = self.comm.bcast(values)
        function.x.array[:] = everywhere[self.nodes].ravel()

    def geometry(self) -> tuple[NDArray, NDArray, str] | None:
        """Reference points (n, 3) [m], cells and meshio's name for them, on rank 0; None elsewhere."""
        d = self.dimension
        owned = self.vectors.dofmap.index_map.size_local
        flat = self._gather(self.nodes[:owned], self.positions[:owned], self.node_count)
        if flat is None:
            return None
        points = np.zeros((self.node_count, 3))
        points[:, :d] = flat
        assert self.domain.data is not None
        corners = self.domain.data.cells[:, : d + 1]
        cells = np.searchsorted(self._corner_numbers, corners)
        if self.degree == 2:
            middle = [self._edge_key(corners, pair) for pair in _VTK_EDGES[d]]
            edges = len(self._corner_numbers) + np.searchsorted(self._edge_keys, np.stack(middle, axis=1))
            cells = np.hstack([cells, edges])
        return points, cells, _CELL_NAMES[d, self.degree]
