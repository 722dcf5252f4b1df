"""From a scene to a snow problem: particles, materials, colliders."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

from extremal.mpm.bodies import BodyError, seed
from extremal.mpm.colliders import Collider, Contact, Rigid
from extremal.mpm.deforming import DeformingLevelSet
from extremal.mpm.height_field import HeightField
from extremal.mpm.law import Law
from extremal.mpm.motion import RigidMotion
from extremal.mpm.noise import noise, shell_profile
from extremal.mpm.particles import Particles
from extremal.mpm.problem import SnowProblem
from extremal.mpm.shapes import Box, Cylinder, HalfSpace, Shape, Sphere, Wedge

from .errors import InputError
from .snow_scene import GRADIENTS

if TYPE_CHECKING:
    from . import snow_shapes
    from .conditions_scene import Keyframe
    from .snow_scene import SnowScene


def build(scene: SnowScene, comm: MPI.Comm) -> SnowProblem:
    """The problem a scene describes, at its start (collective).

    Raises
    ------
    InputError
        On all ranks, where a body has no particle, or a shape cannot be made.
    """
    analysis = scene.analysis
    return SnowProblem(
        comm,
        particles(scene, comm),
        [law_of(scene, body) for body in scene.body],
        cell_size=scene.cell_size,
        gravity=None if scene.gravity is None else scene.gravity.acceleration,
        colliders=colliders(scene),
        spline=scene.grid.spline,
        beta=analysis.beta,
        flip=analysis.flip,
        cfl=analysis.cfl,
        precision=analysis.precision,
        rebalance=scene.grid.imbalance,
        with_gradients=any(name in GRADIENTS for name in scene.output.fields or ()),
    )


def law_of(scene: SnowScene, body: snow_shapes.Body) -> Law:
    """The material of a body."""
    values = scene.material_of(body).model_dump()
    return Law(name=values.pop("law"), **values)


def particles(scene: SnowScene, comm: MPI.Comm) -> Particles:
    """This rank's share of the particles of all bodies; together the same on any number of ranks (collective)."""
    parts, start = [], 0
    for i, body in enumerate(scene.body):
        mine = _seeded(scene, i, body, comm)
        counts = comm.allgather(len(mine))
        if sum(counts) == 0:
            raise InputError(_place(scene, "body", i) + "has no particle; its cells or its shape are too small")
        mine.ident[:] = start + sum(counts[: comm.rank]) + np.arange(len(mine))
        start += sum(counts)
        parts.append(mine)
    return Particles.join(parts)


def _seeded(scene: SnowScene, i: int, body: snow_shapes.Body, comm: MPI.Comm) -> Particles:
    h, d = scene.cell_size, scene.dimension
    shape = body_shape(scene, i)
    x = _made(scene, "body", i, lambda: seed(shape, h, body.per_cell, body.seed, (comm.rank, comm.size)))
    mass = np.full(len(x), scene.material_of(body).density * h**d / body.per_cell)
    stiffness = np.ones(len(x))
    if body.shell is not None:
        mass *= shell_profile(shape, x, body.shell.thickness, body.shell.density)
        stiffness *= shell_profile(shape, x, body.shell.thickness, body.shell.stiffness)
    if body.noise is not None:
        # the same pattern for both: where snow is denser it is stiffer
        mass *= noise(x, body.noise.size, body.noise.density, body.noise.seed)
        stiffness *= noise(x, body.noise.size, body.noise.stiffness, body.noise.seed)
    made = Particles.at(x, mass, _velocity(body, shape, x), stiffness, i)
    if scene.grid.volumes == "seeded":
        made.volume[:] = h**d / body.per_cell
    return made


def body_shape(scene: SnowScene, i: int) -> Shape:
    """The region that a body fills; raises InputError."""
    shape: Shape = _made(scene, "body", i, lambda: shape_of(scene, scene.body[i]))
    return shape


def _velocity(body: snow_shapes.Body, shape: Shape, x: NDArray) -> NDArray:
    """v = v0 + ω × (x - c) about the middle c of the body's bounds."""
    velocity = np.zeros_like(x) if body.velocity is None else np.tile(np.array(body.velocity), (len(x), 1))
    if body.spin is not None:
        low, high = shape.bounds()
        arm = np.zeros((len(x), 3))
        arm[:, : x.shape[1]] = x - (low + high) / 2
        velocity += np.cross(_turn(body.spin), arm)[:, : x.shape[1]]
    return velocity


def _turn(value: Any) -> NDArray:
    return np.array(value if isinstance(value, tuple) else (0.0, 0.0, value))


def colliders(scene: SnowScene) -> list[Collider]:
    """What the snow collides with, in the scene's order."""
    return [_made(scene, "collider", i, partial(_collider, scene, c)) for i, c in enumerate(scene.collider)]


def _collider(scene: SnowScene, collider: snow_shapes.Collider) -> Collider:
    contact = Contact(collider.friction, collider.sticky)
    if collider.shape == "level_sets":
        assert collider.file is not None
        return _level_sets(str(scene.beside(collider.file)), contact)
    motion = None if collider.keyframes is None else _motion(collider.keyframes, scene.dimension)
    return Rigid(shape_of(scene, collider), contact, motion)


def _motion(frames: tuple[Keyframe, ...], d: int) -> RigidMotion:
    def table(key: str) -> NDArray:
        return np.array([getattr(frame, key) or (0.0,) * d for frame in frames])

    turns = np.array([_turn(frame.rotation or 0.0) for frame in frames])
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


def shape_of(scene: SnowScene, table: snow_shapes.Shape) -> Any:
    """The shape that a table describes."""
    d, t = scene.dimension, cast(Any, table)  # which keys are there has been checked
    axis = None if t.axis is None else np.eye(3)["xyz".index(t.axis)]
    if t.shape == "box":
        return Box(t.low, t.high)
    if t.shape == "sphere":
        return Sphere(t.center, t.radius)
    if t.shape == "cylinder":
        return Cylinder(t.center, t.radius, t.length, (0, 0, 1) if axis is None else axis)
    if t.shape == "half_space":
        return HalfSpace(t.point, t.normal)
    if t.shape == "wedge":
        return Wedge(t.apex, t.width, t.height, t.length, edge=(0, 1, 0) if axis is None else axis)
    if t.shape == "height_field":
        top, height = t.high[-1], _height(t.surface, d)
        return HeightField(lambda x: np.minimum(height(x), top), t.low[:-1], t.high[:-1], t.low[-1])
    # these bring libraries of their own
    if t.shape == "text":
        from extremal.mpm.text import Text

        return Text(t.text, t.height, t.thickness, t.center)
    from extremal.mpm.surfaces import SurfaceMesh

    return SurfaceMesh(scene.beside(t.file), t.scale, t.translation or (0.0,) * 3)


def _height(surface: float | str, d: int) -> Callable[[NDArray], NDArray]:
    from .expression import function_of

    evaluate = function_of(surface, ("x", "y"))

    def height(x: NDArray) -> NDArray:
        return evaluate(x[:, 0], x[:, 1] if d == 3 else np.zeros(len(x)))

    return height


def _made(scene: SnowScene, table: str, i: int, make: Callable[[], Any]) -> Any:
    """Return what `make` makes, with its complaints made the scene's."""
    from .expression_reader import ExpressionError

    try:
        return make()
    except (BodyError, ExpressionError) as error:
        raise InputError(_place(scene, table, i) + str(error)) from None


def _place(scene: SnowScene, table: str, i: int) -> str:
    return f"{scene.path or 'scene'}: [[{table}]] #{i + 1}: "
