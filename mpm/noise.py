"""Multipliers of stiffness and density that differ from particle to particle (7.9)."""

from __future__ import annotations

from itertools import product

import numpy as np
from numpy.typing import NDArray

from extremal.obstacles.geometry import BodyError, positive
from extremal.obstacles.shapes import Shape

from .hashing import hash_uniform


def shell_profile(shape: Shape, x: NDArray, thickness: float, factor: float) -> NDArray:
    """Multiplier that is `factor` on the surface and 1 deeper than `thickness`: the crust of a snowball.

    1 + (factor - 1) s²(3 - 2s), with s = 1 + φ/thickness between 0 and 1.

    Parameters
    ----------
    shape : Shape
    x : (n, D) [m]
        Particles, where they were seeded.
    thickness : float [m]
    factor : float
        Above 0; above 1 is harder or heavier outside.

    Returns
    -------
    NDArray, shape (n,)

    Raises
    ------
    BodyError
        If a number is not positive.
    """
    s = np.clip(1 + shape.distance(x) / positive("shell", "thickness", thickness), 0.0, 1.0)
    return 1 + (positive("shell", "factor", factor) - 1) * s**2 * (3 - 2 * s)


def noise(x: NDArray, wavelength: float, amplitude: float, seed: int = 0, octaves: int = 3) -> NDArray:
    """Multiplier (1 + amplitude)^ν with a smooth random pattern -1 <= ν <= 1 of mean 0.

    ν is value noise: random values at the corners of cubes, smoothly interpolated; each further octave has half
    the size and half the weight. It depends on seed and place only, so it is the same on any number of ranks.

    Parameters
    ----------
    x : (n, D) [m]
        Particles, where they were seeded.
    wavelength : float [m]
        Edge of the largest cubes: the size of lumps.
    amplitude : float
        0 or above; multipliers lie between 1/(1 + amplitude) and 1 + amplitude.
    seed : int
    octaves : int
        1 or more.

    Returns
    -------
    NDArray, shape (n,)

    Raises
    ------
    BodyError
        If a number is out of range.
    """
    positive("noise", "wavelength", wavelength)
    if not (amplitude >= 0 and np.isfinite(amplitude)):
        raise BodyError(f"noise: amplitude must be a finite number, 0 or above, got {amplitude}")
    if not 1 <= octaves <= 16:
        raise BodyError(f"noise: octaves must be from 1 to 16, got {octaves}")
    weights = 0.5 ** np.arange(octaves)
    pattern = np.zeros(len(x))
    for octave, weight in enumerate(weights / weights.sum()):
        pattern += weight * _value_noise(x * (2.0**octave / wavelength), seed, octave)
    return (1 + amplitude) ** pattern


def _value_noise(x: NDArray, seed: int, octave: int) -> NDArray:
    """Random values in [-1, 1) at whole numbers, interpolated with s²(3 - 2s) along each axis: (n,) at x (n, D)."""
    cell = np.floor(x)
    s = x - cell
    s = s**2 * (3 - 2 * s)
    corner = cell.astype(np.int64)
    out = np.zeros(len(x))
    for step in product((0, 1), repeat=x.shape[1]):
        weight = np.prod(np.where(step, s, 1 - s), axis=1)
        out += weight * (2 * hash_uniform(seed, octave, *(corner + step).T) - 1)
    return out
