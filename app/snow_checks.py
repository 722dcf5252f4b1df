"""Checks between the tables of a snow scene."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

from pydantic import ValidationError

from . import elastic_checks
from .collider_scene import shape_dimension
from .scene_common import Check, cross_checks, expectations, petsc_names
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


def _solid(scene: SnowScene) -> Iterator[Problem]:
    if scene.solid is None:
        return
    alone = scene.solid.elastic(scene)
    for where, message in cross_checks(alone, elastic_checks.CHECKS):
        keys = where[1:] if where[0] == "initial" else where
        if keys[0] in type(scene.solid).model_fields:  # the rest is the snow's, which has its own checks
            yield ("solid", *keys), message.replace('type = "dynamic"', "what moves")
    meets_itself = scene.solid.contact is not None and scene.solid.contact.self
    if "solid_intersections" in scene.expect and not meets_itself:
        yield ("expect", "solid_intersections"), "needs [solid.contact] self = true"
    for name in ("solid_smallest_gap", "solid_contact_force"):
        if name in scene.expect and not (scene.solid.collider or meets_itself):
            yield ("expect", name), "needs [[solid.collider]] or [solid.contact] self = true"
    if alone.dimension not in (None, scene.dimension):
        yield ("solid", "mesh"), f"is {alone.dimension}-dimensional; must be {scene.dimension}-dimensional, as the grid"


def _expectations(scene: SnowScene) -> Iterator[Problem]:
    from .snow_scene import DIAGNOSTICS
    from .solid_scene import DIAGNOSTICS as OF_SOLIDS

    if scene.solid is None:
        for name in scene.expect:
            if name in OF_SOLIDS:
                yield ("expect", name), "needs [solid]"
    yield from expectations(scene.expect, (*DIAGNOSTICS, *OF_SOLIDS))


CHECKS: tuple[Check, ...] = (
    ({"material", "body"}, _materials),
    ({"grid", "body"}, _sizes),
    ({"grid"}, _plane_or_space),
    ({"analysis", "output"}, _frames),
    ({"grid", "output"}, _volumes),
    ({"solid", "grid", "gravity", "analysis", "expect"}, _solid),
    (set(), petsc_names),
    (set(), _expectations),
)
