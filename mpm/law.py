"""What a body of snow, or an elastic one, is made of (7.1, 7.2, table 7.2)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .kernel import LAW

ENERGIES = {"snow": 0, "fixed_corotated": 0, "neo_hookean": 1}


class LawError(ValueError):
    """A material cannot be used; the message is one line for the user."""


@dataclass(frozen=True)
class Law:
    """Material of a body.

    Attributes
    ----------
    name : str
        "snow" (7.1 with plasticity and hardening), "fixed_corotated" or "neo_hookean" (purely elastic).
    young_modulus : float
        E0 [Pa].
    poisson_ratio : float
    density : float
        [kg/m³]; in two dimensions per metre of thickness.
    critical_compression, critical_stretch : float
        θc, θs: elastic stretches stay in [1 - θc, 1 + θs].
    hardening : float
        ξ of (7.2).
    hardening_cap : float
        Largest |ξ (1 - J_P)|: (7.2) overflows without it.
    """

    name: str = "snow"
    young_modulus: float = 1.4e5
    poisson_ratio: float = 0.2
    density: float = 400.0
    critical_compression: float = 2.5e-2
    critical_stretch: float = 7.5e-3
    hardening: float = 10.0
    hardening_cap: float = 3.0

    def __post_init__(self) -> None:
        if self.name not in ENERGIES:
            raise LawError(f"law {self.name!r} is unknown: one of {', '.join(ENERGIES)}")
        accepted = {
            "young_modulus": (self.young_modulus > 0, "above 0"),
            "poisson_ratio": (-1 < self.poisson_ratio < 0.5, "above -1 and below 0.5"),
            "density": (self.density > 0, "above 0"),
            "critical_compression": (0 < self.critical_compression < 1, "above 0 and below 1"),
            "critical_stretch": (self.critical_stretch > 0, "above 0"),
            "hardening": (self.hardening >= 0, "0 or more"),
            "hardening_cap": (0 < self.hardening_cap <= 50, "above 0 and at most 50"),
        }
        for key, (good, words) in accepted.items():
            if not good:
                raise LawError(f"{key} = {getattr(self, key):g}: must be {words}")

    @property
    def is_plastic(self) -> bool:
        """Whether stretches are clamped and the rest goes into J_P."""
        return self.name == "snow"

    @property
    def lame(self) -> tuple[float, float]:
        """μ0, λ0 [Pa]."""
        E, ν = self.young_modulus, self.poisson_ratio
        return E / (2 * (1 + ν)), E * ν / ((1 + ν) * (1 - 2 * ν))

    @property
    def wave_speed(self) -> float:
        """Speed of longitudinal waves [m/s] at rest: sqrt((λ0 + 2 μ0)/ρ)."""
        μ, λ = self.lame
        return float(np.sqrt((λ + 2 * μ) / self.density))


def table(laws: Sequence[Law]) -> NDArray:
    """The laws as the kernel reads them."""
    out = np.zeros(len(laws), dtype=LAW)
    for k, law in enumerate(laws):
        μ, λ = law.lame
        bounds = (1 - law.critical_compression, 1 + law.critical_stretch)
        out[k] = (μ, λ, law.hardening, *bounds, law.hardening_cap, law.wave_speed, ENERGIES[law.name], law.is_plastic)
    return out
