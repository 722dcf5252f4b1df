"""Triangle and tetrahedral meshes: gmsh generators, import of a user's mesh, distribution over ranks."""

from .boxes import box
from .data import MeshData, MeshError
from .domain import Domain, distribute
from .generate import SHAPES, generate

__all__ = ["SHAPES", "Domain", "MeshData", "MeshError", "box", "distribute", "generate"]
