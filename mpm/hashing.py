"""Random numbers that depend on whole numbers alone: a cell's, wherever and whenever it is asked for."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def hash_uniform(*numbers: int | NDArray) -> NDArray:
    """A number in [0, 1) for each tuple of whole numbers (broadcast), as good as random."""
    return (hash_bits(*numbers) >> np.uint64(11)) * 2.0**-53


def hash_bits(*numbers: int | NDArray) -> NDArray:
    """64 bits from each tuple of whole numbers: splitmix64's finaliser, chained.

    NumPy's generators are streams; here each cell needs its own, whatever cells came before.
    """
    state = np.uint64(0)
    with np.errstate(over="ignore"):
        for number in numbers:
            word = np.asarray(number)
            word = word if word.dtype == np.uint64 else word.astype(np.int64).view(np.uint64)
            state = (np.atleast_1d(state) ^ word) + np.uint64(0x9E3779B97F4A7C15)
            state = (state ^ (state >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
            state = (state ^ (state >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
            state = state ^ (state >> np.uint64(31))
    return np.asarray(state)
