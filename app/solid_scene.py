"""[solid] of a scene of snow: an elastic body, in the tables of a scene for `extremal elastic`."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Literal

from pydantic import Field

from .collider_scene import Collider
from .conditions_scene import Fixed, Motion, Traction
from .elastic_scene import (
    Analysis,
    ContactSettings,
    Damping,
    ElasticScene,
    Initial,
    MeshSettings,
    SolverSettings,
)
from .material_scene import Material, MaterialKeys
from .scene_fields import Boolean, FieldVector, NotNegative, Problem, Table

if TYPE_CHECKING:
    from .snow_scene import SnowScene

# of a solid, beside those of the snow
DIAGNOSTICS = (
    "solid_energy", "solid_elastic_energy", "solid_kinetic_energy", "solid_inverted", "solid_smallest_J",
    "solid_max_displacement", "solid_newton_iterations", "solid_momentum_x", "solid_momentum_y", "solid_momentum_z",
    "solid_impulse_x", "solid_impulse_y", "solid_impulse_z", "solid_smallest_gap", "solid_contact_force",
    "solid_intersections", "contact_sweeps", "total_energy", "momentum_error",
)  # fmt: skip


class Solid(Table):
    """[solid]: an elastic body which snow pushes and which pushes snow."""

    mesh: MeshSettings = Field(description="the body")
    material: Material = Field(description="its material, density included")
    regions: dict[str, MaterialKeys] = Field(default_factory=dict, description="materials of named regions")
    fixed: tuple[Fixed, ...] = Field((), description="held boundaries; none: the body is free")
    motion: tuple[Motion, ...] = Field((), description="moved boundaries")
    traction: tuple[Traction, ...] = Field((), description="tractions")
    collider: tuple[Collider, ...] = Field((), description="what the body cannot enter; it passes through the snow's")
    contact: ContactSettings | None = Field(None, description="how its colliders are met")
    damping: Damping | None = Field(None, description="damping; absent: none")
    velocity: FieldVector | None = Field(None, description="starting velocity [m/s], expressions of x, y, z [m]")
    integrator: Literal["backward_euler", "midpoint"] = Field("backward_euler", description="time integration")
    solver: SolverSettings = Field(default_factory=SolverSettings, description="when a step counts as solved")
    friction: NotNegative = Field(0.0, description="coefficient of Coulomb friction μ between it and snow [1]")
    sticky: Boolean = Field(False, description="snow that touches it neither slides nor leaves it (7.7)")

    def problems(self) -> Iterator[Problem]:
        """Yield what is wrong about friction."""
        if self.sticky and "friction" in self.model_fields_set:
            yield ("friction",), "has no effect where sticky = true; leave one of them out"

    def elastic(self, scene: SnowScene) -> ElasticScene:
        """Return the scene of the body alone, with the gravity and the times of `scene`."""
        own = ("velocity", "integrator", "friction", "sticky")
        times = scene.analysis
        out = ElasticScene(
            **{key: getattr(self, key) for key in type(self).model_fields if key not in own},
            gravity=scene.gravity,
            initial=Initial(velocity=self.velocity),
            analysis=Analysis(
                type="dynamic", integrator=self.integrator, end_time=times.end_time, time_step=times.time_step
            ),
        )
        out._path, out._source = scene._path, dict(scene._source.get("solid", {}))
        return out
