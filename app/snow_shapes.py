"""[material] and [[body]] of a scene for `extremal snow`."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, Literal

from pydantic import Field

from .collider_scene import SOLIDS, Shape
from .scene_fields import Integer, NotNegative, Number, Positive, Problem, Rotation, Table, Vector

Law = Literal["snow", "fixed_corotated", "neo_hookean"]
PLASTIC = ("critical_compression", "critical_stretch", "hardening", "hardening_cap")
Fraction = Annotated[Number, Field(gt=0, lt=1)]


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

    shape: Literal["box", "sphere", "cylinder", "tube", "bowl", "gear", "wedge", "text", "height_field", "surface"] = (
        Field(description="what the body fills")
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
