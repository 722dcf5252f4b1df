"""From a scene to a snow problem: particles and materials."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

from extremal.mpm.bodies import seed
from extremal.mpm.law import Law
from extremal.mpm.noise import noise, shell_profile
from extremal.mpm.particles import Particles
from extremal.mpm.problem import SnowProblem
from extremal.obstacles.shapes import Shape

from .colliders import colliders, made, place, shape_of, turn
from .errors import InputError
from .snow_scene import GRADIENTS

if TYPE_CHECKING:
    from . import snow_shapes
    from .coupled import CoupledProblem
    from .snow_scene import SnowScene


def build(scene: SnowScene, comm: MPI.Comm) -> SnowProblem | CoupledProblem:
    """The problem a scene describes, at its start (collective).

    Raises
    ------
    InputError
        On all ranks, where a body has no particle, a shape cannot be made, or the solid's mesh does not fit.
    """
    snow = snow_alone(scene, comm)
    if scene.solid is None:
        return snow
    from . import coupled

    return coupled.build(scene, scene.solid, snow, comm)


def snow_alone(scene: SnowScene, comm: MPI.Comm) -> SnowProblem:
    """The problem without [solid] (collective); raises InputError on all ranks as `build` does."""
    analysis = scene.analysis
    return SnowProblem(
        comm,
        particles(scene, comm),
        [law_of(scene, body) for body in scene.body],
        cell_size=scene.cell_size,
        gravity=None if scene.gravity is None else scene.gravity.acceleration,
        colliders=colliders(scene, scene.collider, scene.dimension),
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
            raise InputError(place(scene, "body", i) + "has no particle; its cells or its shape are too small")
        mine.ident[:] = start + sum(counts[: comm.rank]) + np.arange(len(mine))
        start += sum(counts)
        parts.append(mine)
    return Particles.join(parts)


def _seeded(scene: SnowScene, i: int, body: snow_shapes.Body, comm: MPI.Comm) -> Particles:
    h, d = scene.cell_size, scene.dimension
    shape = body_shape(scene, i)
    x = made(scene, "body", i, lambda: seed(shape, h, body.per_cell, body.seed, (comm.rank, comm.size)))
    mass = np.full(len(x), scene.material_of(body).density * h**d / body.per_cell)
    stiffness = np.ones(len(x))
    if body.shell is not None:
        mass *= shell_profile(shape, x, body.shell.thickness, body.shell.density)
        stiffness *= shell_profile(shape, x, body.shell.thickness, body.shell.stiffness)
    if body.noise is not None:
        # the same pattern for both: where snow is denser it is stiffer
        mass *= noise(x, body.noise.size, body.noise.density, body.noise.seed)
        stiffness *= noise(x, body.noise.size, body.noise.stiffness, body.noise.seed)
    out = Particles.at(x, mass, _velocity(body, shape, x), stiffness, i)
    if scene.grid.volumes == "seeded":
        out.volume[:] = h**d / body.per_cell
    return out


def body_shape(scene: SnowScene, i: int) -> Shape:
    """The region that a body fills; raises InputError."""
    shape: Shape = made(scene, "body", i, lambda: shape_of(scene, scene.body[i], scene.dimension))
    return shape


def _velocity(body: snow_shapes.Body, shape: Shape, x: NDArray) -> NDArray:
    """v = v0 + ω × (x - c) about the middle c of the body's bounds."""
    velocity = np.zeros_like(x) if body.velocity is None else np.tile(np.array(body.velocity), (len(x), 1))
    if body.spin is not None:
        low, high = shape.bounds()
        arm = np.zeros((len(x), 3))
        arm[:, : x.shape[1]] = x - (low + high) / 2
        velocity += np.cross(turn(body.spin), arm)[:, : x.shape[1]]
    return velocity
