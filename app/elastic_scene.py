"""The tables of a scene for `extremal elastic`: every key, its unit, its default and what it may be."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import ConfigDict, Field

from .collider_scene import Collider
from .conditions_scene import Axis, Fixed, Gravity, Motion, Pressure, Traction
from .errors import suggestion
from .material_scene import Material, MaterialKeys, merged
from .scene_common import Expected, PetscValue, Scene, Where
from .scene_fields import (
    Boolean,
    FieldVector,
    Integer,
    NotNegative,
    Number,
    Positive,
    Problem,
    Rotation,
    Table,
    Text,
    Vector,
    vector,
)

Counts = Annotated[tuple[Annotated[Integer, Field(ge=1)], ...], vector("whole numbers")]
CELL_FIELDS = ("J", "smallest_stretch", "von_mises", "energy_density", "inverted", "region")
POINT_FIELDS = ("displacement", "velocity")
DIAGNOSTICS = (
    "time", "energy", "elastic_energy", "kinetic_energy", "inverted", "smallest_J", "smallest_stretch",
    "residual", "newton_iterations", "krylov_iterations", "svd_skipped", "max_displacement",
    "smallest_gap", "contact_force", "intersections",
)  # fmt: skip


class Body(Table):
    """[[mesh.body]]: a body of the mesh's shape, or a lattice of them."""

    name: Text | None = Field(
        None, description="its regions and boundaries are called NAME_...; default: as the shape says, also of several"
    )
    translation: Vector | None = Field(None, description="of the first body [m]; default: where the mesh is")
    rotation: Rotation | None = Field(
        None, description="rotation vector [rad] about the middle of the mesh; in the plane one angle, or [0, 0, angle]"
    )
    count: Counts | None = Field(None, description="bodies along each axis; default: one")
    spacing: Vector | None = Field(None, description="from one body to the next along each axis [m]")
    tumbled: Annotated[Integer, Field(ge=0)] | None = Field(
        None, description="turn each body at random besides; seed of the random numbers"
    )

    def problems(self) -> Iterator[Problem]:
        """Yield a lattice without size and names that others cannot write."""
        if self.name is not None and not re.fullmatch(r"[A-Za-z][A-Za-z0-9_]*", self.name):
            yield ("name",), "must begin with a letter and have letters, digits and _ only"
        if (self.count is None) != (self.spacing is None):
            missing, given = ("spacing", "count") if self.spacing is None else ("count", "spacing")
            yield (missing,), f"is missing; {given} needs it"


class MeshSettings(Table):
    """[mesh]: a named shape with its parameters, or a file."""

    # A shape's own parameters (size, radius ...) are known to `meshes`.
    model_config = ConfigDict(frozen=True, extra="allow")

    shape: Text | None = Field(None, description="name of a generated shape: box, bar, sphere ...")
    file: Text | None = Field(None, description="mesh file, relative to the scene's folder")
    cell_size: Positive | None = Field(None, description="target length of an edge [m]")
    order: Literal[1, 2] = Field(1, description="1: straight cells, 2: curved cells with nodes on the edges")
    body: tuple[Body, ...] = Field((), description="several bodies of this shape; absent: one, where the shape says")

    @property
    def parameters(self) -> dict[str, Any]:
        """The parameters of the shape given in the scene, cell_size and order among them."""
        return {key: value for key, value in self.given().items() if key not in ("shape", "file", "body")}

    def given(self) -> dict[str, Any]:
        """Return the keys the scene file gives."""
        return super().given() | (self.model_extra or {})

    def problems(self) -> Iterator[Problem]:
        """Yield what is wrong between the keys."""
        if self.shape is not None and self.file is not None:
            yield ("file",), "given together with shape; leave one of them out"
        if self.shape is None and self.file is None:
            yield ("shape",), 'is missing; give a shape as shape = "box" or a mesh file as file = "body.msh"'
        if self.file is not None:
            if self.file.endswith((".geo", ".geo_unrolled")):
                yield (
                    ("file",),
                    "gmsh scripts can run commands and are refused; give the mesh (.msh) made from it",
                )
            for key in self.model_extra or {}:
                yield (
                    (key,),
                    "unknown key for a mesh file; " + suggestion(key, ("file", "cell_size", "order")),
                )
        elif self.shape is not None:
            from .shapes import shape_problems

            yield from shape_problems(self.shape, self.parameters)


class ElementSettings(Table):
    """[element]: the approximation of the displacement."""

    degree: Literal[1, 2] = Field(1, description="degree of the displacement's polynomials")


class Damping(Table):
    """[damping]: Rayleigh damping."""

    mass: NotNegative = Field(0.0, description="factor of the mass matrix [1/s]")
    stiffness: NotNegative = Field(0.0, description="factor of the stiffness matrix [s]")

    def problems(self) -> Iterator[Problem]:
        """Yield a table without effect."""
        if self.mass == 0 and self.stiffness == 0:
            yield ("mass",), "is missing; give mass [1/s] or stiffness [s] above 0, or leave [damping] out"


