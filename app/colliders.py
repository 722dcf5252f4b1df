"""From the [[collider]] of a scene, for snow and for elastic solids, to obstacles."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from numpy.typing import NDArray

from extremal.obstacles.colliders import Collider, Contact, Rigid
from extremal.obstacles.deforming import DeformingLevelSet
from extremal.obstacles.gear import Gear
from extremal.obstacles.geometry import BodyError
from extremal.obstacles.height_field import HeightField
from extremal.obstacles.hollow import Bowl, Tube
from extremal.obstacles.motion import RigidMotion
from extremal.obstacles.shapes import Box, Cylinder, HalfSpace, Sphere, Wedge

from .errors import InputError

if TYPE_CHECKING:
    from . import collider_scene
    from .conditions_scene import Keyframe
    from .scene_common import Scene


def colliders(scene: Scene, tables: Sequence[collider_scene.Collider], d: int) -> list[Collider]:
    """What bodies in `d` dimensions collide with, in the scene's order; raises InputError."""
    return [made(scene, "collider", i, partial(_collider, scene, table, d)) for i, table in enumerate(tables)]


def _collider(scene: Scene, collider: collider_scene.Collider, d: int) -> Collider:
    contact = Contact(collider.friction, collider.sticky)
    if collider.shape == "level_sets":
        assert collider.file is not None
        return _level_sets(str(scene.beside(collider.file)), contact)
    motion = None if collider.keyframes is None else _motion(collider.keyframes, d)
    return Rigid(shape_of(scene, collider, d), contact, motion)


def _motion(frames: tuple[Keyframe, ...], d: int) -> RigidMotion:
    def table(key: str) -> NDArray:
        return np.array([getattr(frame, key) or (0.0,) * d for frame in frames])

    turns = np.array([turn(frame.rotation or 0.0) for frame in frames])
    return RigidMotion([frame.time for frame in frames], table("translation"), turns, table("center"), dimension=d)


def _level_sets(path: str, contact: Contact) -> DeformingLevelSet:
    wanted = ("times", "phi", "velocity", "origin", "spacing")
    try:
        with np.load(path, allow_pickle=False) as file:
            arrays = {name: file[name] for name in wanted}
    except (OSError, ValueError, KeyError) as error:
        words = (str(error).splitlines() or [""])[0]
        raise BodyError(f"cannot be read ({words}); accepted is an NPZ file with {', '.join(wanted)}") from None
    return DeformingLevelSet(**{**arrays, "spacing": float(arrays["spacing"])}, contact=contact)


def shape_of(scene: Scene, table: collider_scene.Shape, d: int) -> Any:
    """The shape that a table describes."""
    t = cast(Any, table)  # which keys are there has been checked
    axis = None if t.axis is None else np.eye(3)["xyz".index(t.axis)]
    if t.shape == "box":
        return Box(t.low, t.high)
    if t.shape == "sphere":
        return Sphere(t.center, t.radius)
    if t.shape == "cylinder":
        return Cylinder(t.center, t.radius, t.length, (0, 0, 1) if axis is None else axis)
    if t.shape == "tube":
        along = None if axis is None else axis[:d]
        return Tube(t.center, t.radius, t.thickness, t.length, along, t.flare)
    if t.shape == "bowl":
        return Bowl(t.center, t.radius, t.thickness)
    if t.shape == "gear":
        return Gear(t.center, t.radius, t.teeth, t.depth, t.length, (0, 0, 1) if axis is None else axis)
    if t.shape == "half_space":
        return HalfSpace(t.point, t.normal)
    if t.shape == "wedge":
        return Wedge(t.apex, t.width, t.height, t.length, edge=(0, 1, 0) if axis is None else axis)
    if t.shape == "height_field":
        top, height = t.high[-1], _height(t.surface, d)
        return HeightField(lambda x: np.minimum(height(x), top), t.low[:-1], t.high[:-1], t.low[-1])
    # these bring libraries of their own
    if t.shape == "text":
        from extremal.obstacles.text import Text

        return Text(t.text, t.height, t.thickness, t.center)
    from extremal.obstacles.surfaces import ClosedSurface, SurfaceMesh

    kind = ClosedSurface if cast(Any, scene).part == "elastic" else SurfaceMesh
    return kind(scene.beside(t.file), t.scale, t.translation or (0.0,) * 3)


def _height(surface: float | str, d: int) -> Callable[[NDArray], NDArray]:
    from .expression import function_of

    evaluate = function_of(surface, ("x", "y"))

    def height(x: NDArray) -> NDArray:
        return evaluate(x[:, 0], x[:, 1] if d == 3 else np.zeros(len(x)))

    return height


def made(scene: Scene, table: str, i: int, make: Callable[[], Any]) -> Any:
    """Return what `make` makes, with its complaints made the scene's."""
    from .expression_reader import ExpressionError

    try:
        return make()
    except (BodyError, ExpressionError) as error:
        raise InputError(place(scene, table, i) + str(error)) from None


def place(scene: Scene, table: str, i: int) -> str:
    """How messages begin that concern entry `i` of an array of tables."""
    return f"{scene.path or 'scene'}: [[{table}]] #{i + 1}: "


def turn(value: Any) -> NDArray:
    """A rotation as a vector (3,)."""
    return np.array(value if isinstance(value, tuple) else (0.0, 0.0, value))
