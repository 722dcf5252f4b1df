"""Obstacles: shapes with a prescribed motion, and how they hold what touches them."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from .geometry import BodyError
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

    def carry(self, x: NDArray, start: float, end: float) -> NDArray:
        """Where (n, D) [m] the collider takes at time `end` what it has at x at time `start`."""


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

    def carry(self, x: NDArray, start: float, end: float) -> NDArray:
        """Where (n, D) [m] points (n, D) [m] fixed to the body at time `start` are at time `end` [s]."""
        if self.motion is None:
            return x
        return self.motion.at(end).to_world(self.motion.at(start).to_body(x))

    def _at(self, t: float) -> Placement | None:
        return None if self.motion is None else self.motion.at(t)
