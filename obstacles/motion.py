"""Rigid motion by keyframes: placement and velocity."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .geometry import BodyError


@dataclass(frozen=True)
class Placement:
    """Where a rigid body is and how it moves at one time: x = R (X - c) + c + s.

    Attributes
    ----------
    rotation : (D, D)
        R
    center, shift : (D,) [m]
        c, s
    spin : (3,) [1/s]
        ω with dR/dt = [ω]ₓ R
    drift : (D,) [m/s]
        Velocity of the material point at c + s: ds/dt + (I - R) dc/dt.
    """

    rotation: NDArray
    center: NDArray
    shift: NDArray
    spin: NDArray
    drift: NDArray

    def to_body(self, x: NDArray) -> NDArray:
        """Reference positions (n, D) [m] of the points now at x (n, D) [m]."""
        return (x - (self.center + self.shift)) @ self.rotation + self.center

    def to_world(self, X: NDArray) -> NDArray:
        """Present positions (n, D) [m] of the reference points X (n, D) [m]."""
        return (X - self.center) @ self.rotation.T + (self.center + self.shift)

    def velocity(self, x: NDArray) -> NDArray:
        """Velocity (n, D) [m/s] of the points now at x (n, D) [m]: ω × (x - c - s) + drift."""
        arm = x - (self.center + self.shift)
        w = self.spin
        out = np.empty(arm.shape)
        if arm.shape[1] == 2:
            out[:, 0], out[:, 1] = -w[2] * arm[:, 1], w[2] * arm[:, 0]
        else:
            out[:, 0] = w[1] * arm[:, 2] - w[2] * arm[:, 1]
            out[:, 1] = w[2] * arm[:, 0] - w[0] * arm[:, 2]
            out[:, 2] = w[0] * arm[:, 1] - w[1] * arm[:, 0]
        return out + self.drift


class RigidMotion:
    """Placements at some times; between them rotation vector, translation and centre change linearly.

    A rotation vector of many turns is many turns. Before the first time and from the last on the body rests;
    at a keyframe the velocity is that of the interval which begins there.

    Parameters
    ----------
    times : (k,) [s]
        Ascending.
    translations, centers : (k, D) [m], or one (D,) for all times
    rotations : (k, 3) [rad], or one (3,) for all times
        Rotation vectors; in 2D about (0, 0, 1), and then (k,) angles are taken too.
    dimension : int
        2 or 3.

    Raises
    ------
    BodyError
        If the times do not ascend, the tables do not fit, or a plane body is turned out of its plane.
    """

    def __init__(
        self,
        times: Sequence[float] | NDArray = (0.0,),
        translations: ArrayLike | None = None,
        rotations: ArrayLike | None = None,
        centers: ArrayLike | None = None,
        *,
        dimension: int,
    ) -> None:
        self.dimension = dimension
        self.times = np.array(times, dtype=float)
        if self.times.ndim != 1 or not len(self.times) or not (np.diff(self.times) > 0).all():
            raise BodyError(f"keyframes: times must ascend, got {times}")
        self.translations = self._table("translations", translations, dimension)
        self.centers = self._table("centers", centers, dimension)
        turns = None if rotations is None else np.array(rotations, dtype=float)
        if dimension == 2 and turns is not None and turns.shape in ((), self.times.shape):
            turns = turns[..., None] * np.array([0.0, 0.0, 1.0])
        self.rotations = self._table("rotations", turns, 3)
        if dimension == 2 and self.rotations[:, :2].any():
            raise BodyError("keyframes: in 2D a rotation is about the z axis, [0, 0, angle]")

    def at(self, time: float) -> Placement:
        """Placement and velocity at a time [s]."""
        k = int(np.searchsorted(self.times, time, side="right")) - 1
        moving = 0 <= k < len(self.times) - 1
        k = max(k, 0)
        step = self.times[k + 1] - self.times[k] if moving else 1.0
        part = (time - self.times[k]) / step if moving else 0.0

        def now(table: NDArray) -> tuple[NDArray, NDArray]:
            rise = table[k + 1] - table[k] if moving else np.zeros(table.shape[1])
            return table[k] + part * rise, rise / step

        (turn, turning), (shift, shifting), (center, centering) = map(
            now, (self.rotations, self.translations, self.centers)
        )
        R, spin = rotation_matrix(turn), spin_of(turn, turning)
        R = R[: self.dimension, : self.dimension]
        return Placement(R, center, shift, spin, shifting + centering - R @ centering)

    def _table(self, name: str, values: ArrayLike | None, width: int) -> NDArray:
        shape = (len(self.times), width)
        out = np.zeros(width) if values is None else np.array(values, dtype=float)
        if out.shape not in (shape, (width,)) or not np.isfinite(out).all():
            raise BodyError(
                f"keyframes: {name} must be {width} finite numbers for each of {shape[0]} times, got {values}"
            )
        return np.array(np.broadcast_to(out, shape))


def rotation_matrix(turn: NDArray) -> NDArray:
    """R = exp [θ]ₓ (3, 3) = I + a [θ]ₓ + b [θ]ₓ², the identity exactly for θ = 0."""
    a, b, _ = _coefficients(turn)
    K = _skew(turn)
    return np.eye(3) + a * K + b * (K @ K)


def spin_of(turn: NDArray, turning: NDArray) -> NDArray:
    """Angular velocity ω (3,) [1/s] of exp [θ(t)]ₓ: ω = (I + b [θ]ₓ + c [θ]ₓ²) dθ/dt."""
    _, b, c = _coefficients(turn)
    K = _skew(turn)
    return turning + b * (K @ turning) + c * (K @ (K @ turning))


def _coefficients(turn: NDArray) -> tuple[float, float, float]:
    """sin θ / θ, (1 - cos θ) / θ², (θ - sin θ) / θ³; by series where the differences would cancel."""
    angle = float(np.sqrt(turn @ turn))
    square = angle**2
    if angle < 1e-2:
        return 1 - square / 6 + square**2 / 120, 0.5 - square / 24 + square**2 / 720, 1 / 6 - square / 120
    return np.sin(angle) / angle, 2 * (np.sin(angle / 2) / angle) ** 2, (angle - np.sin(angle)) / angle**3


def _skew(w: NDArray) -> NDArray:
    return np.array([[0.0, -w[2], w[1]], [w[2], 0.0, -w[0]], [-w[1], w[0], 0.0]])
