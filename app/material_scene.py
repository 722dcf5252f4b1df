"""[material] and [regions.NAME]: constitutive law, moduli, extension into the inverted region."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any, Literal

from pydantic import Field

from .errors import suggestion
from .scene_fields import FieldQuantity, NotNegative, Positive, Problem, Table, Text

Law = Literal["neo_hookean", "corotated", "fixed_corotated", "st_venant_kirchhoff", "mooney_rivlin", "custom"]
Extension = Literal["none", "c1", "c2", "ife"]

ENGINEERING = ("young_modulus", "poisson_ratio")
LAMÉ = ("shear_modulus", "lame_lambda")
INVARIANTS = ("i1", "i2", "J", "I1", "I2")
STRETCHES = ("s1", "s2", "s3")
DEFAULT_THRESHOLD = {"c1": 0.4, "c2": 0.9, "ife": 0.9, "none": 0.9}


class MaterialKeys(Table):
    """Any subset of a material's keys: what [regions.NAME] may override."""

    law: Law = Field("neo_hookean", description="constitutive law")
    young_modulus: FieldQuantity | None = Field(
        None, description="Young's modulus E [Pa]; number or expression of x, y, z [m]"
    )
    poisson_ratio: FieldQuantity | None = Field(
        None, description="Poisson's ratio ν [1], above -1 and below 0.5; number or expression of x, y, z [m]"
    )
    shear_modulus: FieldQuantity | None = Field(
        None, description="shear modulus μ [Pa], with lame_lambda instead of E and ν; number or expression"
    )
    lame_lambda: FieldQuantity | None = Field(
        None, description="first Lamé parameter λ [Pa]; number or expression of x, y, z [m]"
    )
    density: FieldQuantity | None = Field(
        None, description="reference density [kg/m3]; needed by dynamics and gravity; number or expression"
    )
    energy: Text | None = Field(
        None,
        description="custom law: energy density [Pa], an expression of the invariants i1, i2, J of the "
        "stretches, of I1, I2, J of their squares, or of the stretches s1, s2, s3; d is the dimension",
    )
    parameters: dict[str, FieldQuantity] = Field(
        default_factory=dict, description="custom law: name = number or expression of x, y, z [m]"
    )
    c1: NotNegative | None = Field(None, description="mooney_rivlin: coefficient of I1 [Pa]; default μ/4")
    c2: NotNegative | None = Field(None, description="mooney_rivlin: coefficient of I2 [Pa]; default μ/4")
    extension: Extension = Field(
        "c2", description="continuation of the energy where an element is nearly flat or inverted"
    )
    threshold: Positive = Field(
        default_factory=lambda data: DEFAULT_THRESHOLD.get(data.get("extension"), 0.9),
        description="stretch product (c2), stretch (c1, ife) below which the extension takes over [1]; "
        "0.9 for c2 and ife, 0.4 for c1",
    )
    stiffness: Positive | None = Field(
        None,
        description="stiffness k of the c1 extension [Pa]; by default the larger of 20 E and λ/threshold²",
    )

    def problems(self) -> Iterator[Problem]:
        """Yield what contradicts itself among the keys given."""
        yield from self._wrong_numbers()
        engineering = [key for key in ENGINEERING if getattr(self, key) is not None]
        lamé = [key for key in LAMÉ if getattr(self, key) is not None]
        if engineering and lamé and self.c1 is None and self.c2 is None:
            yield (
                (lamé[0],),
                f"given together with {engineering[0]}; give young_modulus and poisson_ratio, "
                "or shear_modulus and lame_lambda, not some of each",
            )
        owners = {"energy": "custom", "parameters": "custom", "c1": "mooney_rivlin", "c2": "mooney_rivlin"}
        for key, owner in owners.items():
            if self._says(key) and self._decides("law") and self.law != owner:
                yield (key,), f'belongs to law = "{owner}", but law is "{self.law}"'
        if self._says("stiffness") and self._decides("extension") and self.extension != "c1":
            yield ("stiffness",), f'belongs to extension = "c1", but extension is "{self.extension}"'
        if self._says("threshold"):
            if self._decides("extension") and self.extension == "none":
                yield ("threshold",), 'has no meaning with extension = "none"; leave one of them out'
            elif self.threshold >= 1:
                yield (
                    ("threshold",),
                    "must be above 0 and below 1: the body at rest may not be in the extension",
                )

    def _says(self, key: str) -> bool:
        return key in self.model_fields_set

    def _decides(self, key: str) -> bool:
        """Tell whether this table settles a key: a region which is silent takes it from [material]."""
        return self._says(key) or isinstance(self, Material)

    def _wrong_numbers(self) -> Iterator[Problem]:
        ν = self.poisson_ratio
        if isinstance(ν, float) and not -1 < ν < 0.5:
            yield ("poisson_ratio",), "must be above -1 and below 0.5 (nearly incompressible: 0.499)"
        for key in ("young_modulus", "shear_modulus", "density"):
            value = getattr(self, key)
            if isinstance(value, float) and value <= 0:
                yield (key,), "must be above 0"
        μ, λ = self.shear_modulus, self.lame_lambda
        if isinstance(μ, float) and isinstance(λ, float) and μ > 0 and λ <= -2 * μ / 3:
            yield (
                ("lame_lambda",),
                f"must be above -2/3 shear_modulus = {-2 * μ / 3:.6g} for a stable material",
            )


