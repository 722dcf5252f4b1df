"""Algebra of signed distances, and checks of what shapes are made of."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray


class BodyError(ValueError):
    """A body, shape or collider that cannot be; the message names the value and what would be accepted."""


def intersection(q: NDArray) -> NDArray:
    """φ (n,) of the intersection of k solids with distances q (n, k) and mutually orthogonal gradients.

    φ = |max(q, 0)| + min(max_k q, 0): exact where each q is.
    """
    return length(np.maximum(q, 0.0)) + np.minimum(q.max(axis=1), 0.0)


def intersection_gradient(q: NDArray, gradients: NDArray) -> NDArray:
    """∇φ (n, D) of `intersection`, from the gradients (n, k, D) of q (n, k)."""
    outside = np.maximum(q, 0.0)
    size = length(outside)
    nearest = np.zeros_like(q)
    nearest[np.arange(len(q)), q.argmax(axis=1)] = 1.0
    weights = np.where(size[:, None] > 0, outside / np.where(size > 0, size, 1.0)[:, None], nearest)
    return np.einsum("nk,nkd->nd", weights, gradients)


def convex_polygon(corners: NDArray, x: NDArray) -> tuple[NDArray, NDArray]:
    """φ (n,) and ∇φ (n, 2) at x (n, 2) of the polygon with `corners` (m, 2), counterclockwise."""
    edges = np.roll(corners, -1, axis=0) - corners
    outward = np.stack([edges[:, 1], -edges[:, 0]], axis=1) / length(edges)[:, None]
    arms = x[:, None, :] - corners
    side = np.einsum("nmd,md->nm", arms, outward)
    fraction = np.clip(np.einsum("nmd,md->nm", arms, edges) / np.einsum("md,md->m", edges, edges), 0.0, 1.0)
    to_edge = arms - fraction[:, :, None] * edges
    apart = length(to_edge)
    rows, facing = np.arange(len(x)), side.argmax(axis=1)
    closest = apart.argmin(axis=1)
    inside = (side[rows, facing] <= 0) | (apart[rows, closest] == 0)  # rounding may put an edge's own points outside
    phi = np.where(inside, np.minimum(side[rows, facing], 0.0), apart[rows, closest])
    away = to_edge[rows, closest] / np.where(inside, 1.0, phi)[:, None]
    return phi, np.where(inside[:, None], outward[facing], away)


def length(x: NDArray) -> NDArray:
    """Euclidean length over the last axis."""
    return np.sqrt(np.einsum("...i,...i->...", x, x))


def directed(x: NDArray, otherwise: NDArray) -> NDArray:
    """x (n, D) scaled to unit length; `otherwise` (D,) where x is zero."""
    size = length(x)
    return np.where(size[:, None] > 0, x / np.where(size > 0, size, 1.0)[:, None], otherwise)


def vector(shape: str, key: str, value: ArrayLike, dimension: int | None = None) -> NDArray:
    """A finite vector of 2 or 3 numbers, or of `dimension` numbers.

    Raises
    ------
    BodyError
        Naming shape and key.
    """
    try:
        out = np.array(value, dtype=float)
    except (TypeError, ValueError):
        out = np.array(np.nan)
    if out.ndim != 1 or len(out) not in ((2, 3) if dimension is None else (dimension,)) or not np.isfinite(out).all():
        raise BodyError(f"{shape}: {key} must be {dimension or '2 or 3'} finite numbers, got {value}")
    return out


def unit(shape: str, key: str, value: NDArray) -> NDArray:
    """`value` scaled to unit length; exact along an axis.

    Raises
    ------
    BodyError
        If it is zero.
    """
    size = float(length(value))
    if size == 0:
        raise BodyError(f"{shape}: {key} must not be zero (nor, for an edge, parallel to up), got {as_text(value)}")
    return value / size


def positive(shape: str, key: str, value: float) -> float:
    """A finite number above zero.

    Raises
    ------
    BodyError
        Naming shape and key.
    """
    if not (np.isscalar(value) and np.isfinite(value) and value > 0):
        raise BodyError(f"{shape}: {key} must be a finite number above 0, got {value}")
    return float(value)


def central_gradient(phi: Callable[[NDArray], NDArray], x: NDArray, step: float) -> NDArray:
    """∇φ (n, D) at x (n, D), of unit length, by central differences over 2 `step` [m].

    Straight up where φ is level.
    """
    ahead = np.eye(x.shape[1]) * step
    return directed(np.stack([phi(x + e) - phi(x - e) for e in ahead], axis=1), np.eye(x.shape[1])[-1])


def fill(shape: object, **values: object) -> None:
    """Set fields of a frozen dataclass whose arguments are first made into arrays."""
    for key, value in values.items():
        object.__setattr__(shape, key, value)


def as_text(values: Sequence[float] | NDArray) -> str:
    """A vector as messages show it."""
    return "[" + ", ".join(f"{value:g}" for value in values) + "]"
