"""Checks between the tables of an elastic scene, and of a scene against the mesh it is put on."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING, Any

from pydantic import ValidationError

from .collider_scene import shape_dimension
from .errors import InputError, suggestion
from .material_scene import Material, merged
from .scene_common import Check, Where, expectations, petsc_names
from .scene_fields import Problem

if TYPE_CHECKING:
    from .elastic_scene import ElasticScene


def check_on_mesh(
    scene: ElasticScene, boundary_names: Iterable[str], region_names: Iterable[str], dimension: int
) -> None:
    """Check what only the mesh can tell: names of boundaries and regions, and the number of components.

    Parameters
    ----------
    scene : ElasticScene
    boundary_names, region_names : iterable of str
        Those of the mesh.
    dimension : int
        2 or 3.

    Raises
    ------
    InputError
        With one line for each thing wrong.
    """
    found = [*_boundaries(scene, tuple(boundary_names)), *_dimension(scene, dimension)]
    regions = tuple(region_names)
    for name in scene.regions:
        if name not in regions:
            found.append(
                (("regions", name), "the mesh has no region of this name; " + suggestion(name, regions))
            )
    _refuse(scene, found)


def check_bodies(scene: ElasticScene, dimension: int) -> None:
    """Check the number of components of [[mesh.body]], 2 or 3; raises InputError as above."""
    _refuse(scene, [*_bodies(scene, dimension)])


def _refuse(scene: ElasticScene, found: list[Problem]) -> None:
    from .scene_errors import problem_line

    if found:
        file = str(scene.path or "scene")
        raise InputError(*(problem_line(file, scene._source, where, message) for where, message in found))


def _materials(scene: ElasticScene) -> Iterator[Problem]:
    for name, region in scene.regions.items():
        try:
            Material(**merged(scene.material, region))
        except ValidationError as error:
            for detail in error.errors():
                for where, message in detail.get("ctx", {}).get("found", [((), detail["msg"])]):
                    yield ("regions", name, *where), message + " (with what [material] gives)"


def _densities(scene: ElasticScene) -> Iterator[Problem]:
    why = None
    if scene.analysis.type == "dynamic":
        why = 'type = "dynamic"'
    elif scene.gravity is not None:
        why = "[gravity]"
    if why is not None and scene.material.density is None:
        yield ("material", "density"), f"is missing; {why} needs it [kg/m3]"


def _analysis(scene: ElasticScene) -> Iterator[Problem]:
    if scene.analysis.type == "static":
        if scene.damping is not None:
            yield ("damping",), 'needs [analysis] type = "dynamic"'
        if scene.initial.velocity is not None:
            yield ("initial", "velocity"), 'needs [analysis] type = "dynamic"'
    elif scene.output.iterations is not None:
        yield ("output", "iterations"), 'needs [analysis] type = "static"'
    end = scene.analysis.end_time
    if scene.output.every is not None and scene.output.every > end:
        yield ("output", "every"), f"must not be above [analysis] end_time = {end:g}"


def _continuation(scene: ElasticScene) -> Iterator[Problem]:
    if scene.continuation is None:
        return
    for key in ("poisson_ratio", "threshold"):
        stages = getattr(scene.continuation, key)
        if stages and key == "poisson_ratio" and scene.material.poisson_ratio is None:
            yield ("continuation", key), "needs [material] poisson_ratio (not lame_lambda)"
        if stages and key == "threshold" and scene.material.extension == "none":
            yield ("continuation", key), 'has no meaning with [material] extension = "none"'
    stages = scene.continuation.poisson_ratio
    final = scene.material.poisson_ratio
    for i, stage in enumerate(stages):
        if isinstance(final, float) and stage >= final:
            yield ("continuation", "poisson_ratio", i), f"must be below [material] poisson_ratio = {final:g}"


def _contact(scene: ElasticScene) -> Iterator[Problem]:
    surface = scene.contact is not None and scene.contact.self
    if "intersections" in scene.expect and not surface:
        yield ("expect", "intersections"), "needs [contact] self = true"
    if scene.collider or surface:
        return
    if scene.contact is not None:
        yield ("contact",), "has no effect without [[collider]] or self = true"
    for name in ("smallest_gap", "contact_force"):
        if name in scene.expect:
            yield ("expect", name), "needs [[collider]] or [contact] self = true"


def _plane_or_space(scene: ElasticScene) -> Iterator[Problem]:
    if scene.dimension is not None:
        yield from _bodies(scene, scene.dimension)
        yield from _dimension(scene, scene.dimension)


def _bodies(scene: ElasticScene, d: int) -> Iterator[Problem]:
    for i, one in enumerate(scene.mesh.body):
        for key in ("translation", "count", "spacing"):
            value = getattr(one, key)
            if value is not None and len(value) != d:
                yield ("mesh", "body", i, key), f"must have {d} components: the body is {d}-dimensional"
        yield from _turn(("mesh", "body", i, "rotation"), one.rotation, d)


def _turn(where: Where, rotation: float | tuple[float, ...] | None, d: int) -> Iterator[Problem]:
    if rotation is None or (d == 3 and isinstance(rotation, tuple)):
        return
    if d == 2 and (isinstance(rotation, float) or rotation[:2] == (0, 0)):
        return
    accepted = "a rotation vector of 3 entries" if d == 3 else "one angle [rad], or [0, 0, angle]"
    yield where, f"must be {accepted}: the body is {d}-dimensional"


def _dimension(scene: ElasticScene, d: int) -> Iterator[Problem]:
    vectors: list[tuple[Where, tuple[Any, ...] | None]] = []
    vectors += [(("traction", i, "value"), entry.value) for i, entry in enumerate(scene.traction)]
    vectors += [(("motion", i, "displacement"), entry.displacement) for i, entry in enumerate(scene.motion)]
    for i, motion in enumerate(scene.motion):
        for k, frame in enumerate(motion.keyframes or ()):
            vectors += [
                (("motion", i, "keyframes", k, key), getattr(frame, key)) for key in ("translation", "center")
            ]
            yield from _turn(("motion", i, "keyframes", k, "rotation"), frame.rotation, d)
    if scene.gravity is not None:
        vectors.append((("gravity", "acceleration"), scene.gravity.acceleration))
    vectors.append((("initial", "velocity"), scene.initial.velocity))
    for where, value in vectors:
        if value is not None and len(value) != d:
            yield where, f"must have {d} components: the body is {d}-dimensional"
    for i, collider in enumerate(scene.collider):
        yield from shape_dimension(("collider", i), collider, d, "body", "does not exist in the plane")
    if d == 3:
        return
    for i, fixed in enumerate(scene.fixed):
        if "components" in fixed.model_fields_set and "z" in fixed.components:
            yield ("fixed", i, "components"), 'has no "z": the body is 2-dimensional'
    if scene.initial.state == "mirror" and scene.initial.axis == "z":
        yield ("initial", "axis"), 'must be "x" or "y": the body is 2-dimensional'
    energies: list[tuple[Where, str | None]] = [(("material", "energy"), scene.material.energy)]
    energies += [(("regions", name, "energy"), region.energy) for name, region in scene.regions.items()]
    for where, energy in energies:
        for symbol in ("i2", "I2", "s3"):
            if energy is not None and re.search(rf"\b{symbol}\b", energy):
                yield where, f"{symbol} does not exist in 2 dimensions; use i1, J, I1 or s1, s2"


def _known_boundaries(scene: ElasticScene) -> Iterator[Problem]:
    if scene.mesh.shape is None:
        return
    from .shapes import shape_boundaries

    known = shape_boundaries(scene.mesh.shape, scene.mesh.parameters)
    if known is not None:
        names = {one.name for one in scene.mesh.body} or {None}
        named = (f"{name}_{each}" if name else each for name in names for each in known if each != "surface")
        yield from _boundaries(scene, (*named, "surface"))


def _boundaries(scene: ElasticScene, known: tuple[str, ...]) -> Iterator[Problem]:
    for table in ("fixed", "motion", "traction", "pressure"):
        for i, entry in enumerate(getattr(scene, table)):
            for name in entry.boundary or ():
                if name not in known:
                    yield (table, i, "boundary"), f'the mesh has no "{name}"; ' + suggestion(name, known)


def _expectations(scene: ElasticScene) -> Iterator[Problem]:
    from .elastic_scene import DIAGNOSTICS

    yield from expectations(scene.expect, DIAGNOSTICS)


CHECKS: tuple[Check, ...] = (
    ({"material", "regions"}, _materials),
    ({"material", "analysis", "gravity"}, _densities),
    ({"analysis", "damping", "initial", "output"}, _analysis),
    ({"material", "continuation"}, _continuation),
    ({"mesh"}, _plane_or_space),
    ({"mesh"}, _known_boundaries),
    ({"collider", "contact", "expect"}, _contact),
    (set(), petsc_names),
    (set(), _expectations),
)