class Material(MaterialKeys):
    """[material]: law, moduli and extension; complete."""

    def problems(self) -> Iterator[Problem]:
        """Yield contradictions and what is missing."""
        yield from super().problems()
        yield from self._wrong_energy()
        if self.law == "custom":
            if self.energy is None:
                yield ("energy",), 'is missing; law = "custom" needs an energy as an expression of i1, i2, J'
            yield from self._incomplete_pair(needed=False)
        elif self.law == "mooney_rivlin":
            yield from self._incomplete_mooney_rivlin()
        else:
            yield from self._incomplete_pair(needed=True)

    def _wrong_energy(self) -> Iterator[Problem]:
        reserved = {*INVARIANTS, *STRETCHES, "d", "x", "y", "z", "t", "pi", "e"}
        for name in self.parameters:
            if not re.fullmatch(r"[A-Za-zα-ωΑ-Ω_][A-Za-z0-9α-ωΑ-Ω_]*", name):
                yield ("parameters", name), "a parameter's name must be made of letters, digits and _"
            elif name in reserved:
                yield ("parameters", name), "this name is taken; choose another for the parameter"
        if self.energy is None:
            return
        from .expression import ExpressionError, parse

        names = [*INVARIANTS, *STRETCHES, "d", *self.parameters]
        if self.young_modulus is not None or self.shear_modulus is not None:
            names += ["mu", "lam"]
        try:
            used = {str(symbol) for symbol in parse(self.energy, names).free_symbols}
        except ExpressionError as error:
            yield ("energy",), str(error)
            return
        if not used & {*INVARIANTS, *STRETCHES}:
            yield ("energy",), "depends on no deformation; use i1, i2, J or I1, I2, J or s1, s2, s3"
        if used & {*STRETCHES} and used & {"i1", "i2", "I1", "I2"}:
            yield ("energy",), "mixes stretches s1, s2, s3 with invariants; use one kind (J goes with both)"
        for name in self.parameters:
            if name not in used and re.fullmatch(r"\w+", name):
                yield ("parameters", name), "is not used by the energy; " + suggestion(name, sorted(used))

    def _incomplete_pair(self, needed: bool) -> Iterator[Problem]:
        given = [key for key in (*ENGINEERING, *LAMÉ) if getattr(self, key) is not None]
        if not given and needed:
            yield (
                ("young_modulus",),
                "is missing; give young_modulus and poisson_ratio, or shear_modulus and lame_lambda",
            )
        for pair in (ENGINEERING, LAMÉ):
            here = [key for key in pair if key in given]
            if len(given) == len(here) == 1:
                missing = pair[1 - pair.index(here[0])]
                yield (missing,), f"is missing; {here[0]} alone does not determine the material"

    def _incomplete_mooney_rivlin(self) -> Iterator[Problem]:
        if self.c1 is None and self.c2 is None:
            # c1 = c2 = μ/4
            yield from self._incomplete_pair(needed=True)
            return
        for key in ("c1", "c2"):
            if getattr(self, key) is None:
                yield (key,), "is missing; mooney_rivlin takes both c1 and c2, or neither"
        if self.c1 is not None and self.c2 is not None and self.c1 + self.c2 <= 0:
            yield ("c1",), "c1 + c2 must be above 0 (half the shear modulus)"
        for key in ("young_modulus", "shear_modulus"):
            if getattr(self, key) is not None:
                yield (key,), "is determined by c1 and c2 (μ = 2 (c1 + c2)); leave one of them out"
        volumetric = [key for key in ("poisson_ratio", "lame_lambda") if getattr(self, key) is not None]
        if not volumetric:
            yield ("poisson_ratio",), "is missing; c1 and c2 need poisson_ratio or lame_lambda beside them"
        elif len(volumetric) == 2:
            yield ("lame_lambda",), "given together with poisson_ratio; leave one of them out"


def merged(base: MaterialKeys, region: MaterialKeys) -> dict[str, Any]:
    """Return the keys of `base` overridden by those of `region`.

    A region with another law, extension or pair of moduli does not inherit what belonged to the old one.
    """
    old, new = base.given(), region.given()
    dropped: set[str] = set()
    if new.get("law", base.law) != base.law:
        dropped |= {"energy", "parameters", "c1", "c2"}
        if "mooney_rivlin" in (base.law, new["law"]):
            dropped |= {*ENGINEERING, *LAMÉ} if new.keys() & {*ENGINEERING, *LAMÉ} else set()
    if new.get("extension", base.extension) != base.extension:
        dropped |= {"threshold", "stiffness"}
    if all(key in new for key in LAMÉ):
        dropped |= {*ENGINEERING}
    if all(key in new for key in ENGINEERING):
        dropped |= {*LAMÉ}
    return {key: value for key, value in old.items() if key not in dropped} | new