STATE_KEYS = {
    "rest": (),
    "scatter": ("seed", "amplitude"),
    "collapse": ("seed", "to", "noise", "axis"),
    "mirror": ("axis",),
}


class Initial(Table):
    """[initial]: where the nodes start."""

    state: Literal["rest", "scatter", "collapse", "mirror"] = Field("rest", description="starting positions")
    seed: Annotated[Integer, Field(ge=0)] = Field(0, description="seed of the random numbers")
    amplitude: Positive = Field(
        1.0, description="scatter: the bounding box grown by this factor is filled at random [1]"
    )
    to: Literal["point", "line", "plane"] = Field("point", description="collapse: onto what")
    noise: NotNegative = Field(
        0.0, description="collapse: random displacement relative to the body's size [1]"
    )
    axis: Axis = Field("x", description="mirror: direction reflected; line: its direction; plane: its normal")
    velocity: FieldVector | None = Field(
        None, description="starting velocity [m/s], expressions of x, y, z [m]; dynamic only"
    )

    def problems(self) -> Iterator[Problem]:
        """Yield keys which the state does not use."""
        for key in ("seed", "amplitude", "to", "noise", "axis"):
            if key in self.model_fields_set and key not in STATE_KEYS[self.state]:
                owners = " or ".join(f'"{state}"' for state, keys in STATE_KEYS.items() if key in keys)
                yield (key,), f'belongs to state = {owners}, but state is "{self.state}"'
        if self.state == "collapse" and self.to == "point" and "axis" in self.model_fields_set:
            yield ("axis",), 'belongs to to = "line" or "plane", but to is "point"'


class Analysis(Table):
    """[analysis]: static load steps or motion in time."""

    type: Literal["static", "dynamic"] = Field(
        "static", description="static: load steps; dynamic: with inertia"
    )
    end_time: Positive = Field(1.0, description="time [s] (static: load parameter) at which the run ends")
    time_step: Positive = Field(
        default_factory=lambda data: data.get("end_time", 1.0), description="first step [s]; default end_time"
    )
    smallest_step: Positive = Field(
        default_factory=lambda data: data.get("time_step", 1.0) / 1024,
        description="step [s] below which a failing run gives up; default time_step/1024",
    )
    adaptive: Boolean = Field(
        True, description="shorten a failed step and try again, lengthen after easy ones"
    )
    integrator: Literal["backward_euler", "bdf2", "midpoint", "newmark"] = Field(
        "backward_euler", description="dynamic: time integration"
    )
    error_tolerance: Positive | None = Field(
        None, description="dynamic: local error [m] up to which a step is accepted; default: no such control"
    )
    largest_step: Positive = Field(
        default_factory=lambda data: data.get(
            "end_time" if data.get("type") == "static" or data.get("error_tolerance") else "time_step", 1.0
        ),
        description="steps never exceed this [s]; default end_time, in dynamics without error_tolerance time_step",
    )

    def problems(self) -> Iterator[Problem]:
        """Yield what is wrong between the steps."""
        if self.time_step > self.end_time:
            yield ("time_step",), f"must not be above end_time = {self.end_time:g}"
        if self.smallest_step > self.time_step:
            yield ("smallest_step",), f"must not be above time_step = {self.time_step:g}"
        if "largest_step" in self.model_fields_set and self.largest_step < self.time_step:
            yield ("largest_step",), f"must not be below time_step = {self.time_step:g}"
        if self.type == "static":
            for key in ("integrator", "error_tolerance"):
                if key in self.model_fields_set:
                    yield (key,), 'belongs to type = "dynamic", but type is "static"'
        if not self.adaptive and self.error_tolerance is not None:
            yield ("error_tolerance",), "needs adaptive = true"


class ContactSettings(Table):
    """[contact]: how the body meets its colliders, itself and other bodies."""

    self: Boolean = Field(False, description="no parts of the surface, of one body or of several, cross each other")
    friction: NotNegative = Field(
        0.0, description="coefficient of Coulomb friction of the surface with itself [1]; colliders have their own"
    )
    distance: Positive | None = Field(
        None, description="distance below which what is met pushes [m]; default a tenth of the mean edge of cells"
    )
    stiffness: Positive = Field(
        1.0, description="c of the barrier's stiffness c E/distance [1]; larger is harder, and harder to solve"
    )
    after: Literal["untangled"] | None = Field(
        None,
        description="begin when no element is inverted, no node inside a collider, no surface cut; default: at once",
    )

    def problems(self) -> Iterator[Problem]:
        """Yield friction that nothing feels."""
        if self.friction > 0 and not self.self:
            yield ("friction",), "needs self = true; colliders have a friction of their own"


