"""Ground and heaps whose top is a function of the horizontal position."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .geometry import BodyError, central_gradient, length, positive
from .samples import Samples, grid_nodes
from .shapes import Box


class HeightField:
    """Everything between a base and a height, over an interval of x in 2D or a rectangle of x and y in 3D.

    φ has the right sign everywhere, and is the distance near flat parts: (height difference) / √(1 + |∇height|²).

    Parameters
    ----------
    height : (n1,), (n1, n2) [m], or callable
        Heights at points spread evenly from `low` to `high`, linear in between; or what makes heights (n,) [m] of
        points (n, D - 1) [m], which is then sampled.
    low, high : (D - 1,) [m]
        Corners of the interval or rectangle.
    base : float [m]
        Where height <= base there is nothing.
    resolution : int
        Samples of a callable along the longest side.

    Raises
    ------
    BodyError
        If heights are not finite, or their array does not fit.
    """

    def __init__(
        self,
        height: ArrayLike | Callable[[NDArray], NDArray],
        low: ArrayLike,
        high: ArrayLike,
        base: float = 0.0,
        resolution: int = 256,
    ) -> None:
        start, end = (np.atleast_1d(np.array(corner, dtype=float)) for corner in (low, high))
        if start.shape != end.shape or len(start) not in (1, 2) or not (end > start).all():
            raise BodyError(f"height_field: low and high must be 1 or 2 numbers, high above low, got {low}, {high}")
        if callable(height):
            spacing = positive("height_field", "resolution", 1 / resolution) * float((end - start).max())
            shape, points = grid_nodes(start, end, spacing)
            heights = np.broadcast_to(height(np.minimum(points, end)), len(points)).astype(float).reshape(shape)
            self._height = Samples(heights, start, spacing)
        else:
            heights = np.array(height, dtype=float)
            if heights.ndim != len(start) or min(heights.shape) < 2:
                raise BodyError(
                    f"height_field: height must have {len(start)} axes of 2 or more numbers, got shape {heights.shape}"
                )
            self._height = Samples(heights, start, (end - start) / (np.array(heights.shape) - 1))
        if not np.isfinite(heights).all():
            raise BodyError("height_field: height must be finite everywhere between low and high")
        if not heights.max() > base:
            raise BodyError(f"height_field: base must be below the greatest height, {heights.max():g} m, got {base:g}")
        self._box = Box(np.append(start, base), np.append(end, heights.max()))
        self._step = 0.5 * float(np.min(self._height.spacing))

    def bounds(self) -> tuple[NDArray, NDArray]:
        return self._box.bounds()

    def inside(self, x: NDArray) -> NDArray:
        return self.distance(x) <= 0

    def distance(self, x: NDArray) -> NDArray:
        """φ (n,) [m] at points (n, D) [m]."""
        flat = x[:, :-1]
        ahead = self._step * np.eye(flat.shape[1])
        slope = np.stack([self._height.at(flat + e) - self._height.at(flat - e) for e in ahead], axis=1)
        steepness = np.sqrt(1 + length(slope / (2 * self._step)) ** 2)
        return np.maximum((x[:, -1] - self._height.at(flat)) / steepness, self._box.distance(x))

    def normal(self, x: NDArray) -> NDArray:
        return central_gradient(self.distance, x, self._step)
