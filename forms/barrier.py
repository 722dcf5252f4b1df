"""Potentials of contact: a barrier of the distance, and Coulomb's friction made smooth."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def barrier(phi: NDArray, reach: float) -> tuple[NDArray, NDArray, NDArray]:
    """b(φ) = -(φ - d̂)² ln(φ/d̂) for 0 < φ < d̂ and 0 beyond, twice continuously differentiable.

    Li et al., "Incremental Potential Contact" (2020), eq. 6.

    Parameters
    ----------
    phi : (n,) [m]
        Above zero.
    reach : float [m]
        d̂.

    Returns
    -------
    b [m²], b' [m] (at most 0), b'' [1] (at least 0), each (n,)
    """
    ratio = np.minimum(phi / reach, 1.0)
    short, log = 1 - ratio, np.log(ratio)
    b = -(short**2) * log * reach**2
    first = (2 * short * log - short**2 / ratio) * reach
    second = -2 * log + short * (1 + 3 * ratio) / ratio**2
    return b, first, second


def slip(size: NDArray, still: float) -> tuple[NDArray, NDArray, NDArray]:
    """f(s) = s²/ε - s³/(3 ε²) for s < ε and s - ε/3 beyond: |s| with a round foot, to third order.

    Friction of size μ λ f'(s) is below μ λ as long as what slides has slid by less than ε; the same paper, eq. 14.

    Parameters
    ----------
    size : (n,) [m]
        s, 0 or above.
    still : float [m]
        ε.

    Returns
    -------
    f [m], f'/s [1/m], f'' [1/m], each (n,)
    """
    inside = size < still
    ratio = np.where(inside, size / still, 1.0)
    f = np.where(inside, still * ratio**2 * (1 - ratio / 3), size - still / 3)
    over = np.where(inside, (2 - ratio) / still, 1 / np.maximum(size, still))
    return f, over, np.where(inside, 2 * (1 - ratio) / still, 0.0)
