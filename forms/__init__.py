"""Invertible hyperelasticity: laws, extensions, weak forms, the SNES problem, time integration."""

from .conditions import Prescribed
from .laws import Law, LawError, custom, law
from .material import Field, Material
from .newton import StepFailure
from .problem import ElasticProblem, Stage

__all__ = [
    "ElasticProblem",
    "Field",
    "Law",
    "LawError",
    "Material",
    "Prescribed",
    "Stage",
    "StepFailure",
    "custom",
    "law",
]
