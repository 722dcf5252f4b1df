"""A fish, put together from gmsh's primitives."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

from .data import MeshData
from .fused import fuse, polygon
from .gmsh_model import limit_cells, mesh_model, session
from .parameters import among, cell_size_within, positive

# Of a fish 1 m long which swims along x, the middle of its thickest section at the origin [m]. Outlines are (x, z).
FRONT, BACK = 0.28, 0.56  # half axes of the body's two halves
HIGH, WIDE = 0.15, 0.1  # half axes across
TAIL = ((-0.4, 0.02), (-0.4, -0.02), (-0.68, -0.17), (-0.72, -0.16), (-0.63, 0.0), (-0.72, 0.16), (-0.68, 0.17))
FIN = ((0.06, 0.1), (-0.26, 0.08), (-0.24, 0.19), (-0.12, 0.22))
THICK = 0.06  # of the fins


def fish(size: float = 1.0, cell_size: float = 0.05, dimension: int = 3, order: int = 1) -> MeshData:
    """A fish: streamlined body, tail fin, fin on the back (in 2D its silhouette from the side).

    It swims along x; the middle of its thickest section is at the origin, z (y in 2D) is up.
    Boundaries: tail, fin, body.

    Parameters
    ----------
    size : float
        Length from mouth to tail [m].
    cell_size : float
        Target edge length [m].
    dimension, order : int
        2 or 3; 1 or 2.

    Raises
    ------
    MeshError
        For parameters out of range.
    """
    d, order = among("fish", "dimension", dimension, (2, 3)), among("fish", "order", order, (1, 2))
    s = positive("fish", "size", size)
    h = cell_size_within("fish", cell_size, s * THICK, "thickness of its fins")
    limit_cells("fish", (0.03 if d == 3 else 0.28) * s**d, h, d)
    with session() as gmsh:
        names = fuse(gmsh, d, {"tail": _fin(gmsh, d, TAIL), "fin": _fin(gmsh, d, FIN), "body": _body(gmsh, d)})
        data = mesh_model(gmsh, "fish", h / s, order, d, names)
    return replace(data, points=data.points * s)


def _body(gmsh: Any, d: int) -> list[int]:
    """Halves of two ellipsoids, a blunt one in front."""
    occ, found = gmsh.model.occ, []
    for long, corner in ((FRONT, 0.0), (BACK, -1.0)):
        if d == 3:
            whole, half = occ.addSphere(0, 0, 0, 1), occ.addBox(corner, -1, -1, 1, 2, 2)
            # the pole that stays is the mouth, the seam runs below: neither meets a fin in a sliver
            occ.rotate([(3, whole)], 0, 0, 0, 0, 1, 0, math.pi / 2)
            occ.dilate([(3, whole)], 0, 0, 0, long, WIDE, HIGH)
        else:
            whole, half = occ.addDisk(0, 0, 0, 1, 1), occ.addRectangle(corner, -1, 0, 1, 2)
            occ.dilate([(2, whole)], 0, 0, 0, long, HIGH, 1)
        found += [tag for _, tag in occ.intersect([(d, whole)], [(d, half)])[0]]
    return found


def _fin(gmsh: Any, d: int, outline: tuple[tuple[float, float], ...]) -> list[int]:
    if d == 2:
        return [polygon(gmsh, outline)]
    flat = polygon(gmsh, [(x, -THICK / 2, z) for x, z in outline])
    return [tag for dimension, tag in gmsh.model.occ.extrude([(2, flat)], 0, THICK, 0) if dimension == 3]
