"""The differences between dolfinx 0.5 and 0.9 that meshes meets, all in one place."""

from __future__ import annotations

import inspect
import logging
from typing import Any

import dolfinx.cpp
import dolfinx.log
import dolfinx.mesh
import numpy as np
import ufl
from mpi4py import MPI
from numpy.typing import NDArray

_CELL = {2: "triangle", 3: "tetrahedron"}


def quiet() -> None:
    """Warnings only from dolfinx and its form compiler."""
    dolfinx.log.set_log_level(dolfinx.log.LogLevel.WARNING)
    for name in ("FFC", "FFCX", "ffcx", "UFL", "UFL_LEGACY"):
        logging.getLogger(name).setLevel(logging.WARNING)
    for handler in logging.getLogger().handlers:
        # Importing ffcx installs a handler that prints anything; compiling a form would print each command.
        if type(handler) is logging.StreamHandler and handler.level == logging.NOTSET:
            handler.setLevel(logging.WARNING)


def coordinate_domain(dimension: int, order: int) -> ufl.Mesh:
    """UFL mesh of simplices of the given order."""
    try:
        import basix.ufl

        element = basix.ufl.element("Lagrange", _CELL[dimension], order, shape=(dimension,))
    except (ImportError, AttributeError, TypeError):
        cell = ufl.Cell(_CELL[dimension], geometric_dimension=dimension)
        element = ufl.VectorElement(ufl.FiniteElement("Lagrange", cell, order, variant="equispaced"))
    return ufl.Mesh(element)


def permutation_from_gmsh(dimension: int, nodes: int) -> NDArray[np.int64]:
    """p such that nodes of a dolfinx cell = nodes of the gmsh cell[p]."""
    cell = dolfinx.mesh.CellType.triangle if dimension == 2 else dolfinx.mesh.CellType.tetrahedron
    return np.asarray(dolfinx.cpp.io.perm_gmsh(cell, nodes), dtype=np.int64)


def create_mesh(
    comm: MPI.Intracomm, cells: NDArray[np.int64], points: NDArray[np.float64], domain: ufl.Mesh
) -> dolfinx.mesh.Mesh:
    """Distributed mesh without ghost cells: every local cell is owned by its rank."""
    none = dolfinx.mesh.GhostMode.none
    accepted = inspect.signature(dolfinx.mesh.create_mesh).parameters
    if "ghost_mode" in accepted:
        return dolfinx.mesh.create_mesh(comm, cells, points, domain, ghost_mode=none)
    arguments: dict[str, Any] = {"partitioner": dolfinx.mesh.create_cell_partitioner(none)}
    # The order of points and element was exchanged after 0.9: give them by name.
    arguments["e" if "e" in accepted else "domain"] = domain
    return dolfinx.mesh.create_mesh(comm, cells=cells, x=points, **arguments)


def geometry_dofmap(mesh: dolfinx.mesh.Mesh, nodes: int) -> NDArray[np.int64]:
    """Geometry nodes of each local cell, shape (cells, nodes)."""
    dofmap = mesh.geometry.dofmap
    return np.asarray(getattr(dofmap, "array", dofmap), dtype=np.int64).reshape(-1, nodes)


def original_cells(mesh: dolfinx.mesh.Mesh) -> NDArray[np.int64]:
    """Index of each local cell in the array given to `create_mesh`, shape (cells,)."""
    return np.asarray(mesh.topology.original_cell_index, dtype=np.int64)
