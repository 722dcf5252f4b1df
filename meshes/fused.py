"""One body from gmsh's primitives that overlap, with the boundary named after them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

CLOSE = 1e-3  # of a body about 1 m long: gmsh's bounding boxes are a little too large


def fuse(gmsh: Any, d: int, parts: Mapping[str, Sequence[int]]) -> dict[str, list[int]]:
    """Make one body of gmsh entities of dimension d; return the outer faces that come from each part.

    A face belongs to the first part within whose bounding box it lies, or to the last: put the largest there.
    """
    boxes = {name: [gmsh.model.occ.getBoundingBox(d, tag) for tag in tags] for name, tags in parts.items()}
    every = [(d, tag) for tags in parts.values() for tag in tags]
    gmsh.option.setNumber("Geometry.OCCUnionUnify", 0)
    gmsh.model.occ.fuse(every[:1], every[1:])
    gmsh.model.occ.synchronize()
    found: dict[str, list[int]] = {name: [] for name in parts}
    for _, tag in gmsh.model.getBoundary(gmsh.model.getEntities(d), combined=True, oriented=False):
        low, high = np.array(gmsh.model.occ.getBoundingBox(d - 1, tag)).reshape(2, 3)
        owners = [
            name
            for name, tags in boxes.items()
            if any((low > np.array(b[:3]) - CLOSE).all() and (high < np.array(b[3:]) + CLOSE).all() for b in tags)
        ]
        found[(owners or list(boxes))[0 if owners else -1]].append(tag)
    return found


def polygon(gmsh: Any, corners: Sequence[Sequence[float]]) -> int:
    """Surface with straight sides between corners (x, y) or (x, y, z) [m]; its tag."""
    points = [gmsh.model.occ.addPoint(*corner, *(0.0,) * (3 - len(corner))) for corner in corners]
    lines = [gmsh.model.occ.addLine(p, q) for p, q in zip(points, points[1:] + points[:1], strict=True)]
    return int(gmsh.model.occ.addPlaneSurface([gmsh.model.occ.addCurveLoop(lines)]))
