"""Collision bodies and what they do to velocities (7.7)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from .geometry import BodyError, length
from .motion import Placement, RigidMotion
from .shapes import Shape


@dataclass(frozen=True)
class Contact:
    """How a collider holds what touches it.

    Attributes
    ----------
    friction : float
        Coulomb's μ [-].
    sticky : bool
        Whether the relative velocity vanishes on every touch, also of what would separate.
    """

    friction: float = 0.0
    sticky: bool = False

    def __post_init__(self) -> None:
        if not (self.friction >= 0 and np.isfinite(self.friction)):
            raise BodyError(f"collider: friction must be a finite number, 0 or above, got {self.friction}")


FREE = Contact()


class Collider(Protocol):
    """A body with a prescribed motion; points are (n, D) [m], the time is in s."""

    @property
    def contact(self) -> Contact:
        """Friction and stickiness."""

    def bounds(self, t: float) -> tuple[NDArray, NDArray]:
        """Corners (D,) [m] of a box that encloses it at time t; components may be infinite."""

    def distance(self, x: NDArray, t: float) -> NDArray:
        """φ (n,) [m], negative inside."""

    def normal(self, x: NDArray, t: float) -> NDArray:
        """∇φ (n, D), of unit length."""

    def velocity(self, x: NDArray, t: float) -> NDArray:
        """v_co (n, D) [m/s] of the collider's material at x."""


@dataclass(frozen=True)
class Rigid:
    """A shape, at rest or carried by a rigid motion, whose level set stays the same in the body's own frame.

    Attributes
    ----------
    shape : Shape
        Where the motion's rotation and translation are zero.
    contact : Contact
    motion : RigidMotion or None
        None: at rest.
    """

    shape: Shape
    contact: Contact = FREE
    motion: RigidMotion | None = None

    def __post_init__(self) -> None:
        dimension = len(self.shape.bounds()[0])
        if self.motion is not None and self.motion.dimension != dimension:
            raise BodyError(f"collider: keyframes for {self.motion.dimension}D move a shape in {dimension}D")

    def bounds(self, t: float) -> tuple[NDArray, NDArray]:
        """Corners (D,) [m] of a box that encloses the shape at time t [s]."""
        low, high = self.shape.bounds()
        if self.motion is None:
            return low, high
        now = self.motion.at(t)
        if np.array_equal(now.rotation, np.eye(len(low))):
            return low + now.shift, high + now.shift
        if not (np.isfinite(low).all() and np.isfinite(high).all()):
            return np.full(len(low), -np.inf), np.full(len(low), np.inf)
        corners = now.to_world(np.array(list(product(*zip(low, high)))))
        return corners.min(axis=0), corners.max(axis=0)

    def distance(self, x: NDArray, t: float) -> NDArray:
        """φ (n,) [m] at points (n, D) [m] at time t [s]."""
        now = self._at(t)
        return self.shape.distance(now.to_body(x) if now else x)

    def normal(self, x: NDArray, t: float) -> NDArray:
        """∇φ (n, D) at points (n, D) [m] at time t [s]."""
        now = self._at(t)
        return self.shape.normal(now.to_body(x)) @ now.rotation.T if now else self.shape.normal(x)

    def velocity(self, x: NDArray, t: float) -> NDArray:
        """v_co (n, D) [m/s] of the body at points (n, D) [m] at time t [s]."""
        now = self._at(t)
        return now.velocity(x) if now else np.zeros_like(x)

    def _at(self, t: float) -> Placement | None:
        return None if self.motion is None else self.motion.at(t)


def collide(colliders: Sequence[Collider], x: NDArray, v: NDArray, t: float) -> tuple[NDArray, NDArray]:
    """Velocities after inelastic collisions with each collider in turn (7.7).

    Where φ(x) <= 0, with n = ∇φ, v_rel = v - v_co, v_n = v_rel·n and v_t = v_rel - v_n n::

        sticky                 v' = v_co
        v_n >= 0               v' = v                          separating
        |v_t| <= -μ v_n        v' = v_co                       sticking
        otherwise              v' = v_co + v_t + μ v_n v_t/|v_t|   sliding

    What lies outside a collider's bounds costs comparisons only, and no φ.

    Parameters
    ----------
    colliders : sequence of Collider
    x : (n, D) [m]
        Grid nodes or particles.
    v : (n, D) [m/s]
        Left as it is.
    t : float [s]

    Returns
    -------
    velocities : (n, D) [m/s]
        `v` itself when nothing collides.
    hit : (n,) bool
        Where a collision was applied; separating points are not hit.
    """
    hit = np.zeros(len(x), dtype=bool)
    if not len(x) or not colliders:
        return v, hit
    out = v
    for collider in colliders:
        touching = _touching(collider, x, t)
        if not len(touching):
            continue
        points = x[touching]
        v_co = collider.velocity(points, t)
        relative = out[touching] - v_co
        if not collider.contact.sticky:
            relative, applied = _respond(relative, collider.normal(points, t), collider.contact.friction)
            touching, v_co = touching[applied], v_co[applied]
            if not len(touching):
                continue
        else:
            relative = np.zeros_like(relative)
        if out is v:
            out = v.copy()
        out[touching] = v_co + relative
        hit[touching] = True
    return out, hit


def _respond(relative: NDArray, n: NDArray, friction: float) -> tuple[NDArray, NDArray]:
    """Relative velocities (m, D) after the collision, and which of the points (bool) they are for."""
    v_n = np.einsum("ni,ni->n", relative, n)
    applied = v_n < 0
    v_n = v_n[applied]
    v_t = relative[applied] - v_n[:, None] * n[applied]
    size = length(v_t)
    slides = size > -friction * v_n
    kept = np.where(slides, 1 + friction * v_n / np.where(slides, size, 1.0), 0.0)
    return kept[:, None] * v_t, applied


def _touching(collider: Collider, x: NDArray, t: float) -> NDArray:
    """Indices of the points with φ <= 0; φ is asked for within the collider's bounds only."""
    near = None  # None: all points
    for column, low, high in zip(x.T, *collider.bounds(t)):
        for limit, within in ((low, np.greater_equal), (high, np.less_equal)):
            if np.isfinite(limit):
                kept = np.flatnonzero(within(column if near is None else column[near], limit))
                near = kept if near is None else near[kept]
                if not len(near):
                    return near
    if near is None:
        return np.flatnonzero(collider.distance(x, t) <= 0)
    return near[collider.distance(x[near], t) <= 0]
