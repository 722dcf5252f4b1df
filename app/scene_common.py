"""What the scenes of all parts have in common: [petsc], [expect], where they came from, their common checks."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any

from pydantic import BeforeValidator, Field, PrivateAttr

from .errors import suggestion
from .scene_fields import NotNegative, Number, NumberOrText, Problem, Table, wrong

Where = tuple[str | int, ...]


class Expectation(Table):
    """One entry of [expect]: what a diagnostic must be at the end."""

    value: NumberOrText | None = Field(None, description='expected value, for status a text as "finished"')
    tolerance: NotNegative | None = Field(
        None, description="accepted difference from value; default 1e-6 |value|"
    )
    below: Number | None = Field(None, description="the diagnostic must be below this")
    above: Number | None = Field(None, description="the diagnostic must be above this")

    def problems(self) -> Iterator[Problem]:
        """Yield an expectation without meaning."""
        if self.value is None and self.below is None and self.above is None:
            yield (), "must be a number, or say value, below or above, as { below = 1e-6 }"
        elif isinstance(self.value, str) and (self.below, self.above, self.tolerance) != (None, None, None):
            yield ("value",), "must be a number where below, above or tolerance is given"
        elif self.tolerance is not None and self.value is None:
            yield ("tolerance",), "needs a value"


def _expectation(value: Any) -> Any:
    if isinstance(value, bool):
        raise wrong("must be a number, or say value, below or above, as { below = 1e-6 }")
    return {"value": value} if isinstance(value, int | float | str) else value


def _petsc_value(value: Any) -> Any:
    if not isinstance(value, bool | int | float | str):
        raise wrong("must be text, a number, true or false")
    return value


PetscValue = Annotated[Any, BeforeValidator(_petsc_value)]
Expected = Annotated[Expectation, BeforeValidator(_expectation)]


class Scene(Table):
    """A scene of any part."""

    _path: Path | None = PrivateAttr(default=None)
    # What the file says, word for word, for messages.
    _source: dict[str, Any] = PrivateAttr(default_factory=dict)

    @property
    def path(self) -> Path | None:
        """The file the scene was read from."""
        return self._path

    def beside(self, file: str) -> Path:
        """Return a file that the scene names, found from the scene's folder."""
        return (self._path.parent if self._path is not None else Path()) / file

    def files(self) -> Iterator[tuple[Where, Path]]:
        """Yield the files that the scene names, and where it names them."""
        yield from ()


# Tables that a check between tables consults, and the check: a scene in, problems out.
Check = tuple[set[str], Callable[[Any], Iterator[Problem]]]


def cross_checks(scene: Scene, checks: Iterable[Check], missing: Iterable[str] = ()) -> Iterator[Problem]:
    """Yield what is wrong between the tables of a scene whose tables are each right by themselves.

    Parameters
    ----------
    scene : Scene
    checks : iterable of Check
    missing : iterable of str
        Tables with errors of their own, replaced by stand-ins: whatever would consult them is left unchecked.
    """
    absent = set(missing)
    for tables, check in checks:
        if not tables & absent:
            yield from (problem for problem in check(scene) if problem[0][0] not in absent)


def petsc_names(scene: Any) -> Iterator[Problem]:
    """Yield what in [petsc] cannot be the name of an option."""
    for key in scene.petsc:
        if not re.fullmatch(r"[A-Za-z][A-Za-z0-9_]*", key):
            hint = "without the dash" if key.startswith("-") else "with letters, digits and _ only"
            yield ("petsc", key), f"the name of a PETSc option is written {hint}"


def expectations(table: Mapping[str, Expectation], diagnostics: tuple[str, ...]) -> Iterator[Problem]:
    """Yield expectations of what a run does not have, or of a value it cannot have."""
    known = (*diagnostics, "status", "steps")
    for name, expected in table.items():
        if name not in known:
            yield ("expect", name), "unknown diagnostic; " + suggestion(name, known)
        elif isinstance(expected.value, str) != (name == "status"):
            accepted = 'text, as "finished"' if name == "status" else "a number, not text"
            yield ("expect", name), f"must be {accepted}"
        elif name == "status" and expected.value not in ("finished", "stopped", "failed"):
            yield ("expect", name), 'must be "finished", "stopped" or "failed"'
