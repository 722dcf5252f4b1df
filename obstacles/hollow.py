"""Walls that bodies fall into or pass through: bowls and tubes, by exact distances to their middle surface."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .geometry import BodyError, directed, fill, length, positive, unit, vector
from .shapes import Solid


class _Wall(Solid):
    """All within half of `thickness` of a surface of revolution about `axis` through `center`; ends are rounded.

    In 2D the surface is a pair of curves, mirrored in the axis. φ is exact: the distance to the surface less half
    the thickness.
    """

    center: NDArray
    axis: NDArray
    thickness: float

    def distance(self, x: NDArray) -> NDArray:
        return length(self._from_middle(x)[0]) - self.thickness / 2

    def normal(self, x: NDArray) -> NDArray:
        """∇φ (n, D) at points (n, D) [m]; away from the axis on the middle surface."""
        arm, radial = self._from_middle(x)
        return np.where(length(arm)[:, None] > 0, directed(arm, self.axis), radial)

    def _from_middle(self, x: NDArray) -> tuple[NDArray, NDArray]:
        """Vectors (n, D) [m] from the nearest point of the middle surface, and unit vectors away from the axis."""
        local = x - self.center
        z = local @ self.axis
        out = local - z[:, None] * self.axis
        side = np.roll(np.eye(len(self.axis)), 1, axis=0)[np.argmax(np.abs(self.axis))]
        radial = directed(out, unit("wall", "axis", side - (side @ self.axis) * self.axis))
        r = length(out)
        flat = np.stack([r, z], axis=1)
        arm = flat - self._nearest(flat)
        return arm[:, :1] * radial + arm[:, 1:] * self.axis, radial

    def _nearest(self, x: NDArray) -> NDArray:
        """The nearest points (n, 2) [m] of the curve which turns about the axis, to x (n, 2): from the axis, along."""
        raise NotImplementedError

    def _reach(self, across: float, low: float, high: float) -> tuple[NDArray, NDArray]:
        """Bounds of a surface within `across` [m] of the axis, from `low` to `high` [m] along it."""
        sideways = across * np.sqrt(np.maximum(0.0, 1 - self.axis**2))
        ends = np.stack([low * self.axis, high * self.axis])
        half = self.thickness / 2
        return self.center + ends.min(axis=0) - sideways - half, self.center + ends.max(axis=0) + sideways + half


@dataclass(frozen=True, init=False, eq=False)
class Bowl(_Wall):
    """Lower half of a hollow ball, in 2D of a ring, open upwards (the last axis).

    Parameters
    ----------
    center : (D,) [m]
        Of the ball, in the plane of the rim's middle.
    radius : float [m]
        Of the inside.
    thickness : float [m]
        Of the wall, outside of that; the rim is rounded.
    """

    center: NDArray
    axis: NDArray
    radius: float
    thickness: float

    def __init__(self, center: ArrayLike, radius: float, thickness: float) -> None:
        place = vector("bowl", "center", center)
        fill(self, center=place, axis=np.eye(len(place))[-1])
        fill(self, radius=positive("bowl", "radius", radius), thickness=positive("bowl", "thickness", thickness))

    def bounds(self) -> tuple[NDArray, NDArray]:
        """Corners (D,) [m] of the smallest box that encloses the bowl."""
        middle = self.radius + self.thickness / 2
        return self._reach(middle, -middle, 0.0)

    def _nearest(self, x: NDArray) -> NDArray:
        middle = self.radius + self.thickness / 2
        round_about = directed(np.minimum(x, [np.inf, 0.0]), np.array([1.0, 0.0]))
        return middle * np.where(x[:, 1:] < 0, round_about, [1.0, 0.0])


@dataclass(frozen=True, init=False, eq=False)
class Tube(_Wall):
    """Hollow cylinder, in 2D two walls side by side, open at both ends.

    Parameters
    ----------
    center : (D,) [m]
    radius : float [m]
        Of the inside.
    thickness : float [m]
        Of the wall, outside of that; its ends are rounded.
    length : float [m]
        Of the straight part.
    axis : (D,)
        Default the last axis.
    flare : float [m]
        Radius of the quarter circle by which the middle of the wall bends outwards beyond either end; 0: it does not.
    """

    center: NDArray
    axis: NDArray
    radius: float
    thickness: float
    length: float
    flare: float

    def __init__(
        self,
        center: ArrayLike,
        radius: float,
        thickness: float,
        length: float,
        axis: ArrayLike | None = None,
        flare: float = 0.0,
    ) -> None:
        place = vector("tube", "center", center)
        dim = len(place)
        fill(self, center=place, radius=positive("tube", "radius", radius))
        fill(self, thickness=positive("tube", "thickness", thickness), length=positive("tube", "length", length))
        fill(self, axis=unit("tube", "axis", np.eye(dim)[-1] if axis is None else vector("tube", "axis", axis, dim)))
        if not (flare >= 0 and np.isfinite(flare)):
            raise BodyError(f"tube: flare must be a finite number, 0 or above, got {flare}")
        fill(self, flare=float(flare))

    def bounds(self) -> tuple[NDArray, NDArray]:
        """Corners (D,) [m] of a box that encloses the tube."""
        end = self.length / 2 + self.flare
        return self._reach(self.radius + self.thickness / 2 + self.flare, -end, end)

    def _nearest(self, x: NDArray) -> NDArray:
        middle, half = self.radius + self.thickness / 2, self.length / 2
        r, z = x[:, 0], np.abs(x[:, 1])
        straight = np.stack([np.full(len(x), middle), np.minimum(z, half)], axis=1)
        folded, corner = np.stack([r, z], axis=1), np.array([middle + self.flare, half])
        # a quarter of a circle, from the straight part's end to a lip that is nearest to all beyond the corner
        arm = np.where(r[:, None] > corner[0], [0.0, 1.0], np.maximum(folded - corner, [-np.inf, 0.0]))
        mouth = corner + self.flare * directed(arm, np.array([-1.0, 0.0]))
        nearer = length(folded - mouth) < length(folded - straight)
        nearest = np.where(nearer[:, None], mouth, straight)
        nearest[:, 1] *= np.where(x[:, 1] < 0, -1.0, 1.0)
        return nearest
