"""Where the nodes of a body start: scattered, collapsed, mirrored (figures 6.6, 6.10 and 6.11)."""

from __future__ import annotations

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

from .space import Space

AXES = "xyz"


def _box(space: Space) -> tuple[NDArray, NDArray]:
    """Lower and upper corner of the body's bounding box [m]."""
    d, x = space.dimension, space.positions
    low, high = np.full(d, np.inf), np.full(d, -np.inf)
    space.comm.Allreduce(x.min(axis=0, initial=np.inf) if len(x) else low.copy(), low, op=MPI.MIN)
    space.comm.Allreduce(x.max(axis=0, initial=-np.inf) if len(x) else high.copy(), high, op=MPI.MAX)
    return low, high


def _random(space: Space, seed: int) -> NDArray:
    """Uniform numbers in (-1, 1) for each local node and direction, the same on any number of ranks."""
    numbers = np.random.default_rng(seed).uniform(-1, 1, (space.node_count, space.dimension))
    return numbers[space.nodes]


def scatter(space: Space, amplitude: float = 1.0, seed: int = 0) -> None:
    """Put every node anywhere in the bounding box grown by `amplitude` about its centre, at random."""
    low, high = _box(space)
    target = (low + high) / 2 + amplitude * (high - low) / 2 * _random(space, seed)
    space.u.x.array[:] = (target - space.positions).ravel()


def collapse(space: Space, to: str = "point", axis: str = "x", noise: float = 0.0, seed: int = 0) -> None:
    """Move every node onto the centre, onto the line along `axis` through it or the plane normal to `axis`.

    `noise` moves each node by up to that part of the body's size in every direction.
    """
    low, high = _box(space)
    target = np.broadcast_to((low + high) / 2, space.positions.shape).copy()
    k = AXES.index(axis)
    kept = {"point": [], "line": [k], "plane": [c for c in range(space.dimension) if c != k]}[to]
    target[:, kept] = space.positions[:, kept]
    if noise:
        target += noise * float((high - low).max()) * _random(space, seed)
    space.u.x.array[:] = (target - space.positions).ravel()


def mirror(space: Space, axis: str = "x") -> None:
    """Reflect the body at the plane through its centre normal to `axis`: every element is inverted."""
    low, high = _box(space)
    k = AXES.index(axis)
    target = space.positions.copy()
    target[:, k] = (low + high)[k] - target[:, k]
    space.u.x.array[:] = (target - space.positions).ravel()


def affine(space: Space, gradient: NDArray) -> None:
    """Deform the whole body by F = `gradient` (d, d) about the centre of its bounding box."""
    low, high = _box(space)
    away = space.positions - (low + high) / 2
    space.u.x.array[:] = (away @ (np.asarray(gradient) - np.eye(space.dimension)).T).ravel()
