"""Solid shapes as level sets: signed distance φ [m], negative inside, its gradient, and bounds.

Every shape serves twice: as the region a body fills and as an obstacle, whose motion `colliders` adds.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .geometry import (
    BodyError,
    as_text,
    convex_polygon,
    directed,
    fill,
    intersection,
    intersection_gradient,
    length,
    positive,
    unit,
    vector,
)


class Region(Protocol):
    """What can be filled with particles."""

    def bounds(self) -> tuple[NDArray, NDArray]:
        """Lowest and highest corner, each (D,) [m]."""

    def inside(self, x: NDArray) -> NDArray:
        """Whether points (n, D) [m] belong to it, (n,) bool."""


@runtime_checkable
class Shape(Region, Protocol):
    """A region with a level set, at rest."""

    def distance(self, x: NDArray) -> NDArray:
        """φ (n,) [m] at points (n, D) [m], negative inside."""

    def normal(self, x: NDArray) -> NDArray:
        """∇φ (n, D), of unit length."""


class Solid:
    """What follows from φ alone."""

    def distance(self, x: NDArray) -> NDArray:
        """φ (n,) [m] at points (n, D) [m]."""
        raise NotImplementedError

    def inside(self, x: NDArray) -> NDArray:
        return self.distance(x) <= 0


@dataclass(frozen=True, init=False, eq=False)
class HalfSpace(Solid):
    """Everything below the plane through `point` [m] with outward `normal`."""

    point: NDArray
    direction: NDArray

    def __init__(self, point: ArrayLike, normal: ArrayLike) -> None:
        direction = vector("half_space", "normal", normal)
        fill(self, point=vector("half_space", "point", point, len(direction)))
        fill(self, direction=unit("half_space", "normal", direction))

    def bounds(self) -> tuple[NDArray, NDArray]:
        """Infinite, except where the plane is perpendicular to an axis."""
        low, high = np.full(len(self.point), -np.inf), np.full(len(self.point), np.inf)
        axis = int(np.argmax(np.abs(self.direction)))
        if abs(self.direction[axis]) == 1.0:
            side = high if self.direction[axis] > 0 else low
            side[axis] = self.point[axis]
        return low, high

    def distance(self, x: NDArray) -> NDArray:
        return x @ self.direction - self.point @ self.direction

    def normal(self, x: NDArray) -> NDArray:
        return np.tile(self.direction, (len(x), 1))


@dataclass(frozen=True, init=False, eq=False)
class Sphere(Solid):
    """Ball, in 2D disc, with `center` [m] and `radius` [m]."""

    center: NDArray
    radius: float

    def __init__(self, center: ArrayLike, radius: float) -> None:
        fill(self, center=vector("sphere", "center", center), radius=positive("sphere", "radius", radius))

    def bounds(self) -> tuple[NDArray, NDArray]:
        return self.center - self.radius, self.center + self.radius

    def distance(self, x: NDArray) -> NDArray:
        return length(x - self.center) - self.radius

    def normal(self, x: NDArray) -> NDArray:
        return directed(x - self.center, np.eye(x.shape[1])[-1])


@dataclass(frozen=True, init=False, eq=False)
class Box(Solid):
    """Box, in 2D rectangle, with edges along the axes, from corner `low` to corner `high` [m]."""

    low: NDArray
    high: NDArray

    def __init__(self, low: ArrayLike, high: ArrayLike) -> None:
        fill(self, low=vector("box", "low", low))
        fill(self, high=vector("box", "high", high, len(self.low)))
        if not (self.high > self.low).all():
            raise BodyError(
                f"box: high must be above low in every component, got {as_text(self.low)}, {as_text(self.high)}"
            )

    def bounds(self) -> tuple[NDArray, NDArray]:
        return self.low, self.high

    def distance(self, x: NDArray) -> NDArray:
        return intersection(self._slabs(x))

    def normal(self, x: NDArray) -> NDArray:
        """∇φ (n, D) at points (n, D) [m]."""
        outward = np.where(x < (self.low + self.high) / 2, -1.0, 1.0)
        return intersection_gradient(self._slabs(x), outward[:, :, None] * np.eye(x.shape[1]))

    def _slabs(self, x: NDArray) -> NDArray:
        return np.maximum(self.low - x, x - self.high)


@dataclass(frozen=True, init=False, eq=False)
class Cylinder(Solid):
    """Circular cylinder of `radius` and `length` [m] about `center` [m], along `axis`; 3D only."""

    center: NDArray
    radius: float
    length: float
    axis: NDArray

    def __init__(self, center: ArrayLike, radius: float, length: float, axis: ArrayLike = (0, 0, 1)) -> None:
        fill(self, center=vector("cylinder", "center", center, 3), radius=positive("cylinder", "radius", radius))
        fill(self, length=positive("cylinder", "length", length))
        fill(self, axis=unit("cylinder", "axis", vector("cylinder", "axis", axis, 3)))

    def bounds(self) -> tuple[NDArray, NDArray]:
        """Corners (3,) [m] of the smallest box that encloses the cylinder."""
        across = np.sqrt(np.maximum(0.0, 1 - self.axis**2))
        half = np.abs(self.axis) * self.length / 2 + self.radius * across
        return self.center - half, self.center + half

    def distance(self, x: NDArray) -> NDArray:
        return intersection(self._parts(x)[0])

    def normal(self, x: NDArray) -> NDArray:
        """∇φ (n, 3) at points (n, 3) [m]."""
        q, along, radial = self._parts(x)
        sideways = np.cross(self.axis, np.eye(3)[np.argmin(np.abs(self.axis))])
        round_about = directed(radial, sideways / length(sideways))
        ends = np.where(along < 0, -1.0, 1.0)[:, None] * self.axis
        return intersection_gradient(q, np.stack([round_about, ends], axis=1))

    def _parts(self, x: NDArray) -> tuple[NDArray, NDArray, NDArray]:
        arm = x - self.center
        along = arm @ self.axis
        radial = arm - along[:, None] * self.axis
        return np.stack([length(radial) - self.radius, np.abs(along) - self.length / 2], axis=1), along, radial


class Extruded(Solid):
    """An outline in the plane; in 3D what it sweeps along an axis, with flat ends.

    `frame` has the axes of the plane as its first rows and, in 3D, the axis as its last one; `length` is along it.
    """

    frame: NDArray
    length: float

    @property
    def origin(self) -> NDArray:
        """(D,) [m] where the plane's coordinates, and those along the axis, are zero."""
        raise NotImplementedError

    def outline(self, x: NDArray) -> tuple[NDArray, NDArray]:
        """φ (n,) [m] and ∇φ (n, 2) of the outline at points (n, 2) [m] in its plane."""
        raise NotImplementedError

    def distance(self, x: NDArray) -> NDArray:
        """φ (n,) [m] at points (n, D) [m]."""
        local = (x - self.origin) @ self.frame.T
        return intersection(self._parts(local, self.outline(local[:, :2])[0]))

    def normal(self, x: NDArray) -> NDArray:
        """∇φ (n, D) at points (n, D) [m]."""
        local = (x - self.origin) @ self.frame.T
        phi, flat = self.outline(local[:, :2])
        gradients = np.zeros((len(x), x.shape[1] - 1, x.shape[1]))
        gradients[:, 0, :2] = flat
        if x.shape[1] == 3:
            gradients[:, 1, 2] = np.where(local[:, 2] < 0, -1.0, 1.0)
        return intersection_gradient(self._parts(local, phi), gradients) @ self.frame

    def _parts(self, local: NDArray, phi: NDArray) -> NDArray:
        return np.concatenate([phi[:, None], np.abs(local[:, 2:]) - self.length / 2], axis=1)


