"""A four-legged animal, put together from gmsh's primitives."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np

from .data import MeshData
from .fused import CLOSE, fuse, polygon
from .gmsh_model import limit_cells, mesh_model, session
from .parameters import among, cell_size_within, positive

# Of an animal whose trunk is 1 m long, feet on the ground (z = 0; y = 0 in 2D), looking along x [m].
TRUNK, TRUNK_AT = (0.5, 0.25, 0.25), (0.0, 0.0, 0.62)  # half axes, centre
HEAD, HEAD_AT = 0.22, (0.52, 0.0, 0.88)
LEG, LEGS_AT = 0.08, ((0.25, 0.1), (0.25, -0.1), (-0.25, 0.1), (-0.25, -0.1))
TAIL = ((-0.33, 0.0, 0.68), (-0.5, 0.0, 0.36), 0.08, 0.05)  # start, direction and length, radii
EARS_AT, EAR = ((0.5, 0.09, 0.98), (0.5, -0.09, 0.98)), ((-0.02, 0.07, 0.26), 0.08, 0.04)
SMALLEST = 2 * LEG


def creature(size: float = 1.0, cell_size: float = 0.1, dimension: int = 3, order: int = 1) -> MeshData:
    """An animal: body, head with two ears, four legs, tail (in 2D its silhouette from the side).

    It stands on the plane z = 0 (y = 0 in 2D) and looks along x.
    Boundaries: feet (the flat soles), legs, head, ears, tail, trunk.

    Parameters
    ----------
    size : float
        Length of the body without head and tail [m].
    cell_size : float
        Target edge length [m].
    dimension, order : int
        2 or 3; 1 or 2.

    Raises
    ------
    MeshError
        For parameters out of range.
    """
    d, order = among("creature", "dimension", dimension, (2, 3)), among("creature", "order", order, (1, 2))
    s = positive("creature", "size", size)
    h = cell_size_within("creature", cell_size, s * SMALLEST, "thickness of its legs")
    limit_cells("creature", (0.18 if d == 3 else 0.75) * s**d, h, d)
    with session() as gmsh:
        names = fuse(gmsh, d, (_solids if d == 3 else _silhouette)(gmsh))
        feet = [tag for tag in names["legs"] if gmsh.model.occ.getBoundingBox(d - 1, tag)[2 + d] < CLOSE]
        names |= {"feet": feet, "legs": [tag for tag in names["legs"] if tag not in feet]}
        data = mesh_model(gmsh, "creature", h / s, order, d, names)
    return replace(data, points=data.points * s)


def _solids(gmsh: Any) -> dict[str, list[int]]:
    occ = gmsh.model.occ
    trunk = occ.addSphere(*TRUNK_AT, 1.0)
    occ.dilate([(3, trunk)], *TRUNK_AT, *TRUNK)
    (tail_at, tail, thick, thin), (ear, wide, narrow) = TAIL, EAR
    mirrored = [(ear[0], math.copysign(ear[1], y), ear[2]) for _, y, _ in EARS_AT]
    return {
        "legs": [occ.addCylinder(x, y, 0, 0, 0, TRUNK_AT[2], LEG) for x, y in LEGS_AT],
        "ears": [occ.addCone(*at, *to, wide, narrow) for at, to in zip(EARS_AT, mirrored, strict=True)],
        "tail": [occ.addCone(*tail_at, *tail, thick, thin)],
        "head": [occ.addSphere(*HEAD_AT, HEAD)],
        "trunk": [trunk],
    }


def _silhouette(gmsh: Any) -> dict[str, list[int]]:
    """The outlines seen along y, x and z becoming x and y; hind and fore legs stand a little apart."""
    occ = gmsh.model.occ

    def cone(start: Any, direction: Any, wide: float, narrow: float) -> int:
        a, along = np.array([start[0], start[2]]), np.array([direction[0], direction[2]])
        across = np.array([-along[1], along[0]]) / np.linalg.norm(along)
        ends = [
            a + wide * across,
            a - wide * across,
            a + along - narrow * across,
            a + along + narrow * across,
        ]
        return polygon(gmsh, [tuple(end) for end in ends])

    legs = [x + shift for x in (0.25, -0.25) for shift in (-0.11, 0.11)]
    ear, wide, narrow = EAR
    return {
        "legs": [occ.addRectangle(x - LEG, 0, 0, 2 * LEG, TRUNK_AT[2]) for x in legs],
        "ears": [
            cone((at, 0, EARS_AT[0][2]), (lean, 0, ear[2]), wide, narrow)
            for at, lean in ((HEAD_AT[0] - 0.1, -0.06), (HEAD_AT[0] + 0.1, 0.06))
        ],
        "tail": [cone(*TAIL)],
        "head": [occ.addDisk(HEAD_AT[0], HEAD_AT[2], 0, HEAD, HEAD)],
        "trunk": [occ.addDisk(TRUNK_AT[0], TRUNK_AT[2], 0, TRUNK[0], TRUNK[2])],
    }

