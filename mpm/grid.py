"""The nodes that particles touch, numbered compactly: memory follows the occupied cells, not the box around them."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from .kernel import Kernel, box_for
from .particles import Particles


def nowhere(ident: int, x: NDArray) -> FloatingPointError:
    """What to raise for a particle that has no cell."""
    place = ", ".join(f"{value:g}" for value in x)
    return FloatingPointError(f"particle {ident} is at ({place}): must be finite and within 1e9 cells of the origin")


class Grid:
    """Active nodes of this rank's particles, which it sorts by cell.

    Attributes
    ----------
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
        order = np.empty(n, dtype=np.int32)
        start = np.empty(n + 1, dtype=np.int32)
        base = np.empty((n, d), dtype=np.int32)
        scratch = np.empty(3 * n + 1, dtype=np.uint64)
        self.cells = kernel.call(
            "sort", n, particles.position, particles.ident, h, self.box, order, start, base, scratch
        )
        particles.reorder(order, kernel)
        self.start, self.base = start[: self.cells + 1], base[: self.cells]
        words = int(self.box.words)
        for k in range(d - 1):
            words *= int(self.box.nodes[k])
        self._bits = np.zeros(words + 1, dtype=np.uint64)
        self._offset = np.zeros(words + 1, dtype=np.int32)
        self.count = kernel.call("number", self.cells, self.base, self.box, self._bits, self._offset)
        self.rows = np.empty((self.cells, kernel.rows), dtype=np.int32)
        self.node = np.empty((self.count, d), dtype=np.int32)
        kernel.call("rows", self.cells, self.base, self.box, self._bits, self._offset, self.rows, self.node)

    def zeros(self, components: int = 0, dtype: Any = float) -> NDArray:
        """A node array of zeros: (count, components), or (count,)."""
        return np.zeros((self.count, components) if components else self.count, dtype=dtype)

    def find(self, nodes: NDArray) -> NDArray:
        """Numbers of nodes given by their places (q, d) int32; -1 where there is none."""
        number = np.empty(len(nodes), dtype=np.int32)
        self.kernel.call("find", len(nodes), nodes, self.box, self._bits, self._offset, number)
        return number

    def positions(self) -> NDArray:
        """Where the nodes are [m], shape (count, d)."""
        return self.node * self.h

    def call(self, name: str, *arguments: Any) -> Any:
        """Run a loop of the kernel over this grid's cells."""
        return self.kernel.call(name, self.cells, self.start, self.rows, self.h, *arguments)
