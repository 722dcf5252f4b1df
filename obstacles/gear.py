"""Gears: a plane outline of arcs, exactly as far away as it says, drawn along an axis."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .geometry import BodyError, directed, fill, length, positive, unit, vector
from .shapes import Extruded

ROUND = 0.4  # radius of tips and of roots between teeth, of the smaller of depth and half the pitch


@dataclass(frozen=True, init=False, eq=False)
class Gear(Extruded):
    """Gear with rounded teeth.

    The outline has a tangent everywhere: arcs round tips and roots, joined by straight flanks. It is its own mirror
    image in the middles of teeth and gaps. Of what these mirrors cut the plane into, each piece holds the point of
    the outline which is nearest to a point of the piece; so φ is exact.

    Parameters
    ----------
    center : (D,) [m]
    radius : float [m]
        To the tips of the teeth.
    teeth : int
        3 or more; one points along x in 2D, along the axis that follows `axis` in 3D (x after z).
    depth : float [m]
        Height of the teeth, below the radius.
    length : float [m]
        Along the axis; 3D only.
    axis : (3,)
        3D only, default z.

    Raises
    ------
    BodyError
        Also for teeth which are shallower than the outline between two tips is round.
    """

    center: NDArray
    radius: float
    teeth: int
    depth: float
    length: float
    frame: NDArray  # rows: towards a tooth, across, along the axis in 3D

    def __init__(
        self,
        center: ArrayLike,
        radius: float,
        teeth: int,
        depth: float,
        length: float | None = None,
        axis: ArrayLike = (0, 0, 1),
    ) -> None:
        place = vector("gear", "center", center)
        fill(self, center=place, radius=positive("gear", "radius", radius), depth=positive("gear", "depth", depth))
        if int(teeth) != teeth or teeth < 3:
            raise BodyError(f"gear: teeth must be a whole number, 3 or above, got {teeth}")
        flat = 1 - np.cos(np.pi / teeth)  # a root must not lie outside the line from flank to flank
        least = self.radius * flat / (1 + ROUND * flat)
        if not least < self.depth < self.radius:
            raise BodyError(
                f"gear: depth must be above {least:.3g} m, for {teeth} teeth, and below the radius, got {depth}"
            )
        frame = np.eye(2)
        if len(place) == 3:
            if length is None:
                raise BodyError("gear: length is missing; in 3D a gear needs a positive length [m]")
            along = unit("gear", "axis", vector("gear", "axis", axis, 3))
            first = np.roll(np.eye(3), -1, axis=0)[np.argmax(np.abs(along))]
            first = unit("gear", "axis", first - (first @ along) * along)
            frame = np.array([first, np.cross(along, first), along])
        fill(self, teeth=int(teeth), frame=frame)
        fill(self, length=0.0 if len(place) == 2 else positive("gear", "length", length or 0.0))

    def bounds(self) -> tuple[NDArray, NDArray]:
        """Corners (D,) [m] of a box that encloses the gear."""
        half = self.radius * length(self.frame[:2].T)
        if len(self.center) == 3:
            half = half + self.length / 2 * np.abs(self.frame[2])
        return self.center - half, self.center + half

    @property
    def origin(self) -> NDArray:
        return self.center

    def outline(self, x: NDArray) -> tuple[NDArray, NDArray]:
        """φ (n,) and ∇φ (n, 2) at x (n, 2) in the plane of the teeth."""
        pitch = 2 * np.pi / self.teeth
        angle = np.arctan2(x[:, 1], x[:, 0])
        turned = pitch * np.round(angle / pitch)
        mirror = np.where(angle < turned, -1.0, 1.0)
        folded = length(x)[:, None] * np.stack([np.cos(angle - turned), np.abs(np.sin(angle - turned))], axis=1)
        phi, n = self._half_tooth(folded)
        cos, sin = np.cos(turned), np.sin(turned)
        across = mirror * n[:, 1]
        return phi, np.stack([cos * n[:, 0] - sin * across, sin * n[:, 0] + cos * across], axis=1)

    def _half_tooth(self, x: NDArray) -> tuple[NDArray, NDArray]:
        """The same between the middles of a tooth, at angle 0, and of the gap after it."""
        half = np.pi / self.teeth
        foot, gap = self.radius - self.depth, np.array([np.cos(half), np.sin(half)])
        r = ROUND * min(self.depth, 2 * foot * np.sin(half / 2))
        tip, root = np.array([self.radius - r, 0.0]), (foot + r) * gap
        # the flank touches both circles, each from its own side: out·(root - tip) = 2 r
        apart = float(length(root - tip))
        way, cos = (root - tip) / apart, 2 * r / apart
        out = cos * way + np.sqrt(1 - cos**2) * np.array([way[1], -way[0]])
        start, end = tip + r * out, root - r * out
        found = [
            _from_arc(x, tip, r, np.array([1.0, 0.0]), out),
            _from_line(x, start, end, out),
            _from_arc(x, root, -r, gap, out),
        ]
        nearest, rows = np.argmin([length(arm) for arm, _ in found], axis=0), np.arange(len(x))
        arm, n = (np.array(each)[nearest, rows] for each in zip(*found))
        size = length(arm)
        side = np.where(np.einsum("ni,ni->n", arm, n) < 0, -1.0, 1.0)
        return side * size, np.where(size[:, None] > 0, side[:, None] * directed(arm, gap), n)


def _from_arc(x: NDArray, center: NDArray, radius: float, a: NDArray, b: NDArray) -> tuple[NDArray, NDArray]:
    """Vectors (n, 2) [m] to x from the nearest points of an arc with normals from `a` to `b`, and the normals there.

    A negative radius is that of an arc round a hollow.
    """
    u = np.sign(radius) * directed(x - center, a)
    turn = np.sign(a[0] * b[1] - a[1] * b[0])
    on = (turn * (a[0] * u[:, 1] - a[1] * u[:, 0]) >= 0) & (turn * (u[:, 0] * b[1] - u[:, 1] * b[0]) >= 0)
    n = np.where(on[:, None], u, np.where((u @ a > u @ b)[:, None], a, b))
    return x - center - radius * n, n


def _from_line(x: NDArray, start: NDArray, end: NDArray, normal: NDArray) -> tuple[NDArray, NDArray]:
    """The same for a line between two points (2,) [m]."""
    way = end - start
    part = np.clip((x - start) @ way / (way @ way), 0.0, 1.0)
    return x - start - part[:, None] * way, np.broadcast_to(normal, x.shape)
