"""The TOML of a sweep: which scene or case, what is changed, how the error is measured."""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, PrivateAttr, ValidationError

from ..errors import InputError, suggestion
from ..scene import PARTS, read_toml
from ..scene_common import PetscValue, petsc_names
from ..scene_errors import problem_line, problems_of
from ..scene_fields import Integer, Names, Number, Positive, Problem, Table, Text, wrong


def _value(value: Any) -> Any:
    if not isinstance(value, bool | int | float | str):
        raise wrong("must be a number, a text, true or false")
    return value


AnyValues = tuple[Annotated[Any, BeforeValidator(_value)], ...]
Values = Annotated[AnyValues, Field(min_length=1)]


class ErrorMeasure(Table):
    """[error]: what is compared with the reference."""

    diagnostic: Text | None = Field(None, description="a diagnostic at the end: |q - q_ref| / |q_ref|")
    history: Text | None = Field(None, description="a column of history.csv: relative l2 difference over time")
    field: Text | None = Field(None, description="a field at the points: relative root mean square at the end")
    density: Positive | None = Field(
        None, description="particles: l1 difference of mass in cells of this size [m], relative to the mass"
    )
    front: Literal["x", "y", "z"] | None = Field(
        None, description="particles: how far along this axis 99% of the mass has come: |q - q_ref| / |q_ref|"
    )
    predictions: Literal["probability"] | None = Field(
        None, description="networks: share of an event's probability that is given to other pairs, mean over the events"
    )

    def problems(self) -> Iterator[Problem]:
        """Yield none, or more than one."""
        if len(self.given()) != 1:
            yield (), "must have exactly one of " + ", ".join(type(self).model_fields)

    def __str__(self) -> str:
        ((kind, what),) = self.given().items()
        return {
            "diagnostic": f"relative error of {what} at the end",
            "history": f"relative l2 error of {what} over time",
            "field": f"relative rms error of {what} at the end",
            "density": f"relative l1 error of the mass in cells of {what} m",
            "front": f"relative error of the front in {what} at the end",
            "predictions": f"error of the {what} of pairs",
        }[kind]


class Reference(Table):
    """[reference]: a finer run of the scene, or a number."""

    set: dict[str, Any] | None = Field(None, description="changes that make the scene the reference")
    quick: dict[str, Any] | None = Field(None, description="the same for --quick; default: set")
    value: Number | None = Field(None, description="what the diagnostic should be")

    def problems(self) -> Iterator[Problem]:
        """Yield none, or both."""
        if (self.set is None) == (self.value is None):
            yield (), "must have exactly one of set, value"
        elif self.quick is not None and self.set is None:
            yield ("quick",), "needs set"


class Method(Table):
    """[[method]]: a line of the picture."""

    name: Text = Field(description="name in picture and table")
    set: dict[str, Any] = Field(default_factory=dict, description="changes of the scene, or settings of the case")
    petsc: dict[str, PetscValue] = Field(default_factory=dict, description="PETSc options, without the dash")
    values: AnyValues | None = Field(
        None, description="values of the knob for this method, [] for one that has no such knob; default: the knob's"
    )
    quick: Values | None = Field(None, description="the same for --quick")

    def problems(self) -> Iterator[Problem]:
        """Yield what cannot be a PETSc option."""
        yield from petsc_names(self)


class Knob(Table):
    """[knob]: what is walked along each line."""

    key: Names = Field(description="the key, as mesh.cell_size, or a list of keys that take the same value")
    values: Values = Field(description="from coarse to fine")
    quick: Values | None = Field(None, description="values for --quick; default: the first two")


