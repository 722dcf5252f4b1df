"""From the arrays on rank 0 to a distributed dolfinx mesh with named regions and boundaries."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import dolfinx.mesh
import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

from . import compat
from .data import MeshData, MeshError, choose
from .rows import number_rows

SURFACE = "surface"


@dataclass(frozen=True)
class Domain:
    """A distributed mesh whose regions and boundaries have names.

    Attributes
    ----------
    mesh : dolfinx.mesh.Mesh
        No ghost cells; `mesh.geometry.input_global_indices` is each geometry node's row in `data.points`.
    regions : MeshTags
        Region of every local cell.
    region_names, boundary_names : dict of str to int
        Tag of each name, the same on all ranks.
    boundaries : MeshTags
        Tag of every local facet that has one.
    data : MeshData or None
        On rank 0 the mesh as it was given; None elsewhere.
    original_cells : NDArray of int64, shape (local cells,)
        Row of each local cell in `data.cells`.
    """

    mesh: dolfinx.mesh.Mesh
    regions: Any
    region_names: dict[str, int]
    boundaries: Any
    boundary_names: dict[str, int]
    data: MeshData | None
    original_cells: NDArray[np.int64]

    def facets(self, names: str | Sequence[str]) -> NDArray[np.int32]:
        """Local facets of one boundary or of the union of several; "surface" is every exterior facet.

        Parameters
        ----------
        names : str or sequence of str
            Names of `boundary_names`, or "surface".

        Returns
        -------
        NDArray of int32, shape (local facets found,)
            Sorted indices, local to this rank.

        Raises
        ------
        MeshError
            For a name that this mesh does not have.
        """
        found = [np.zeros(0, dtype=np.int32)]
        for name in [names] if isinstance(names, str) else names:
            if name in self.boundary_names:
                found.append(self.boundaries.find(self.boundary_names[name]))
            elif name == SURFACE:
                found.append(np.asarray(dolfinx.mesh.exterior_facet_indices(self.mesh.topology)))
            else:
                accepted = [*self.boundary_names, SURFACE]
                raise MeshError(f"unknown boundary '{name}': {choose(name, accepted)}")
        return np.unique(np.concatenate(found)).astype(np.int32)

    def cells(self, names: str | Sequence[str]) -> NDArray[np.int32]:
        """Local cells of one region or of the union of several, sorted, shape (local cells found,).

        Raises
        ------
        MeshError
            For a name that this mesh does not have.
        """
        found = [np.zeros(0, dtype=np.int32)]
        for name in [names] if isinstance(names, str) else names:
            if name not in self.region_names:
                raise MeshError(f"unknown region '{name}': {choose(name, self.region_names)}")
            found.append(self.regions.find(self.region_names[name]))
        return np.unique(np.concatenate(found)).astype(np.int32)


def distribute(comm: MPI.Intracomm, data: MeshData | None) -> Domain:
    """Partition a mesh over the ranks of a communicator (collective).

    Parameters
    ----------
    comm : MPI.Intracomm
        All its ranks take part; a rank may end up without cells.
    data : MeshData or None
        The mesh, on rank 0; ignored elsewhere.

    Returns
    -------
    Domain
        With the same names and tags on any number of ranks.

    Raises
    ------
    MeshError
        On all ranks, where rank 0 gave no mesh.
    """
    compat.quiet()
    if comm.rank != 0:
        data = None
    header = None
    if data is not None:
        header = (data.dimension, data.order, data.cells.shape[1], data.region_names, data.boundary_names)
    header = comm.bcast(header)
    if header is None:
        raise MeshError("there is no mesh on rank 0 to distribute")
    d, order, nodes, region_names, boundary_names = header

    cells, points = np.zeros((0, nodes), dtype=np.int64), np.zeros((0, d))
    if data is not None:
        cells = np.ascontiguousarray(data.cells[:, compat.permutation_from_gmsh(d, nodes)])
        points = np.ascontiguousarray(data.points)
    mesh = compat.create_mesh(comm, cells, points, compat.coordinate_domain(d, order))
    mesh.topology.create_connectivity(d, d - 1)
    mesh.topology.create_connectivity(d - 1, d)
    mesh.topology.create_connectivity(d - 1, 0)

    original = compat.original_cells(mesh)
    local = np.arange(len(original), dtype=np.int32)
    region_of = comm.bcast(None if data is None else data.regions.astype(np.int32))
    regions = dolfinx.mesh.meshtags(mesh, d, local, region_of[original])

    tagged = comm.bcast(None if data is None else (data.facets, data.facet_tags))
    indices, values = _match(_facet_nodes(mesh, d, nodes), *tagged)
    boundaries = dolfinx.mesh.meshtags(mesh, d - 1, indices, values)
    return Domain(mesh, regions, dict(region_names), boundaries, dict(boundary_names), data, original)


def _facet_nodes(mesh: dolfinx.mesh.Mesh, d: int, nodes: int) -> NDArray[np.int64]:
    """Rows of `data.points` at the corners of every local facet, sorted, shape (facets, d)."""
    given = np.asarray(mesh.geometry.input_global_indices, dtype=np.int64)
    corners = given[compat.geometry_dofmap(mesh, nodes)[:, : d + 1]]
    facets_of = mesh.topology.connectivity(d, d - 1).array.reshape(-1, d + 1)
    count = mesh.topology.index_map(d - 1)
    found = np.zeros((count.size_local + count.num_ghosts, d), dtype=np.int64)
    for opposite in range(d + 1):  # facet i of a simplex is the one opposite corner i
        found[facets_of[:, opposite]] = np.delete(corners, opposite, axis=1)
    return np.sort(found, axis=1)


def _match(
    local: NDArray[np.int64], facets: NDArray[np.int64], tags: NDArray[np.int32]
) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Indices of the local facets that are among the tagged ones, and their tags."""
    number = number_rows(np.vstack([np.sort(facets, axis=1), local]))
    tag_of = np.full(number.max(initial=-1) + 1, -1, dtype=np.int64)
    tag_of[number[: len(facets)]] = tags
    found = tag_of[number[len(facets) :]]
    indices = np.flatnonzero(found >= 0).astype(np.int32)
    return indices, found[indices].astype(np.int32)
