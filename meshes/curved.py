"""Round bodies: sphere, cylinder, tube, torus. Their order-2 meshes follow the curved surface."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from .data import MeshData, MeshError
from .gmsh_model import limit_cells, mesh_model, session
from .parameters import among, cell_size_within, point, positive

Namer = Callable[[Sequence[float]], str]
ORIGIN = (0.0, 0.0, 0.0)


def sphere(
    radius: float = 1.0,
    cell_size: float = 0.3,
    dimension: int = 3,
    order: int = 1,
    center: Sequence[float] = ORIGIN,
) -> MeshData:
    """Ball (disk in 2D).

    Boundaries: top, bottom (the halves above and below the centre: z in 3D, y in 2D).

    Parameters
    ----------
    radius, cell_size : float
        Radius and target edge length [m].
    dimension, order : int
        2 or 3; 1 or 2.
    center : sequence of d floats
        [m]

    Raises
    ------
    MeshError
        For parameters out of range.
    """
    d, order = among("sphere", "dimension", dimension, (2, 3)), among("sphere", "order", order, (1, 2))
    r = positive("sphere", "radius", radius)
    h = cell_size_within("sphere", cell_size, r, "radius")
    limit_cells("sphere", 4 / 3 * math.pi * r**3 if d == 3 else math.pi * r**2, h, d)

    def name(middle: Sequence[float]) -> str:
        return "top" if middle[d - 1] > 0 else "bottom"

    with session() as gmsh:
        if d == 3:
            half = math.pi / 2
            lower = gmsh.model.occ.addSphere(0, 0, 0, r, angle1=-half, angle2=0)
            upper = gmsh.model.occ.addSphere(0, 0, 0, r, angle1=0, angle2=half)
            _join(gmsh, [(3, lower), (3, upper)])
        else:
            arcs = [gmsh.model.occ.addCircle(0, 0, 0, r, angle1=a, angle2=a + math.pi) for a in (0, math.pi)]
            gmsh.model.occ.addPlaneSurface([gmsh.model.occ.addCurveLoop(arcs)])
            gmsh.model.occ.synchronize()
        data = mesh_model(gmsh, "sphere", h, order, d, _named(gmsh, d, ["top", "bottom"], name))
    return _placed(data, "sphere", center)


def cylinder(
    radius: float = 0.5,
    length: float = 2.0,
    cell_size: float = 0.2,
    dimension: int = 3,
    order: int = 1,
    axis: str = "z",
    center: Sequence[float] = ORIGIN,
) -> MeshData:
    """Solid cylinder.

    Boundaries: bottom, top (the ends, in the direction of the axis), side.

    Parameters
    ----------
    radius, length, cell_size : float
        Radius, length along the axis and target edge length [m].
    dimension, order : int
        3 (in 2D a disk is a "sphere", a rectangle a "box"); 1 or 2.
    axis : str
        "x", "y" or "z".
    center : sequence of 3 floats
        Middle of the body [m].

    Raises
    ------
    MeshError
        For parameters out of range.
    """
    d, order = among("cylinder", "dimension", dimension, (3,)), among("cylinder", "order", order, (1, 2))
    r, length = positive("cylinder", "radius", radius), positive("cylinder", "length", length)
    shift = _axis("cylinder", axis)
    h = cell_size_within("cylinder", cell_size, min(r, length), "smaller of radius and length")
    limit_cells("cylinder", math.pi * r**2 * length, h, d)

    def name(middle: Sequence[float]) -> str:
        end = abs(middle[2]) > length / 2 * (1 - 1e-6)
        return ("top" if middle[2] > 0 else "bottom") if end else "side"

    with session() as gmsh:
        gmsh.model.occ.addCylinder(0, 0, -length / 2, 0, 0, length, r)
        gmsh.model.occ.synchronize()
        names = _named(gmsh, d, ["bottom", "top", "side"], name)
        data = mesh_model(gmsh, "cylinder", h, order, d, names)
    return _placed(data, "cylinder", center, shift)


def tube(
    radius: float = 0.5,
    inner_radius: float = 0.3,
    length: float = 2.0,
    cell_size: float = 0.15,
    dimension: int = 3,
    order: int = 1,
    axis: str = "z",
    center: Sequence[float] = ORIGIN,
) -> MeshData:
    """Hollow cylinder (ring in 2D, where `length` and `axis` mean nothing).

    Boundaries: bottom, top (the ends), inner, outer; in 2D inner, outer.

    Parameters
    ----------
    radius, inner_radius, length, cell_size : float
        Radii, length along the axis and target edge length [m].
    dimension, order : int
        2 or 3; 1 or 2.
    axis : str
        "x", "y" or "z".
    center : sequence of d floats
        Middle of the body [m].

    Raises
    ------
    MeshError
        For parameters out of range.
    """
    d, order = among("tube", "dimension", dimension, (2, 3)), among("tube", "order", order, (1, 2))
    r, inner = positive("tube", "radius", radius), positive("tube", "inner_radius", inner_radius)
    length, shift = positive("tube", "length", length), _axis("tube", axis)
    if inner >= r:
        raise MeshError(f"tube: inner_radius must be less than radius {r:g} [m], got {inner:g}")
    if d == 3:
        h = cell_size_within("tube", cell_size, min(r - inner, length), "wall thickness (or length)")
    else:
        h = cell_size_within("tube", cell_size, r - inner, "wall thickness")
    limit_cells("tube", math.pi * (r**2 - inner**2) * (length if d == 3 else 1), h, d)

    with session() as gmsh:
        if d == 3:
            outside = gmsh.model.occ.addCylinder(0, 0, -length / 2, 0, 0, length, r)
            inside = gmsh.model.occ.addCylinder(0, 0, -length / 2, 0, 0, length, inner)
        else:
            outside = gmsh.model.occ.addDisk(0, 0, 0, r, r)
            inside = gmsh.model.occ.addDisk(0, 0, 0, inner, inner)
        gmsh.model.occ.cut([(d, outside)], [(d, inside)])
        gmsh.model.occ.synchronize()
        ends = ["bottom", "top"] if d == 3 else []
        names: dict[str, list[int]] = {name: [] for name in [*ends, "inner", "outer"]}
        for _, tag in gmsh.model.getEntities(d - 1):
            middle = gmsh.model.occ.getCenterOfMass(d - 1, tag)
            if d == 3 and abs(middle[2]) > length / 2 * (1 - 1e-6):
                names["top" if middle[2] > 0 else "bottom"].append(tag)
            else:
                # The curves of a ring and the walls of a tube are centred: their extent tells them apart.
                reach = gmsh.model.occ.getBoundingBox(d - 1, tag)[3]
                names["outer" if reach > (r + inner) / 2 else "inner"].append(tag)
        data = mesh_model(gmsh, "tube", h, order, d, names)
    return _placed(data, "tube", center, shift)


def torus(
    radius: float = 1.0,
    thickness: float = 0.5,
    straight: float = 0.0,
    cell_size: float = 0.2,
    dimension: int = 3,
    order: int = 1,
    axis: str = "z",
    center: Sequence[float] = ORIGIN,
) -> MeshData:
    """Ring of circular section; with straight parts, a link of a chain (along x, where the axis is z).

    Boundaries: left, right (the halves with x below and above the centre).

    Parameters
    ----------
    radius : float
        From the centre of the ring to the centre of the section [m].
    thickness : float
        Diameter of the section [m].
    straight : float
        Length of the two straight parts of a link [m]; 0 for a ring.
    cell_size : float
        Target edge length [m].
    dimension, order : int
        3 (in 2D a ring is a "tube"); 1 or 2.
    axis : str
        Axis of the ring, "x", "y" or "z".
    center : sequence of 3 floats
        [m]

    Raises
    ------
    MeshError
        For parameters out of range.
    """
    d, order = among("torus", "dimension", dimension, (3,)), among("torus", "order", order, (1, 2))
    R, r = positive("torus", "radius", radius), positive("torus", "thickness", thickness) / 2
    gap = 0.0 if straight == 0 else positive("torus", "straight", straight)
    shift = _axis("torus", axis)
    if r >= R:
        raise MeshError(f"torus: thickness must be less than twice the radius, {2 * R:g} m, got {2 * r:g}")
    h = cell_size_within("torus", cell_size, r, "radius of its section")
    limit_cells("torus", math.pi * r**2 * (2 * math.pi * R + 2 * gap), h, d)

    with session() as gmsh:
        occ, parts = gmsh.model.occ, []
        for angle, side in ((-math.pi / 2, 1), (math.pi / 2, -1)):
            bow = (3, occ.addTorus(0, 0, 0, R, r, angle=math.pi))
            occ.rotate([bow], 0, 0, 0, 0, 0, 1, angle)
            occ.translate([bow], side * gap / 2, 0, 0)
            parts.append(bow)
            if gap > 0:
                parts += [(3, occ.addCylinder(0, y, 0, side * gap / 2, 0, 0, r)) for y in (-R, R)]
        _join(gmsh, parts)
        names = _named(gmsh, 3, ["left", "right"], lambda middle: "right" if middle[0] > 0 else "left")
        data = mesh_model(gmsh, "torus", h, order, d, names)
    return _placed(data, "torus", center, shift)


def _join(gmsh: Any, parts: list[tuple[int, int]]) -> None:
    """One body from touching parts, whose outer faces stay apart so that they can have names."""
    gmsh.option.setNumber("Geometry.OCCUnionUnify", 0)
    gmsh.model.occ.fuse(parts[:1], parts[1:])
    gmsh.model.occ.synchronize()


def _named(gmsh: Any, d: int, names: Sequence[str], name: Namer) -> dict[str, list[int]]:
    """Entities of dimension d - 1 on the outside, by the name of their centre."""
    found: dict[str, list[int]] = {n: [] for n in names}
    outside = gmsh.model.getBoundary(gmsh.model.getEntities(d), combined=True, oriented=False)
    for dimension, tag in outside:
        found[name(gmsh.model.occ.getCenterOfMass(dimension, tag))].append(tag)
    return found


def _axis(shape: str, axis: object) -> int:
    if axis not in ("x", "y", "z"):
        raise MeshError(f"{shape}: axis must be 'x', 'y' or 'z', got {axis!r}")
    return {"x": 1, "y": 2, "z": 0}[str(axis)]


def _placed(data: MeshData, shape: str, center: Sequence[float], shift: int = 0) -> MeshData:
    """The body with its z axis turned by a cyclic exchange of coordinates, moved to `center`."""
    d = data.dimension
    points = np.roll(data.points, shift, axis=1) if d == 3 else data.points
    return replace(data, points=np.ascontiguousarray(points + point(shape, "center", center, d)))
