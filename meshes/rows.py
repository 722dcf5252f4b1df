"""Equal rows of integer arrays: the one question that duplicates, shared facets and tagged facets all ask."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def number_rows(rows: NDArray[np.int64]) -> NDArray[np.int64]:
    """Number the distinct rows of non-negative integers: equal rows, equal numbers, shape (len(rows),)."""
    number = np.zeros(len(rows), dtype=np.int64)
    # Column by column: keys stay below rows x (largest entry + 1), and sorting stays on plain integers.
    for column in rows.T:
        _, number = np.unique(number * (int(column.max(initial=0)) + 1) + column, return_inverse=True)
        number = number.reshape(-1)
    return number
