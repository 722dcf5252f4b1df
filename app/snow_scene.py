"""The tables of a scene for `extremal snow`: every key, its unit, its default and what it may be."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field

from .collider_scene import Collider
from .conditions_scene import Gravity
from .scene_common import Expected, PetscValue, Scene, Where
from .scene_fields import Boolean, Integer, Number, Positive, Problem, Table, Text
from .snow_shapes import PLASTIC, Body, SnowMaterial
from .solid_scene import Solid

PARTICLE_FIELDS = ("velocity", "J_P", "stretch", "density", "mass", "body", "stiffness")
GRADIENTS = ("elastic_gradient", "plastic_gradient")
LARGEST_SCALE = 100.0
DIAGNOSTICS = (
    "time", "particles", "mass", "momentum_x", "momentum_y", "momentum_z", "angular_momentum_x",
    "angular_momentum_y", "angular_momentum_z", "kinetic_energy", "elastic_energy", "gravitational_energy",
    "plastic_dissipation", "energy", "largest_speed", "krylov_iterations", "dt", "active_nodes", "imbalance",
)  # fmt: skip


class Grid(Table):
    """[grid]: the background grid; it is unbounded."""

    cell_size: Positive = Field(description="edge of a cell h [m], where scale is 1")
    spline: Literal["cubic", "quadratic"] = Field("cubic", description="B-splines between particles and nodes")
    dimension: Literal[2, 3] = Field(3, description="2: in the plane")
    volumes: Literal["measured", "seeded"] = Field(
        "measured",
        description="of particles at rest: measured on the grid by the first step (7.3.1), too large at surfaces; "
        "or h^d/per_cell as seeded, exact",
    )
    imbalance: Annotated[Number, Field(gt=1)] = Field(
        1.3, description="particles of the fullest rank over the mean at which ranks share anew [1]"
    )


class SnowAnalysis(Table):
    """[analysis]: steps in time."""

    end_time: Positive = Field(description="time at which the run ends [s]")
    time_step: Positive = Field(
        default_factory=lambda data: min(5e-4, data.get("end_time", 1.0)), description="first step [s]; default 5e-4"
    )
    adaptive: Boolean = Field(
        True, description="shorten steps where particles are fast, gradients steep, or an explicit step unstable"
    )
    cfl: Annotated[Number, Field(gt=0, le=1)] = Field(
        0.5, description="adaptive: largest part of a cell that a particle crosses in a step [1]"
    )
    smallest_step: Positive = Field(
        default_factory=lambda data: data.get("time_step", 5e-4) / 1024,
        description="step [s] below which a failing run gives up; default time_step/1024",
    )
    largest_step: Positive = Field(
        default_factory=lambda data: data.get("time_step", 5e-4),
        description="steps never exceed this [s]; default time_step",
    )
    beta: Annotated[Number, Field(ge=0, le=1)] = Field(
        1.0, description="β of (7.9): 0 explicit, 0.5 trapezoidal, 1 backward Euler [1]"
    )
    flip: Annotated[Number, Field(ge=0, le=1)] = Field(
        0.95, description="α, the FLIP part of a particle's new velocity; the rest is PIC [1]"
    )
    precision: Literal["double", "single"] = Field(
        "double", description="of the implicit operator; single is faster"
    )

    def problems(self) -> Iterator[Problem]:
        """Yield what is wrong between the steps."""
        if self.time_step > self.end_time:
            yield ("time_step",), f"must not be above end_time = {self.end_time:g}"
        if self.smallest_step > self.time_step:
            yield ("smallest_step",), f"must not be above time_step = {self.time_step:g}"
        if self.largest_step < self.time_step:
            yield ("largest_step",), f"must not be below time_step = {self.time_step:g}"
        if not self.adaptive and "cfl" in self.model_fields_set:
            yield ("cfl",), "needs adaptive = true"
        if self.beta == 0 and "precision" in self.model_fields_set:
            yield ("precision",), "has no effect on explicit steps (beta = 0)"


class SnowOutput(Table):
    """[output]: what is written, and how often."""

    every: Positive = Field(1 / 24, description="time [s] between frames; default: 24 in a second")
    fields: tuple[Literal[PARTICLE_FIELDS + GRADIENTS], ...] | None = Field(  # type: ignore[valid-type]
        None, description="fields of the particles written; default: all but the gradients F_E and F_P"
    )
    vdb: Boolean = Field(False, description="also the density on the grid, as OpenVDB, one file a frame")
    checkpoint_every: Annotated[Integer, Field(ge=1)] = Field(500, description="steps between checkpoints")
    summary: Boolean = Field(True, description="draw summary.png at the end")


class SnowScene(Scene):
    """A scene for `extremal snow`."""

    title: Text = Field("", description="what the scene shows, in a line")
    part: Literal["snow"] = Field(description="which command runs it")
    scale: Annotated[Number, Field(gt=0, le=LARGEST_SCALE)] = Field(
        1.0, description="cells are this many times finer, particles as many times more in each direction [1]"
    )
    grid: Grid = Field(description="the background grid")
    material: SnowMaterial = Field(
        default_factory=SnowMaterial, description="the snow, in every body unless the body overrides it"
    )
    body: tuple[Body, ...] = Field(min_length=1, description="bodies of snow")
    collider: tuple[Collider, ...] = Field((), description="what snow collides with; absent: nothing")
    solid: Solid | None = Field(
        None, description="an elastic body; snow and body push each other. Absent: none"
    )
    gravity: Gravity | None = Field(None, description="gravity; absent: none")
    analysis: SnowAnalysis = Field(description="steps in time")
    petsc: dict[str, PetscValue] = Field(default_factory=dict, description="PETSc options, without the dash")
    output: SnowOutput = Field(default_factory=SnowOutput, description="output")
    expect: dict[str, Expected] = Field(default_factory=dict, description="what the final diagnostics must be")

    @property
    def dimension(self) -> int:
        """2 or 3."""
        return self.grid.dimension

    @property
    def cell_size(self) -> float:
        """Edge of a cell [m] at the scene's scale."""
        return self.grid.cell_size / self.scale

    def material_of(self, body: Body) -> SnowMaterial:
        """Return the material of a body: [material] overridden by the body's own."""
        new = body.material.given()
        old = self.material.given()
        if new.get("law", self.material.law) != "snow":
            old = {key: value for key, value in old.items() if key not in PLASTIC}
        return SnowMaterial(**old | new)

    def files(self) -> Iterator[tuple[Where, Path]]:
        """Yield the surface meshes and level sets."""
        for table in ("body", "collider"):
            for i, entry in enumerate(getattr(self, table)):
                if entry.file is not None:
                    yield (table, i, "file"), self.beside(entry.file)
        if self.solid is not None:
            for where, path in self.solid.elastic(self).files():
                yield ("solid", *where), path
