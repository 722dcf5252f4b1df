"""What collision bodies do to velocities (7.7)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from extremal.obstacles.colliders import Collider
from extremal.obstacles.geometry import length


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
            relative, applied = respond(relative, collider.normal(points, t), collider.contact.friction)
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


def respond(relative: NDArray, n: NDArray, friction: float) -> tuple[NDArray, NDArray]:
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
