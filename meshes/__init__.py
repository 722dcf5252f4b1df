"""Triangle and tetrahedral meshes: gmsh generators, import of a user's mesh, distribution over ranks."""

from .boxes import bar, box, mattress
from .creature import creature
from .curved import cylinder, sphere, torus, tube
from .data import MeshData, MeshError
from .domain import Domain, distribute
from .generate import SHAPES, generate
from .simplices import simplex, tetrahedron, triangle

__all__ = [
    "SHAPES",
    "Domain",
    "MeshData",
    "MeshError",
    "bar",
    "box",
    "creature",
    "cylinder",
    "distribute",
    "generate",
    "mattress",
    "simplex",
    "sphere",
    "tetrahedron",
    "torus",
    "triangle",
    "tube",
]