class Continuation(Table):
    """[continuation]: solve easier problems first. This is ours, not the source's."""

    poisson_ratio: tuple[Annotated[Number, Field(gt=-1, lt=0.5)], ...] = Field(
        (), description="Poisson's ratios solved one after another before the material's own [1]"
    )
    threshold: tuple[Annotated[Number, Field(gt=0, lt=1)], ...] = Field(
        (), description="thresholds of the extension solved one after another before the material's own [1]"
    )

    def problems(self) -> Iterator[Problem]:
        """Yield a table without effect."""
        if not self.poisson_ratio and not self.threshold:
            yield (
                ("poisson_ratio",),
                "is missing; give stages as poisson_ratio = [0.3], or leave [continuation] out",
            )


class SolverSettings(Table):
    """[solver]: when a step counts as solved; everything else is a PETSc option."""

    tolerance: Annotated[Number, Field(gt=0, lt=1)] = Field(
        1e-8, description="largest residual force relative to the problem's scale of force [1]"
    )
    iterations: Annotated[Integer, Field(ge=1, le=1_000_000)] = Field(
        150, description="most Newton iterations in a step"
    )
    tangent: Literal["projected", "exact"] = Field(
        "projected",
        description="projected: positive tangent while far from the solution; exact: never projected",
    )


class OutputSettings(Table):
    """[output]: what is written, and how often."""

    every: Positive | None = Field(None, description="time [s] between frames; default: every step")
    iterations: Annotated[Integer, Field(ge=1)] | None = Field(
        None, description="static: also a frame each so many solver iterations"
    )
    fields: tuple[Literal[CELL_FIELDS + POINT_FIELDS], ...] | None = Field(  # type: ignore[valid-type]
        None, description="fields written; default: all"
    )
    checkpoint_every: Annotated[Integer, Field(ge=1)] = Field(10, description="steps between checkpoints")
    summary: Boolean = Field(True, description="draw summary.png at the end")


class ElasticScene(Scene):
    """A scene for `extremal elastic`."""

    title: Text = Field("", description="what the scene shows, in a line")
    part: Literal["elastic"] = Field("elastic", description="which command runs it")
    mesh: MeshSettings = Field(description="the body")
    material: Material = Field(description="the material, everywhere unless a region overrides it")
    regions: dict[str, MaterialKeys] = Field(default_factory=dict, description="materials of named regions")
    element: ElementSettings = Field(default_factory=ElementSettings, description="approximation")
    fixed: tuple[Fixed, ...] = Field((), description="held boundaries")
    motion: tuple[Motion, ...] = Field((), description="moved boundaries")
    traction: tuple[Traction, ...] = Field((), description="tractions")
    pressure: tuple[Pressure, ...] = Field((), description="pressures")
    gravity: Gravity | None = Field(None, description="gravity; absent: none")
    collider: tuple[Collider, ...] = Field((), description="what the body cannot enter; absent: nothing")
    contact: ContactSettings | None = Field(None, description="how colliders are met")
    damping: Damping | None = Field(None, description="damping; absent: none")
    initial: Initial = Field(default_factory=Initial, description="start")
    analysis: Analysis = Field(default_factory=Analysis, description="what is solved")
    continuation: Continuation | None = Field(None, description="easier problems solved first; absent: none")
    solver: SolverSettings = Field(default_factory=SolverSettings, description="solver")
    petsc: dict[str, PetscValue] = Field(default_factory=dict, description="PETSc options, without the dash")
    output: OutputSettings = Field(default_factory=OutputSettings, description="output")
    expect: dict[str, Expected] = Field(
        default_factory=dict, description="what the final diagnostics must be"
    )

    @property
    def mesh_file(self) -> Path | None:
        """The mesh file, found from the scene's folder."""
        if self.mesh.file is None:
            return None
        return self.beside(self.mesh.file)

    def files(self) -> Iterator[tuple[Where, Path]]:
        """Yield the mesh file, if there is one, and those of colliders."""
        if self.mesh_file is not None:
            yield ("mesh", "file"), self.mesh_file
        for i, entry in enumerate(self.collider):
            if entry.file is not None:
                yield ("collider", i, "file"), self.beside(entry.file)

    @property
    def dimension(self) -> int | None:
        """2 or 3 where the shape tells, None for a mesh file (known once it is read)."""
        if self.mesh.shape is None:
            return None
        from .shapes import shape_dimension

        return shape_dimension(self.mesh.shape, self.mesh.parameters)

    def material_of(self, region: str) -> Material:
        """Return the material of a region: [material] overridden by [regions.NAME] where there is one."""
        if region not in self.regions:
            return self.material
        return Material(**merged(self.material, self.regions[region]))
