"""Materials: a law, its extension and its parameters, which may vary from cell to cell."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from .laws import Law, LawError

Field = float | Callable[[NDArray], NDArray]  # a number, or a function of positions (n, 3) [m]
DEFAULT_THRESHOLD = {"none": 0.0, "c1": 0.4, "c2": 0.9, "ife": 0.9}


def lame_parameters(young_modulus: NDArray, poisson_ratio: NDArray) -> tuple[NDArray, NDArray]:
    """μ = E/(2(1+ν)), λ = Eν/((1+ν)(1-2ν)) [Pa]; in two dimensions this is plane strain."""
    return (
        young_modulus / (2 * (1 + poisson_ratio)),
        young_modulus * poisson_ratio / ((1 + poisson_ratio) * (1 - 2 * poisson_ratio)),
    )


def young_poisson(shear_modulus: NDArray, lame_lambda: NDArray) -> tuple[NDArray, NDArray]:
    """E = μ(3λ+2μ)/(λ+μ) [Pa], ν = λ/(2(λ+μ))."""
    both = lame_lambda + shear_modulus
    return shear_modulus * (3 * lame_lambda + 2 * shear_modulus) / both, lame_lambda / (2 * both)


@dataclass(frozen=True)
class Material:
    """A law with its parameters.

    Attributes
    ----------
    law : Law
    moduli : mapping
        Either young_modulus [Pa] and poisson_ratio, or shear_modulus and lame_lambda [Pa]; numbers or functions
        of position (n, 3) [m]. May be empty for a custom law that uses neither.
    parameters : mapping
        The further parameters of a custom law; of mooney_rivlin its `share` (0.5 if left out).
    density : Field
        Reference density [kg/m³].
    extension : str
        "none", "c1", "c2" or "ife".
    threshold : float or None
        ε: the J (C2, IFE) or the stretch (C1) under which the extension takes over. Default 0.9, C1 0.4.
    stiffness : float or None
        k of the C1 extension [Pa]. Default max(20 E, λ/ε²): below λ/ε² the extended energy has a minimum with a
        negative value among the inverted states.
    """

    law: Law
    moduli: Mapping[str, Field]
    parameters: Mapping[str, Field] = field(default_factory=dict)
    density: Field = 1.0
    extension: str = "c2"
    threshold: float | None = None
    stiffness: float | None = None

    @property
    def epsilon(self) -> float:
        """The threshold in force."""
        return DEFAULT_THRESHOLD[self.extension] if self.threshold is None else self.threshold

    def engineering(self, x: NDArray) -> tuple[NDArray, NDArray]:
        """E [Pa] and ν at positions x (n, 3)."""
        values = {name: _at(value, x) for name, value in self.moduli.items()}
        if "young_modulus" in values:
            return values["young_modulus"], values["poisson_ratio"]
        if "shear_modulus" in values:
            return young_poisson(values["shear_modulus"], values["lame_lambda"])
        return np.ones(len(x)), np.zeros(len(x))

    def values(self, x: NDArray, poisson_ratio: float | None = None, threshold: float | None = None) -> NDArray:
        """Kernel parameters at positions x (n, 3): (n, law parameters + 2).

        `poisson_ratio` is an upper bound on ν and `threshold` replaces ε while a continuation is on its way.

        Raises
        ------
        LawError
            A modulus out of range, with the place where it is.
        """
        young, poisson = self.engineering(x)
        _check(young > 0, "young_modulus", young, x, "above 0")
        _check((poisson > -1) & (poisson < 0.5), "poisson_ratio", poisson, x, "above -1 and below 0.5")
        if poisson_ratio is not None:
            poisson = np.minimum(poisson, poisson_ratio)
        mu, lam = lame_parameters(young, poisson)
        epsilon = self.epsilon if threshold is None else threshold
        stiffness = np.zeros(len(x))
        if self.extension == "c1":
            safe = np.maximum(20 * young, lam / epsilon**2)
            stiffness = safe if self.stiffness is None else np.full(len(x), float(self.stiffness))
        extra = [_at(self.parameters.get(str(name), 0.5), x) for name in self.law.parameters[2:]]
        return np.column_stack([mu, lam, *extra, np.full(len(x), epsilon), stiffness])

    def warnings(self, x: NDArray) -> list[str]:
        """What the user should know about these parameters."""
        if self.extension != "c1" or self.stiffness is None or len(x) == 0:
            return []
        young, poisson = self.engineering(x)
        least = float((lame_parameters(young, poisson)[1] / self.epsilon**2).max())
        if self.stiffness >= least:
            return []
        return [
            f"stiffness = {self.stiffness:g} Pa of the C1 extension is below λ/ε² = {least:g} Pa: "
            "inverted states can have less energy than rest"
        ]


def _at(value: Field, x: NDArray) -> NDArray:
    if callable(value):
        return np.broadcast_to(np.asarray(value(x), dtype=float), (len(x),)).astype(float)
    return np.full(len(x), float(value))


def density_at(material: Material, x: NDArray) -> NDArray:
    """ρ [kg/m³] at positions x (n, 3); raises `LawError` where it is not positive."""
    rho = _at(material.density, x)
    _check(rho > 0, "density", rho, x, "above 0")
    return rho


def _check(good: NDArray, name: str, values: NDArray, x: NDArray, accepted: str) -> None:
    if np.all(good):
        return
    k = int(np.argmin(good))
    place = ", ".join(f"{c:.4g}" for c in x[k])
    raise LawError(f"{name} = {values[k]:.6g} at ({place}): must be {accepted}")
