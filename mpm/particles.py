"""Particles: the material points that carry mass, velocity and deformation."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from .kernel import Kernel


@dataclass
class Particles:
    """Material points of this rank; row p of every array is the same particle.

    Attributes
    ----------
    position : (n, d) [m]
    velocity : (n, d) [m/s]
    mass : (n,) [kg]
    volume : (n,) [m^d]
        At rest; 0 until the first step measures it.
    stretch : (n, d(d+1)/2)
        W = sqrt(F_E F_Eᵀ), upper triangle by rows.
    plastic : (n,)
        J_P = det F_P.
    stiffness : (n,)
        Factor of the body's moduli.
    body : (n,) int32
    ident : (n,) int64
        Number in the order of seeding, the same on any number of ranks.
    elastic_gradient, plastic_gradient : (n, d²) or None
        F_E and F_P by rows, where they are carried at all.
    """

    position: NDArray
    velocity: NDArray
    mass: NDArray
    volume: NDArray
    stretch: NDArray
    plastic: NDArray
    stiffness: NDArray
    body: NDArray
    ident: NDArray
    elastic_gradient: NDArray | None = None
    plastic_gradient: NDArray | None = None

    @classmethod
    def at(
        cls,
        position: NDArray,
        mass: NDArray | float,
        velocity: NDArray | float = 0.0,
        stiffness: NDArray | float = 1.0,
        body: NDArray | int = 0,
    ) -> Particles:
        """Particles at rest deformation at `position` (n, d)."""
        position = np.ascontiguousarray(position, dtype=float)
        n, d = position.shape
        identity = np.eye(d)[np.triu_indices(d)]
        return cls(
            position,
            np.broadcast_to(np.asarray(velocity, dtype=float), (n, d)).copy(),
            np.broadcast_to(np.asarray(mass, dtype=float), (n,)).copy(),
            np.zeros(n),
            np.tile(identity, (n, 1)),
            np.ones(n),
            np.broadcast_to(np.asarray(stiffness, dtype=float), (n,)).copy(),
            np.broadcast_to(np.asarray(body, dtype=np.int32), (n,)).copy(),
            np.arange(n, dtype=np.int64),
        )

    def carry_gradients(self) -> None:
        """Carry F_E and F_P from here on, where nothing is deformed yet."""
        d = self.dimension
        self.elastic_gradient, self.plastic_gradient = (np.tile(np.eye(d).ravel(), (len(self), 1)) for _ in range(2))

    def __len__(self) -> int:
        return len(self.position)

    @property
    def dimension(self) -> int:
        """2 or 3."""
        return self.position.shape[1]

    def arrays(self) -> dict[str, NDArray]:
        """All arrays that there are, by name."""
        named = ((field.name, getattr(self, field.name)) for field in fields(self))
        return {name: array for name, array in named if array is not None}

    def take(self, rows: NDArray) -> Particles:
        """The particles of `rows`, copied."""
        return Particles(**{name: np.ascontiguousarray(a[rows]) for name, a in self.arrays().items()})

    @staticmethod
    def join(parts: list[Particles]) -> Particles:
        """All particles of `parts`, in that order."""
        return Particles(**{name: np.concatenate([getattr(p, name) for p in parts]) for name in parts[0].arrays()})

    def reorder(self, order: NDArray, kernel: Kernel) -> None:
        """Sort in place: row p becomes the old row order[p]."""
        for name, source in self.arrays().items():
            target = np.empty_like(source)
            size = source.dtype.itemsize * (source.shape[1] if source.ndim == 2 else 1)
            kernel.call("permute", len(order), order, size, source, target)
            setattr(self, name, target)
