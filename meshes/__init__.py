"""Triangle and tetrahedral meshes: gmsh generators, import of a user's mesh, distribution over ranks."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from .boxes import bar, box, mattress
from .check import check_mesh, repair
from .copies import Copies, copies
from .creature import creature
from .curved import cylinder, sphere, torus, tube
from .data import MeshData, MeshError
from .fish import fish
from .generate import SHAPES, boundary_names, generate
from .read import read_mesh
from .simplices import simplex, tetrahedron, triangle
from .write import write_mesh

if TYPE_CHECKING:
    from .domain import Domain, distribute

__all__ = [
    "SHAPES",
    "Copies",
    "Domain",
    "MeshData",
    "MeshError",
    "bar",
    "boundary_names",
    "box",
    "check_mesh",
    "copies",
    "creature",
    "cylinder",
    "distribute",
    "fish",
    "generate",
    "mattress",
    "read_mesh",
    "repair",
    "simplex",
    "sphere",
    "tetrahedron",
    "torus",
    "triangle",
    "tube",
    "write_mesh",
]


def __getattr__(name: str) -> Any:
    """`Domain` and `distribute` bring dolfinx with them, which naming and checking a mesh does not need."""
    if name in ("Domain", "distribute"):
        from . import domain

        return getattr(domain, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
