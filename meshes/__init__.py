"""Triangle and tetrahedral meshes: gmsh generators, import of a user's mesh, distribution over ranks."""

from .boxes import bar, box, mattress
from .check import check_mesh, repair
from .creature import creature
from .curved import cylinder, sphere, torus, tube
from .data import MeshData, MeshError
from .domain import Domain, distribute
from .generate import SHAPES, generate
from .read import read_mesh
from .simplices import simplex, tetrahedron, triangle
from .write import write_mesh

__all__ = [
    "SHAPES",
    "Domain",
    "MeshData",
    "MeshError",
    "bar",
    "box",
    "check_mesh",
    "creature",
    "cylinder",
    "distribute",
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