@dataclass(frozen=True, init=False, eq=False)
class Wedge(Extruded):
    """Triangle, in 3D triangular prism, which cuts upwards (figure 7.5).

    Parameters
    ----------
    apex : (D,) [m]
        The upper corner; in 3D the middle of the edge.
    width, height : float [m]
        Width of the base, height of the edge above it.
    length : float [m]
        Length of the edge; 3D only.
    up : (D,)
        From base to edge; default the last axis.
    edge : (3,)
        Direction of the edge; 3D only, default the y axis.
    """

    apex: NDArray
    corners: NDArray  # (3, 2) [m] in the plane (across, up) from the apex, counterclockwise
    frame: NDArray  # rows across, up and, in 3D, edge
    length: float

    def __init__(
        self,
        apex: ArrayLike,
        width: float,
        height: float,
        length: float | None = None,
        up: ArrayLike | None = None,
        edge: ArrayLike = (0, 1, 0),
    ) -> None:
        place = vector("wedge", "apex", apex)
        dim = len(place)
        upward = unit("wedge", "up", np.eye(dim)[-1] if up is None else vector("wedge", "up", up, dim))
        if dim == 2:
            frame = np.array([[upward[1], -upward[0]], upward])
        else:
            if length is None:
                raise BodyError("wedge: length is missing; in 3D the edge needs a positive length [m]")
            along = vector("wedge", "edge", edge, 3)
            along = unit("wedge", "edge", along - (along @ upward) * upward)
            frame = np.array([np.cross(along, upward), upward, along])
        w, h = positive("wedge", "width", width), positive("wedge", "height", height)
        fill(self, apex=place, frame=frame, length=0.0 if dim == 2 else positive("wedge", "length", length or 0.0))
        fill(self, corners=np.array([[0.0, 0.0], [-w / 2, -h], [w / 2, -h]]))

    def bounds(self) -> tuple[NDArray, NDArray]:
        """Corners (D,) [m] of a box that encloses the wedge."""
        points = self.corners @ self.frame[:2] + self.apex
        half = np.abs(self.frame[2]) * self.length / 2 if len(self.apex) == 3 else 0.0
        return points.min(axis=0) - half, points.max(axis=0) + half

    @property
    def origin(self) -> NDArray:
        return self.apex

    def outline(self, x: NDArray) -> tuple[NDArray, NDArray]:
        return convex_polygon(self.corners, x)
