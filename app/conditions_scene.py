"""What acts on a body: [[fixed]], [[motion]], [[traction]], [[pressure]] and [gravity]."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Literal

from pydantic import Field

from .scene_fields import (
    Condition,
    FreeVector,
    MovingQuantity,
    MovingVector,
    Names,
    NotNegative,
    Problem,
    Rotation,
    Table,
    Vector,
)

Axis = Literal["x", "y", "z"]


class Place(Table):
    """Where a condition acts."""

    boundary: Names | None = Field(None, description="name or names of boundaries of the mesh")
    where: Condition | None = Field(
        None, description="nodes whose reference coordinates x, y, z [m] fulfil this comparison"
    )

    def problems(self) -> Iterator[Problem]:
        """Yield what is wrong about the place."""
        if self.boundary is not None and self.where is not None:
            yield ("where",), "given together with boundary; leave one of them out"
        if self.boundary is None and self.where is None:
            yield ("boundary",), 'is missing; give boundary = "name" or where = "z < 0.01"'


class Fixed(Place):
    """[[fixed]]: components of the displacement held at zero."""

    components: tuple[Axis, ...] = Field(("x", "y", "z"), min_length=1, description="components held")


class Keyframe(Table):
    """One rigid placement of a moved boundary."""

    time: NotNegative = Field(description="time [s] or load parameter")
    translation: Vector | None = Field(None, description="translation [m]")
    rotation: Rotation | None = Field(
        None, description="rotation vector [rad]; in the plane one angle, or [0, 0, angle]"
    )
    center: Vector | None = Field(None, description="a point of the rotation's axis [m]; default: the origin")


class Motion(Place):
    """[[motion]]: prescribed displacement, by expressions or by keyframes joined by interpolation."""

    displacement: FreeVector | None = Field(
        None, description='displacement [m], expressions of x, y, z, t; "free" leaves a component free'
    )
    keyframes: tuple[Keyframe, ...] | None = Field(None, min_length=1, description="rigid placements in time")

    def problems(self) -> Iterator[Problem]:
        """Yield what is wrong about place and motion."""
        yield from super().problems()
        if self.displacement is not None and self.keyframes is not None:
            yield ("keyframes",), "given together with displacement; leave one of them out"
        if self.displacement is None and self.keyframes is None:
            yield ("displacement",), "is missing; give displacement = [..] or keyframes = [..]"
        if self.displacement is not None and all(entry is None for entry in self.displacement):
            yield ("displacement",), "leaves every component free; prescribe one or leave the motion out"
        frames = self.keyframes or ()
        for i in range(1, len(frames)):
            if frames[i].time <= frames[i - 1].time:
                yield (
                    ("keyframes", i, "time"),
                    f"must be above the time of the keyframe before it, {frames[i - 1].time:g}",
                )


class Traction(Table):
    """[[traction]]: force per reference area."""

    boundary: Names = Field(description="name or names of boundaries of the mesh")
    value: MovingVector = Field(description="force per reference area [Pa], expressions of x, y, z, t")


class Pressure(Table):
    """[[pressure]]: pressure which follows the deformed surface."""

    boundary: Names = Field(description="name or names of boundaries of the mesh")
    value: MovingQuantity = Field(
        description="pressure on the deformed surface [Pa], expression of x, y, z, t"
    )


class Gravity(Table):
    """[gravity]."""

    acceleration: Vector = Field(description="acceleration [m/s2], as [0, 0, -9.81]")