class Sweep(Table):
    """A sweep."""

    title: Text = Field("", description="what is studied, in a line")
    scene: Text | None = Field(None, description="scene file, relative to this file")
    case: Text | None = Field(None, description="a case of extremal.app.studies.cases")
    set: dict[str, Any] = Field(default_factory=dict, description="what all points have in common")
    error: ErrorMeasure | None = Field(None, description="how the error is measured (scenes)")
    reference: Reference | None = Field(None, description="what is compared with (scenes)")
    method: tuple[Method, ...] = Field(min_length=1, description="the lines of the picture")
    knob: Knob = Field(description="what is walked along each line")
    timeout: Positive = Field(600.0, description="time after which a point is given up [s]")
    repeat: Annotated[Integer, Field(ge=1, le=100)] = Field(
        1, description="runs of a point, of which the fastest counts; one for --quick"
    )
    _path: Path = PrivateAttr(default=Path("sweep"))

    @property
    def path(self) -> Path:
        """The file the sweep was read from."""
        return self._path

    @property
    def name(self) -> str:
        """What pictures and folders are called by."""
        return self._path.stem.replace("_", "-")

    @property
    def subject(self) -> str:
        """Name of the scene or the case."""
        return self.case or Path(str(self.scene)).stem

    @property
    def measure(self) -> str:
        """What the error is."""
        if self.case is None:
            return str(self.error)
        names: Mapping[str, str] = getattr(_case(self.case), "MEASURES", {})
        chosen = {**settings_of(self.case), **self.set}.get("error")
        return names.get(str(chosen), "relative error against the exact solution")

    @property
    def scene_path(self) -> Path:
        """The scene file."""
        return self._path.parent / str(self.scene)

    def problems(self) -> Iterator[Problem]:
        """Yield what is wrong between the tables."""
        if (self.scene is None) == (self.case is None):
            yield (), "must have exactly one of scene, case"
        for key in ("error", "reference"):
            if self.scene is not None and getattr(self, key) is None:
                yield (key,), f"is missing; a scene needs [{key}]"
            if self.case is not None and getattr(self, key) is not None:
                yield (key,), "belongs to a scene; a case knows its own"
        if self.error is not None and self.reference is not None and self.reference.value is not None:
            if self.error.diagnostic is None:
                yield ("reference", "value"), "needs [error] diagnostic"
        names = [method.name for method in self.method]
        for i, name in enumerate(names):
            if name in names[:i] or name == "reference":
                yield ("method", i, "name"), "this name is taken; choose another"

    def repeats(self, quick: bool) -> int:
        """Runs of a point."""
        return 1 if quick else self.repeat

    def values_of(self, method: Method, quick: bool) -> tuple[Any, ...]:
        """The knob's values along a line."""
        own = method.values
        if not quick:
            return self.knob.values if own is None else own
        return method.quick or (self.knob.quick or self.knob.values if own is None else own)[:2]


def load_sweep(path: Path) -> Sweep:
    """Read and validate a sweep.

    Raises
    ------
    InputError
        With a line for each thing wrong.
    """
    data = read_toml(path)
    try:
        sweep = Sweep.model_validate(data)
    except ValidationError as error:
        found = problems_of(error, Sweep)
        raise InputError(*(problem_line(str(path), data, where, words) for where, words in found)) from None
    sweep._path = path
    misfits = list(_outside(sweep))
    if misfits:
        raise InputError(*(problem_line(str(path), data, where, words) for where, words in misfits))
    return sweep


def _outside(sweep: Sweep) -> Iterator[Problem]:
    """What does not fit the scene or the case."""
    if sweep.case is not None:
        if sweep.case not in cases():
            yield ("case",), "unknown case; " + suggestion(sweep.case, cases())
            return
        known = settings_of(sweep.case)
        tables = [(("set",), sweep.set)] + [(("method", i, "set"), m.set) for i, m in enumerate(sweep.method)]
        for where, table in tables:
            for key in table:
                if key not in known:
                    yield (*where, key), "unknown setting; " + suggestion(key, known)
        for key in sweep.knob.key:
            if key not in known:
                yield ("knob", "key"), "unknown setting; " + suggestion(key, known)
    elif not sweep.scene_path.is_file():
        yield ("scene",), f"no such file: {sweep.scene_path.resolve()}"
    elif sweep.error is not None:
        yield from _measurable(sweep.error, read_toml(sweep.scene_path).get("part", "elastic"))


def _measurable(measure: ErrorMeasure, part: Any) -> Iterator[Problem]:
    if part not in PARTS:
        return  # the scene's own validation says so
    diagnostics = importlib.import_module(f"..{part}_scene", __package__).DIAGNOSTICS
    for kind in ("diagnostic", "history"):
        name = getattr(measure, kind)
        if name is not None and name not in diagnostics:
            yield ("error", kind), f"unknown diagnostic of {part}; " + suggestion(name, diagnostics)
    if measure.field is not None:
        from ..elastic_scene import POINT_FIELDS

        if part != "elastic":
            yield ("error", "field"), f"belongs to elastic scenes; this one's part is {part}"
        elif measure.field not in POINT_FIELDS:
            yield ("error", "field"), "unknown field at points; " + suggestion(measure.field, POINT_FIELDS)
    for kind, owner in (("density", "snow"), ("front", "snow"), ("predictions", "hawkes")):
        if getattr(measure, kind) is not None and part != owner:
            yield ("error", kind), f"belongs to scenes of {owner}; this one's part is {part}"


def cases() -> list[str]:
    """Names of the cases there are, without importing them."""
    package = importlib.import_module("..studies.cases", __package__)
    return sorted(m.name for m in pkgutil.iter_modules(package.__path__) if not m.name.startswith("_"))


def settings_of(case: str) -> Mapping[str, Any]:
    """Settings of a case and their defaults."""
    settings: Mapping[str, Any] = _case(case).KEYS
    return settings


def _case(case: str) -> Any:
    return importlib.import_module(f"..studies.cases.{case}", __package__)
