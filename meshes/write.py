"""Meshes as files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from .data import MeshData, MeshError, choose
from .quality import EDGES
from .read import TETRA10
from .rows import number_rows

FORMATS = {".msh": "gmsh22", ".vtu": "vtu", ".xdmf": "xdmf"}


def write_mesh(data: MeshData, path: str | Path) -> None:
    """Write a mesh with its regions and tagged facets (not collective: on the calling rank).

    gmsh's .msh (format 2.2) keeps all names. VTU and XDMF keep the tags, as cell data "region" on elements
    and facets; a second-order XDMF file has no facets.

    Parameters
    ----------
    data : MeshData
        Any mesh.
    path : str or Path
        Ends in .msh, .vtu or .xdmf.

    Raises
    ------
    MeshError
        For another ending, or a place that cannot be written.
    """
    import meshio

    path = Path(path)
    suffix = path.suffix.lower()
    if suffix not in FORMATS:
        raise MeshError(f"{path}: unknown file type '{suffix}': {choose(suffix, FORMATS)}")
    d = data.dimension
    kinds = {(2, 1): ("triangle", "line"), (2, 2): ("triangle6", "line3")}
    kinds |= {(3, 1): ("tetra", "triangle"), (3, 2): ("tetra10", "triangle6")}
    kind, facet_kind = kinds[d, data.order]
    cells = [(kind, data.cells[:, TETRA10] if kind == "tetra10" else data.cells)]
    tags = [data.regions.astype(np.int32)]
    if len(data.facets) and (suffix, data.order) != (".xdmf", 2):  # meshio could not read such a mixture
        cells.append((facet_kind, _facet_nodes(data)))
        tags.append(data.facet_tags.astype(np.int32))
    points = np.hstack([data.points, np.zeros((len(data.points), 3 - d))])
    if suffix == ".msh":
        cell_data = {"gmsh:physical": tags, "gmsh:geometrical": tags}
        names = {name: np.array([tag, d - 1]) for name, tag in data.boundary_names.items()}
        names |= {name: np.array([tag, d]) for name, tag in data.region_names.items()}
        mesh = meshio.Mesh(points, cells, cell_data=cell_data, field_data=names)
        options = {"binary": False, "float_fmt": ".17g"}
    else:
        mesh = meshio.Mesh(points, cells, cell_data={"region": tags})
        options = {}
    try:
        meshio.write(path, mesh, file_format=FORMATS[suffix], **options)
    except OSError as error:
        raise MeshError(f"{path}: cannot be written ({error.strerror})") from None


def _facet_nodes(data: MeshData) -> NDArray[np.int64]:
    """Nodes of the tagged facets, with mid-edge nodes in second order."""
    if data.order == 1:
        return data.facets
    d = data.dimension
    ends = np.concatenate([data.cells[:, pair] for pair in EDGES[d]])
    middles = data.cells[:, d + 1 :].T.ravel()
    # The edges of a facet in the order of its mid-edge nodes, found among those of the cells.
    pairs = ((0, 1),) if d == 2 else EDGES[2]
    wanted = np.concatenate([data.facets[:, pair] for pair in pairs])
    number = number_rows(np.sort(np.concatenate([ends, wanted]), axis=1))
    middle_of = np.zeros(int(number.max()) + 1, dtype=np.int64)
    middle_of[number[: len(ends)]] = middles
    return np.hstack([data.facets, middle_of[number[len(ends) :]].reshape(len(pairs), -1).T])
