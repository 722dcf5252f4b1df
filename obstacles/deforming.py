"""Collision bodies that deform: keyframes of a level set (7.7)."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .colliders import FREE, Contact
from .geometry import BodyError, central_gradient, positive
from .samples import Samples


class DeformingLevelSet:
    """A collider given by keyframes of its level set and velocity on one grid.

    Between keyframes at t and t + Δt, at t + γΔt (7.7)::

        φ(x) = (1 - γ) φ(x - γΔt v_co, t) + γ φ(x + (1 - γ)Δt v_co, t + Δt)
        v_co(x) = (1 - γ) v(x, t) + γ v(x, t + Δt)

    Before the first and from the last keyframe on the body rests as it is there.

    Parameters
    ----------
    times : (k,) [s]
        Ascending.
    phi : (k, n1, ..., nD) [m]
        Negative inside. The body must stay within the grid.
    velocity : (k, n1, ..., nD, D) [m/s]
        In the body and near it.
    origin : (D,) [m]
        Place of the first node.
    spacing : float [m]
    contact : Contact

    Raises
    ------
    BodyError
        If the arrays do not fit together or the times do not ascend.
    """

    def __init__(
        self,
        times: ArrayLike,
        phi: ArrayLike,
        velocity: ArrayLike,
        origin: ArrayLike,
        spacing: float,
        contact: Contact = FREE,
    ) -> None:
        self.contact = contact
        self.times, place = np.array(times, dtype=float), np.array(origin, dtype=float)
        phis, velocities = np.asarray(phi, dtype=float), np.asarray(velocity, dtype=float)
        h, dim = positive("level set", "spacing", spacing), place.size
        if self.times.ndim != 1 or not len(self.times) or not (np.diff(self.times) > 0).all():
            raise BodyError(f"level set: times must ascend, got {times}")
        if dim not in (2, 3) or phis.ndim != 1 + dim or len(phis) != len(self.times) or min(phis.shape[1:]) < 2:
            raise BodyError(
                f"level set: phi must have one grid of 2 or more nodes each way for each of {len(self.times)} times "
                f"and {dim} axes, got shape {phis.shape}"
            )
        if velocities.shape != (*phis.shape, dim):
            raise BodyError(f"level set: velocity must have shape {(*phis.shape, dim)}, got {velocities.shape}")
        if not (np.isfinite(phis).all() and np.isfinite(velocities).all()):
            raise BodyError("level set: phi and velocity must be finite everywhere on the grid")
        self._phi = [Samples(values, place, h) for values in phis]
        self._velocity = [Samples(values, place, h) for values in velocities]

    @classmethod
    def read(cls, path: str | Path, contact: Contact = FREE) -> DeformingLevelSet:
        """Read the arrays `times`, `phi`, `velocity`, `origin`, `spacing` from a NumPy .npz file.

        Raises
        ------
        BodyError
            If the file cannot be read, or lacks an array.
        """
        wanted = ("times", "phi", "velocity", "origin", "spacing")
        try:
            with np.load(path) as file:
                lacking = [name for name in wanted if name not in file]
                if not lacking:
                    times, phi, velocity, origin, spacing = (file[name] for name in wanted)
                    return cls(times, phi, velocity, origin, float(spacing), contact)
        except BodyError as error:
            raise BodyError(f"{path}: {error}") from None
        except (OSError, ValueError, TypeError) as error:
            raise BodyError(f"{path}: cannot be read as a NumPy .npz file: {str(error).splitlines()[0]}") from None
        raise BodyError(f"{path}: lacks {', '.join(lacking)}; a deforming level set has {', '.join(wanted)}")

    def bounds(self, t: float) -> tuple[NDArray, NDArray]:
        """The grid's corners (D,) [m]."""
        return self._phi[0].origin, self._phi[0].high

    def distance(self, x: NDArray, t: float) -> NDArray:
        """φ (n,) [m] by the formula above."""
        k, part, step = self._interval(t)
        if step == 0:
            return self._phi[k].distance(x)
        way = step * self.velocity(x, t)
        before = self._phi[k].distance(x - part * way)
        return (1 - part) * before + part * self._phi[k + 1].distance(x + (1 - part) * way)

    def normal(self, x: NDArray, t: float) -> NDArray:
        """∇φ (n, D), by central differences over a cell."""
        step = 0.5 * float(self._phi[0].spacing)
        return central_gradient(lambda y: self.distance(y, t), x, step)

    def velocity(self, x: NDArray, t: float) -> NDArray:
        """v_co (n, D) [m/s] by the formula above."""
        k, part, step = self._interval(t)
        if step == 0:
            return np.zeros_like(x)
        return (1 - part) * self._velocity[k].at(x) + part * self._velocity[k + 1].at(x)

    def carry(self, x: NDArray, start: float, end: float) -> NDArray:
        """Where (n, D) [m] points near the body are taken, by the midpoint rule."""
        middle = (start + end) / 2
        half = x + (middle - start) * self.velocity(x, start)
        return x + (end - start) * self.velocity(half, middle)

    def _interval(self, t: float) -> tuple[int, float, float]:
        """Keyframe before t, γ, and Δt [s], which is zero where the body rests."""
        k = int(np.searchsorted(self.times, t, side="right")) - 1
        if not 0 <= k < len(self.times) - 1:
            return max(k, 0), 0.0, 0.0
        step = float(self.times[k + 1] - self.times[k])
        return k, (t - float(self.times[k])) / step, step
