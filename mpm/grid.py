"""The nodes that particles touch, numbered compactly: memory follows the occupied cells, not the box around them."""

from __future__ import annotations

from math import prod
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .kernel import NODES, Kernel, box_for
from .particles import Particles

# A bit for each node of the box around the particles is the fastest way to number them, as long as the box has at most
# this many 64-bit words, or this many a particle. Far-flung particles beyond it are numbered by sorting.
MOST_WORDS = 1 << 22
WORDS_PER_PARTICLE = 16

# Particles are read in the order of their cells wherever they stand in memory; they are moved there when this share of
# them does not stand next to the one before.
MOST_JUMPS = 0.1


def nowhere(ident: int, x: NDArray) -> FloatingPointError:
    """What to raise for a particle that has no cell."""
    place = ", ".join(f"{value:g}" for value in x)
    return FloatingPointError(f"particle {ident} is at ({place}): must be finite and within 1e9 cells of the origin")


class Grid:
    """Active nodes of this rank's particles, and the particles by cell.

    Attributes
    ----------
    order : (n,) int32
        Particles by cell, and by `ident` within a cell. Making a grid may bring the particles themselves in this order.
    count : int
        Number of nodes.
    node : (count, d) int32
        Where they are, in units of h.
    cells : int
        Occupied cells.
    """

    def __init__(self, kernel: Kernel, h: float, particles: Particles) -> None:
        self.kernel, self.h = kernel, h
        d, n = kernel.dimension, len(particles)
        self.box = box_for(d)
        bad = kernel.call("box", n, particles.position, h, self.box)
        if bad:
            x = particles.position[bad - 1]
            raise nowhere(int(particles.ident[bad - 1]), x)
        self._sides = [int(self.box.nodes[k]) for k in range(d)]
        if prod(self._sides) >= 1 << 62:
            raise FloatingPointError(f"particles are spread over {' x '.join(map(str, self._sides))} cells: too far")
        order = np.empty(n, dtype=np.int32)
        start = np.empty(n + 1, dtype=np.int32)
        base = np.empty((n, d), dtype=np.int32)
        scratch = np.empty(3 * n + 1, dtype=np.uint64)
        jumps = np.zeros(1, dtype=np.int64)
        self.cells = kernel.call(
            "sort", n, particles.position, particles.ident, h, self.box, order, start, base, scratch, jumps
        )
        if jumps[0] > MOST_JUMPS * n:
            particles.reorder(order, kernel)
            order = np.arange(n, dtype=np.int32)
        self.order = order
        self.start, self.base = start[: self.cells + 1], base[: self.cells]
        self._keys: NDArray | None = None  # of all nodes, where they are numbered by sorting
        words = int(self.box.words) * prod(self._sides[:-1])
        if words > max(MOST_WORDS, WORDS_PER_PARTICLE * n):
            self._number_by_sorting()
        else:
            self._number_by_bits(words)

    def _number_by_bits(self, words: int) -> None:
        kernel, d = self.kernel, self.kernel.dimension
        self._bits = np.zeros(words + 1, dtype=np.uint64)
        self._offset = np.zeros(words + 1, dtype=np.int32)
        self.count = kernel.call("number", self.cells, self.base, self.box, self._bits, self._offset)
        self.rows = np.empty((self.cells, kernel.rows), dtype=np.int32)
        self.node = np.empty((self.count, d), dtype=np.int32)
        kernel.call("rows", self.cells, self.base, self.box, self._bits, self._offset, self.rows, self.node)

    def _number_by_sorting(self) -> None:
        d, width = self.kernel.dimension, NODES[self.kernel.spline]
        steps = np.indices((width,) * d).reshape(d, -1).T
        touched = self._key(self.base[:, None, :] + steps)
        self._keys, number = np.unique(touched, return_inverse=True)
        self.count = len(self._keys)
        self.rows = np.ascontiguousarray(number.reshape(self.cells, -1)[:, ::width], dtype=np.int32)
        self.node = np.column_stack(np.unravel_index(self._keys, self._sides)).astype(np.int32)
        self.node += np.array(self.box.low[:d], dtype=np.int32)

    def _key(self, nodes: NDArray) -> NDArray:
        """Where nodes (..., d) of the box stand in the order of numbering, gaps included."""
        away = np.moveaxis(nodes.astype(np.int64) - np.array(self.box.low[: self.kernel.dimension]), -1, 0)
        return np.ravel_multi_index(tuple(away), self._sides)

    def zeros(self, components: int = 0, dtype: Any = float) -> NDArray:
        """A node array of zeros: (count, components), or (count,)."""
        return np.zeros((self.count, components) if components else self.count, dtype=dtype)

    def find(self, nodes: NDArray) -> NDArray:
        """Numbers of nodes given by their places (q, d) int32; -1 where there is none."""
        if self._keys is not None:
            low = np.array(self.box.low[: self.kernel.dimension], dtype=np.int64)
            inside = ((nodes >= low) & (nodes < low + self._sides)).all(axis=1)
            key = self._key(np.where(inside[:, None], nodes, low))
            at = np.minimum(np.searchsorted(self._keys, key), self.count - 1)
            return np.where(inside & (self._keys[at] == key), at, -1).astype(np.int32)
        number = np.empty(len(nodes), dtype=np.int32)
        self.kernel.call("find", len(nodes), nodes, self.box, self._bits, self._offset, number)
        return number

    def positions(self) -> NDArray:
        """Where the nodes are [m], shape (count, d)."""
        return self.node * self.h

    def call(self, name: str, *arguments: Any) -> Any:
        """Run a loop of the kernel over this grid's cells."""
        return self.kernel.call(name, self.cells, self.start, self.order, self.rows, self.h, *arguments)
