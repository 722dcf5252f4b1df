"""[[body]] and [[collider]] of a scene for `extremal snow`: shapes, and what is particular to each."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, ClassVar, Literal

from pydantic import Field

from .conditions_scene import Axis, Keyframe
from .scene_fields import (
    Boolean,
    Integer,
    NotNegative,
    Number,
    Positive,
    Problem,
    Rotation,
    Table,
    Text,
    Vector,
    quantity,
)

Law = Literal["snow", "fixed_corotated", "neo_hookean"]
PLASTIC = ("critical_compression", "critical_stretch", "hardening", "hardening_cap")
SurfaceHeight = Annotated[float | str, quantity(("x", "y"))]
Fraction = Annotated[Number, Field(gt=0, lt=1)]

# the keys of each shape: those it needs, those it may have
Keys = dict[str, tuple[tuple[str, ...], tuple[str, ...]]]
SOLIDS: Keys = {
    "box": (("low", "high"), ()),
    "sphere": (("center", "radius"), ()),
    "cylinder": (("center", "radius", "length"), ("axis",)),
    "wedge": (("apex", "width", "height"), ("length", "axis")),
    "text": (("text", "height", "center"), ("thickness",)),
    "height_field": (("low", "high", "surface"), ()),
    "surface": (("file",), ("scale", "translation")),
}
COLLIDERS: Keys = {**SOLIDS, "half_space": (("point", "normal"), ()), "level_sets": (("file",), ())}


class SnowMaterialKeys(Table):
    """Any subset of the keys of [material]: what a body may override."""

    law: Law = Field("snow", description="snow: elasto-plastic with hardening (7.1); the others are elastic")
    young_modulus: Positive = Field(1.4e5, description="initial Young's modulus E0 [Pa]")
    poisson_ratio: Annotated[Number, Field(gt=-1, lt=0.5)] = Field(0.2, description="Poisson's ratio ν [1]")
    density: Positive = Field(400.0, description="initial density ρ0 [kg/m3]; in the plane [kg/m2]")
    critical_compression: Fraction = Field(
        2.5e-2, description="θc: stretches below 1 - θc become plastic [1]; smaller is more powdery"
    )
    critical_stretch: Positive = Field(
        7.5e-3, description="θs: stretches above 1 + θs become plastic [1]; smaller is more powdery"
    )
    hardening: NotNegative = Field(
        10.0, description="ξ: moduli grow as exp(ξ (1 - J_P)) [1]; larger is more brittle, 0: no hardening"
    )
    hardening_cap: Annotated[Number, Field(gt=0, le=50)] = Field(
        3.0, description="largest |ξ (1 - J_P)| [1]: beyond it moduli stay as they are"
    )


class SnowMaterial(SnowMaterialKeys):
    """[material]: complete; the defaults are those of table 7.2."""

    def problems(self) -> Iterator[Problem]:
        """Yield plastic keys of an elastic law."""
        for key in PLASTIC:
            if key in self.model_fields_set and self.law != "snow":
                yield (key,), f'belongs to law = "snow", but law is "{self.law}"'


class Shape(Table):
    """What a body and a collider share: a shape and its keys."""

    KEYS: ClassVar[Keys] = {}
    COMMON: ClassVar[tuple[str, ...]] = ()

    low: Vector | None = Field(None, description="box, height_field: corner with the smallest coordinates [m]")
    high: Vector | None = Field(None, description="box, height_field: corner with the largest coordinates [m]")
    center: Vector | None = Field(None, description="sphere, cylinder, text: middle [m]")
    radius: Positive | None = Field(None, description="sphere, cylinder: radius [m]")
    length: Positive | None = Field(None, description="cylinder: along its axis [m]; wedge: along its edge, in space")
    axis: Axis | None = Field(
        None, description="cylinder: direction of its axis, default z; wedge: of its edge, default y"
    )
    apex: Vector | None = Field(None, description="wedge: middle of its upper edge [m]")
    width: Positive | None = Field(None, description="wedge: width of its base [m]")
    height: Positive | None = Field(None, description="wedge: of the edge above its base [m]; text: of all its lines")
    text: Text | None = Field(None, description="text: the words, upright, read along x")
    thickness: Positive | None = Field(None, description="text: thickness along y [m]; in space")
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


class Shell(Table):
    """A harder and heavier shell of a body."""

    thickness: Positive = Field(description="depth below the surface [m]")
    stiffness: Positive = Field(2.0, description="factor of Young's modulus in the shell [1]")
    density: Positive = Field(1.0, description="factor of the density in the shell [1]")


class Noise(Table):
    """A noise pattern of stiffness: fracture becomes chunky."""

    size: Positive = Field(description="of the lumps [m]")
    stiffness: NotNegative = Field(
        0.5, description="s: Young's modulus varies by factors between 1/(1 + s) and 1 + s [1]"
    )
    density: NotNegative = Field(0.0, description="s: density varies by factors between 1/(1 + s) and 1 + s [1]")
    seed: Annotated[Integer, Field(ge=0)] = Field(0, description="seed of the pattern")


class Body(Shape):
    """[[body]]: snow, seeded with particles."""

    KEYS = SOLIDS
    COMMON = ("shape", "material", "per_cell", "seed", "velocity", "spin", "shell", "noise")

    shape: Literal["box", "sphere", "cylinder", "wedge", "text", "height_field", "surface"] = Field(
        description="what the body fills"
    )
    per_cell: Annotated[Integer, Field(ge=1, le=64)] = Field(8, description="particles in a cell of the grid")
    seed: Annotated[Integer, Field(ge=0)] = Field(0, description="seed of the particles' places")
    velocity: Vector | None = Field(None, description="starting velocity [m/s]")
    spin: Rotation | None = Field(
        None, description="angular velocity about the body's middle, a vector [rad/s]; in the plane a number"
    )
    material: SnowMaterialKeys = Field(
        default_factory=SnowMaterialKeys, description="keys of [material] which this body overrides"
    )
    shell: Shell | None = Field(None, description="harder, heavier shell; absent: none")
    noise: Noise | None = Field(None, description="pattern of harder and softer snow; absent: none")


class Collider(Shape):
    """[[collider]]: what snow cannot enter."""

    KEYS = COLLIDERS
    COMMON = ("shape", "friction", "sticky", "keyframes")

    shape: Literal[
        "half_space", "box", "sphere", "cylinder", "wedge", "text", "height_field", "surface", "level_sets"
    ] = Field(description="what cannot be entered")
    point: Vector | None = Field(None, description="half_space: a point of its plane [m]")
    normal: Vector | None = Field(None, description="half_space: direction out of it, of any length")
    friction: NotNegative = Field(0.0, description="coefficient of Coulomb friction μ [1]")
    sticky: Boolean = Field(False, description="snow that touches it stays (7.7)")
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
