"""What differs between versions of dolfinx (0.5, 0.9), gmsh and meshio, or needs care, in one place."""

from __future__ import annotations

import contextlib
import inspect
import io
import logging
import re
import tempfile
import warnings
from pathlib import Path
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


def gmsh_arguments(initialize: Any) -> dict[str, Any]:
    """Arguments of `gmsh.initialize`: no configuration files; no signal handler where there is a choice."""
    accepted = inspect.signature(initialize).parameters
    wanted = {"readConfigFiles": False, "interruptible": False}
    return {name: value for name, value in wanted.items() if name in accepted}


def meshio_formats() -> dict[str, list[str]]:
    """Formats that meshio knows for each file extension."""
    import meshio

    return dict(meshio.extension_to_filetypes)


def meshio_read(path: Path, file_format: str) -> Any:
    """`meshio.read` with exceptions only: it prints its errors and ends the process.

    Raises
    ------
    ValueError
        With what meshio had to say, on one line.
    """
    import meshio
    from meshio.gmsh import _gmsh41

    def entities(*arguments: Any) -> Any:
        # Entities outside all physical groups get the tag 0, as in format 2.2; otherwise meshio fails where
        # only some entities are in a group.
        physical, bounding = read_entities(*arguments)
        return tuple({tag: found or [0] for tag, found in of.items()} for of in physical), bounding

    said = io.StringIO()
    read_entities = _gmsh41._read_entities
    try:
        if file_format == "vtu":
            # What is new in 2.x of the format does not concern simplices, but meshio knows 1.0 at most.
            with path.open("rb") as file:
                newer = re.search(rb'<VTKFile[^>]*\sversion="2\.\d"', file.read(2000))
            if newer:
                return _read_as_version_1(path)
        _gmsh41._read_entities = entities
        with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return meshio.read(path, file_format=file_format)
    except (Exception, SystemExit) as error:
        # Before it ends the process meshio prints why; its last line only repeats the name of the file.
        reason = str(error)
        if isinstance(error, SystemExit):
            reason = said.getvalue().partition("Error:")[0].strip() or "not a file of this kind"
        raise ValueError(" ".join(reason.split()) or type(error).__name__) from None
    finally:
        _gmsh41._read_entities = read_entities


def _read_as_version_1(path: Path) -> Any:
    import meshio

    content = path.read_bytes()
    head = re.sub(rb'(<VTKFile[^>]*\sversion=")2\.\d(")', rb"\g<1>1.0\g<2>", content[:2000])
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / "mesh.vtu"
        copy.write_bytes(head + content[2000:])
        return meshio.read(copy, file_format="vtu")
