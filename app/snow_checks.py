"""Checks between the tables of a snow scene."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

from pydantic import ValidationError

from .collider_scene import shape_dimension
from .scene_common import Check, expectations, petsc_names
from .scene_fields import Problem

if TYPE_CHECKING:
    from .snow_scene import SnowScene

PLANE = "does not exist in the plane ([grid] dimension = 2)"


def _materials(scene: SnowScene) -> Iterator[Problem]:
    for i, body in enumerate(scene.body):
        try:
            scene.material_of(body)
        except ValidationError as error:
            for detail in error.errors():
                for where, message in detail.get("ctx", {}).get("found", [((), detail["msg"])]):
                    yield ("body", i, "material", *where), message + " (with what [material] gives)"


def _sizes(scene: SnowScene) -> Iterator[Problem]:
    h = scene.cell_size
    for i, body in enumerate(scene.body):
        if body.shell is not None and body.shell.thickness < h:
            yield ("body", i, "shell", "thickness"), f"must not be below a cell of the grid, {h:g} m"
        if body.noise is not None and body.noise.size < h:
            yield ("body", i, "noise", "size"), f"must not be below a cell of the grid, {h:g} m"


def _plane_or_space(scene: SnowScene) -> Iterator[Problem]:
    d = scene.dimension
    for table in ("body", "collider"):
        for i, entry in enumerate(getattr(scene, table)):
            yield from shape_dimension((table, i), entry, d, "grid", PLANE)
    if scene.gravity is not None and len(scene.gravity.acceleration) != d:
        yield ("gravity", "acceleration"), f"must have {d} components: the grid is {d}-dimensional"


def _frames(scene: SnowScene) -> Iterator[Problem]:
    end = scene.analysis.end_time
    if "every" in scene.output.model_fields_set and scene.output.every > end:
        yield ("output", "every"), f"must not be above [analysis] end_time = {end:g}"


def _volumes(scene: SnowScene) -> Iterator[Problem]:
    if scene.output.vdb and scene.dimension == 2:
        yield ("output", "vdb"), "needs [grid] dimension = 3: OpenVDB holds volumes"


def _expectations(scene: SnowScene) -> Iterator[Problem]:
    from .snow_scene import DIAGNOSTICS

    yield from expectations(scene.expect, DIAGNOSTICS)


CHECKS: tuple[Check, ...] = (
    ({"material", "body"}, _materials),
    ({"grid", "body"}, _sizes),
    ({"grid"}, _plane_or_space),
    ({"analysis", "output"}, _frames),
    ({"grid", "output"}, _volumes),
    (set(), petsc_names),
    (set(), _expectations),
)
