"""What follows from the particles' state alone: moduli for force and Hessian, and how fast things travel."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .kernel import MODULI, Kernel
from .particles import Particles


@dataclass(frozen=True)
class Moduli:
    """Worked out once, for the end of a step and the beginning of the next.

    Attributes
    ----------
    values : (n, 4)
        Hardened, times the particle's volume; see snow.h.
    speed, wave : float
        Largest entry of a velocity and fastest elastic wave [m/s] of this rank's particles.
    stretch : NDArray
        `Particles.stretch` it was made from.
    """

    values: NDArray
    speed: float
    wave: float
    stretch: NDArray

    @classmethod
    def of(cls, kernel: Kernel, p: Particles, laws: NDArray) -> Moduli:
        """Moduli of the particles as they are, `laws` being `law.table`."""
        values, fastest = np.empty((len(p), MODULI)), np.empty(2)
        kernel.call(
            "moduli", len(p), p.velocity, p.stretch, p.plastic, p.volume, p.stiffness, p.body, laws, values, fastest
        )
        return cls(values, float(fastest[0]), float(fastest[1]), p.stretch)

    def belong_to(self, p: Particles) -> bool:
        """Whether they are row by row those of `p`: sorting, migrating and restarting make new arrays."""
        return self.stretch is p.stretch
