"""[[collider]] of a scene, for snow and for elastic solids, and the shapes that it and snow's bodies share."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field

from .conditions_scene import Axis, Keyframe
from .scene_common import Where
from .scene_fields import Boolean, Integer, NotNegative, Positive, Problem, Table, Text, Vector, quantity

SurfaceHeight = Annotated[float | str, quantity(("x", "y"))]

# the keys of each shape: those it needs, those it may have
Keys = dict[str, tuple[tuple[str, ...], tuple[str, ...]]]
SOLIDS: Keys = {
    "box": (("low", "high"), ()),
    "sphere": (("center", "radius"), ()),
    "cylinder": (("center", "radius", "length"), ("axis",)),
    "tube": (("center", "radius", "thickness", "length"), ("axis", "flare")),
    "bowl": (("center", "radius", "thickness"), ()),
    "gear": (("center", "radius", "teeth", "depth"), ("length", "axis")),
    "wedge": (("apex", "width", "height"), ("length", "axis")),
    "text": (("text", "height", "center"), ("thickness",)),
    "height_field": (("low", "high", "surface"), ()),
    "surface": (("file",), ("scale", "translation")),
}
COLLIDERS: Keys = {**SOLIDS, "half_space": (("point", "normal"), ()), "level_sets": (("file",), ())}
VECTORS = ("low", "high", "center", "translation", "point", "normal", "apex", "velocity")
SPACE_ONLY = ("cylinder", "surface")
# what has no third dimension in the plane, and must have one in space
THICK = {"wedge": "length", "gear": "length", "text": "thickness"}


class Shape(Table):
    """What a body and a collider share: a shape and its keys."""

    KEYS: ClassVar[Keys] = {}
    COMMON: ClassVar[tuple[str, ...]] = ()

    low: Vector | None = Field(None, description="box, height_field: corner with the smallest coordinates [m]")
    high: Vector | None = Field(None, description="box, height_field: corner with the largest coordinates [m]")
    center: Vector | None = Field(None, description="sphere, cylinder, tube, bowl, gear, text: middle [m]")
    radius: Positive | None = Field(None, description="sphere, cylinder, gear, inside of tube, bowl: radius [m]")
    length: Positive | None = Field(
        None, description="cylinder, tube, gear, wedge: length along its axis or edge [m], of a tube without mouths"
    )
    axis: Axis | None = Field(
        None,
        description="cylinder, tube, gear: direction of its axis, default z, of a tube in the plane y; "
        "wedge: of its edge, default y",
    )
    flare: NotNegative = Field(0.0, description="tube: radius with which both mouths bend outwards [m]")
    teeth: Annotated[Integer, Field(ge=3)] | None = Field(None, description="gear: number of teeth")
    depth: Positive | None = Field(None, description="gear: height of its teeth, below the radius [m]")
    apex: Vector | None = Field(None, description="wedge: middle of its upper edge [m]")
    width: Positive | None = Field(None, description="wedge: width of its base [m]")
    height: Positive | None = Field(None, description="wedge: of the edge above its base [m]; text: of all its lines")
    text: Text | None = Field(None, description="text: the words, upright, read along x")
    thickness: Positive | None = Field(None, description="tube, bowl, text: thickness of the wall, of the letters [m]")
    surface: SurfaceHeight | None = Field(
        None, description="height_field: height of its top [m], expression of x, y; in the plane of x"
    )
    file: Text | None = Field(
        None, description="surface: closed surface mesh (STL, OBJ, PLY); level_sets: arrays (NPZ); beside the scene"
    )
    scale: Positive = Field(1.0, description="surface: factor of the file's lengths [1]")
    translation: Vector | None = Field(None, description="surface: moved by this after scaling [m]")

    def problems(self) -> Iterator[Problem]:
        """Yield keys of other shapes, what the shape lacks, and corners in the wrong order."""
        shape = self.shape  # type: ignore[attr-defined]
        needed, optional = self.KEYS[shape]
        for key in type(self).model_fields:
            if key in self.model_fields_set and key not in (*needed, *optional, *self.COMMON):
                owners = " or ".join(f'"{name}"' for name, keys in self.KEYS.items() if key in (*keys[0], *keys[1]))
                yield (key,), f'belongs to shape = {owners}, but shape is "{shape}"'
        for key in needed:
            if key not in self.model_fields_set:
                yield (key,), f'is missing; shape "{shape}" needs it: {self._meaning(key)}'
        if self.low is not None and self.high is not None and "low" in needed:
            if len(self.low) != len(self.high):
                yield ("high",), f"must have {len(self.low)} components, as low has"
            elif any(a >= b for a, b in zip(self.low, self.high)):
                yield ("high",), "must be above low in every component"
        if self.text is not None and not self.text.strip():
            yield ("text",), "has no letter"

    @classmethod
    def _meaning(cls, key: str) -> str:
        return str(cls.model_fields[key].description).rpartition(": ")[2]


class Collider(Shape):
    """[[collider]]: what snow, or an elastic body, cannot enter."""

    KEYS = COLLIDERS
    COMMON = ("shape", "friction", "sticky", "keyframes")

    shape: Literal[
        "half_space",
        "box",
        "sphere",
        "cylinder",
        "tube",
        "bowl",
        "gear",
        "wedge",
        "text",
        "height_field",
        "surface",
        "level_sets",
    ] = Field(description="what cannot be entered")
    point: Vector | None = Field(None, description="half_space: a point of its plane [m]")
    normal: Vector | None = Field(None, description="half_space: direction out of it, of any length")
    friction: NotNegative = Field(0.0, description="coefficient of Coulomb friction μ [1]")
    sticky: Boolean = Field(False, description="what touches it does not slide; snow does not leave it either (7.7)")
    keyframes: tuple[Keyframe, ...] | None = Field(None, min_length=1, description="rigid placements in time")

    def problems(self) -> Iterator[Problem]:
        """Yield what is wrong with shape, contact and motion."""
        yield from super().problems()
        if self.normal is not None and not any(self.normal):
            yield ("normal",), "must not be zero"
        if self.sticky and "friction" in self.model_fields_set:
            yield ("friction",), "has no effect where sticky = true; leave one of them out"
        if self.shape == "level_sets" and self.keyframes is not None:
            yield ("keyframes",), "the file of level sets says how they move; leave keyframes out"
        frames = self.keyframes or ()
        for i in range(1, len(frames)):
            if frames[i].time <= frames[i - 1].time:
                before = frames[i - 1].time
                yield ("keyframes", i, "time"), f"must be above the time of the keyframe before it, {before:g}"


def shape_dimension(where: Where, entry: Shape, d: int, what: str, plane: str) -> Iterator[Problem]:
    """Yield what of a shape and its motion does not fit `d` dimensions.

    Parameters
    ----------
    where : tuple
        Table and number of the entry.
    entry : Shape
    d : int
        2 or 3.
    what, plane : str
        What has so many dimensions, and how the scene says that there are two, for messages.
    """
    shape = entry.shape  # type: ignore[attr-defined]
    vectors: list[tuple[Where, Any]] = [((*where, key), getattr(entry, key, None)) for key in VECTORS]
    turns: list[tuple[Where, Any]] = [((*where, key), getattr(entry, key, None)) for key in ("rotation", "spin")]
    for k, frame in enumerate(getattr(entry, "keyframes", None) or ()):
        place: Where = (*where, "keyframes", k)
        vectors += [((*place, key), getattr(frame, key)) for key in ("translation", "center")]
        turns.append(((*place, "rotation"), frame.rotation))
    if d == 2 and shape in SPACE_ONLY:
        yield (*where, "shape"), plane
    if d == 2 and entry.axis is not None and (shape != "tube" or entry.axis == "z"):
        yield (*where, "axis"), plane
    key = THICK.get(shape, "")
    if key and (getattr(entry, key) is None) == (d == 3):
        yield (*where, key), f"is missing; in space a {shape} has a {key} [m]" if d == 3 else plane
    for at, value in vectors:
        if value is not None and len(value) != d:
            yield at, f"must have {d} components: the {what} is {d}-dimensional"
    for at, value in turns:
        if value is None or (d == 3 and isinstance(value, tuple)):
            continue
        if d == 2 and (isinstance(value, float) or value[:2] == (0, 0)):
            continue
        accepted = "a vector of 3 entries" if d == 3 else "one number, or [0, 0, number]"
        yield at, f"must be {accepted}: the {what} is {d}-dimensional"
