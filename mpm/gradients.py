"""Elastic and plastic deformation gradients: the dynamics do not need them, they are followed to be looked at."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .particles import Particles

AT_ONCE = 1 << 16  # particles per pass: what a pass needs stays below about 50 MB


def follow(p: Particles, gradient: NDArray, dt: float) -> None:
    """Take F_E and F_P over a step whose flow has made W and J_P new (7.6, 7.11, 7.12).

    F_E^trial = (1 + Δt ∇v) F_E = V R;  F_E = W R, since W differs from V by its clamped stretches only;
    F_P = F_E⁻¹ F_E^trial F_P, so that the product F_E F_P is the whole deformation.

    Parameters
    ----------
    p : Particles
        Carries gradients; `p.stretch` is that after the step.
    gradient : (n, d²) [1/s]
        ∇v of the step.
    """
    assert p.elastic_gradient is not None and p.plastic_gradient is not None
    d = p.dimension
    for start in range(0, len(p), AT_ONCE):
        some = slice(start, start + AT_ONCE)
        elastic, plastic, G = (a[some].reshape(-1, d, d) for a in (p.elastic_gradient, p.plastic_gradient, gradient))
        trial = elastic + dt * (G @ elastic)
        left, _, right = np.linalg.svd(trial)
        elastic[:] = symmetric(p.stretch[some], d) @ left @ right
        plastic[:] = np.linalg.solve(elastic, trial @ plastic)


def symmetric(packed: NDArray, d: int) -> NDArray:
    """Matrices (n, d, d) of their upper triangles by rows."""
    full = np.empty((len(packed), d, d))
    i, j = np.triu_indices(d)
    full[:, i, j] = full[:, j, i] = packed
    return full
