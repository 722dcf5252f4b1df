"""A function kept as samples on a regular grid."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .geometry import BodyError, as_text, length


@dataclass(frozen=True, eq=False)
class Samples:
    """Values at the nodes of a regular grid, multilinear between them and constant beyond.

    Attributes
    ----------
    values : (n1, ..., nD, ...)
        Scalars, or vectors along the last axis.
    origin : (D,) [m]
        Place of values[0, ..., 0].
    spacing : float or (D,) [m]
    """

    values: NDArray
    origin: NDArray
    spacing: float | NDArray

    @property
    def high(self) -> NDArray:
        """Place of the last node (D,) [m]."""
        shape = np.array(self.values.shape[: len(self.origin)])
        return self.origin + (shape - 1) * self.spacing

    def at(self, x: NDArray) -> NDArray:
        """Value at each point of x (n, D) [m]: (n,) or, of vectors, (n, m)."""
        from scipy.ndimage import map_coordinates

        places = ((x - self.origin) / self.spacing).T

        def one(values: NDArray) -> NDArray:
            return map_coordinates(values, places, order=1, mode="nearest", prefilter=False)

        if self.values.ndim == len(self.origin):
            return one(self.values)
        return np.stack([one(self.values[..., k]) for k in range(self.values.shape[-1])], axis=1)

    def distance(self, x: NDArray) -> NDArray:
        """φ (n,) [m] where the values are φ; beyond the grid the way to it is added."""
        beyond = np.maximum(np.maximum(self.origin - x, x - self.high), 0.0)
        return self.at(x) + length(beyond)


def grid_nodes(low: NDArray, high: NDArray, spacing: float) -> tuple[tuple[int, ...], NDArray]:
    """Shape of the grid from `low` to `high` or just beyond [m], and its nodes (n, D) [m], last axis fastest.

    Raises
    ------
    BodyError
        If it would have more than 5e7 nodes.
    """
    counts = np.ceil((high - low) / spacing - 1e-9).astype(int) + 1
    if float(np.prod(counts.astype(float))) > 5e7:
        raise BodyError(f"level set: a grid of {as_text(counts)} nodes is too large; take a larger spacing")
    axes = [low[k] + spacing * np.arange(counts[k]) for k in range(len(low))]
    return tuple(counts), np.stack([axis.ravel() for axis in np.meshgrid(*axes, indexing="ij")], axis=1)
