"""What the tables of a scene are made of: numbers, vectors, expressions, checks across keys."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from typing import Annotated, Any

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, PlainValidator, model_validator
from pydantic_core import PydanticCustomError

SPACE = ("x", "y", "z")
SPACE_TIME = ("x", "y", "z", "t")

# Powers and products of larger numbers, and of the inverse of smaller ones, leave the range of computers.
LARGEST = 1e50

# (key, or keys leading to it from the table; what is wrong and what would be accepted)
Problem = tuple[tuple[str | int, ...], str]


def wrong(message: str) -> PydanticCustomError:
    """Return the error a field's validator raises; `message` says what would be accepted."""
    return PydanticCustomError("scene", "{text}", {"text": message})


class Table(BaseModel):
    """A table of a scene file: frozen, no unknown keys, all problems across its keys reported together."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    def problems(self) -> Iterator[Problem]:
        """Yield what is wrong between the keys of this table, once each key is right by itself."""
        yield from ()

    @model_validator(mode="after")
    def _report_problems(self) -> Table:
        found = [
            ((key,) if isinstance(key, str) else tuple(key), message) for key, message in self.problems()
        ]
        if found:
            raise PydanticCustomError("problems", "{count} problems", {"count": len(found), "found": found})
        return self

    def given(self) -> dict[str, Any]:
        """Return the keys the scene file gives, without the defaults."""
        return {key: getattr(self, key) for key in self.model_fields_set}


def _number(value: Any) -> Any:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise wrong("must be a number")
    try:
        number = float(value)
    except OverflowError:
        number = math.inf
    if not math.isfinite(number):
        raise wrong("must be a finite number")
    if number != 0 and not 1 / LARGEST < abs(number) < LARGEST:
        raise wrong(f"must be 0 or a number between {1 / LARGEST:g} and {LARGEST:g} in size")
    return number


def _boolean(value: Any) -> Any:
    if not isinstance(value, bool):
        raise wrong("must be true or false")
    return value


def _integer(value: Any) -> Any:
    if isinstance(value, bool) or not isinstance(value, int):
        raise wrong("must be a whole number")
    return value


def _text(value: Any) -> Any:
    if not isinstance(value, str):
        raise wrong("must be text in quotes")
    return value


def _names(value: Any) -> Any:
    names = [value] if isinstance(value, str) else value
    if not isinstance(names, list | tuple) or not names or not all(isinstance(n, str) and n for n in names):
        raise wrong('must be a name or a list of names, as "left" or ["left", "right"]')
    if len(set(names)) < len(names):
        raise wrong("names one of them twice")
    return tuple(names)


def _number_or_text(value: Any) -> Any:
    return value if isinstance(value, str) else _number(value)


Number = Annotated[float, BeforeValidator(_number)]
NumberOrText = Annotated[float | str, PlainValidator(_number_or_text)]
Positive = Annotated[Number, Field(gt=0)]
NotNegative = Annotated[Number, Field(ge=0)]
Integer = Annotated[int, BeforeValidator(_integer)]
Boolean = Annotated[bool, BeforeValidator(_boolean)]
Text = Annotated[str, BeforeValidator(_text)]
Names = Annotated[tuple[str, ...], BeforeValidator(_names)]


def quantity(names: Iterable[str], free: bool = False) -> PlainValidator:
    """Return the validator of a number that may also be given as an expression of `names`.

    Parameters
    ----------
    names : iterable of str
        Variables the expression may use.
    free : bool
        Whether "" and "free" are accepted and mean: not prescribed (None).
    """
    known = tuple(names)
    accepted = f"a number or an expression of {', '.join(known)} in quotes" + (' or "free"' if free else "")

    def check(value: Any) -> float | str | None:
        if isinstance(value, str):
            return _expression(value, known, free, accepted)
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise wrong(f"must be {accepted}")
        return _number(value)

    return PlainValidator(check)


def _expression(value: str, names: tuple[str, ...], free: bool, accepted: str) -> float | str | None:
    text = value.strip()
    if free and text in ("", "free"):
        return None
    if not text:
        raise wrong(f"must be {accepted}")
    try:
        return _number(float(text))
    except ValueError:
        pass
    from .expression import ExpressionError, parse

    try:
        parse(text, names)
    except ExpressionError as error:
        raise wrong(str(error)) from None
    return text


def condition(names: Iterable[str]) -> PlainValidator:
    """Return the validator of a comparison such as "z < 0.01" over `names`."""
    known = tuple(names)

    def check(value: Any) -> str:
        if not isinstance(value, str) or not value.strip():
            raise wrong(f'must be a comparison of {", ".join(known)} in quotes, as "z < 0.01"')
        from .expression import ExpressionError, parse_condition

        try:
            parse_condition(value.strip(), known)
        except ExpressionError as error:
            raise wrong(str(error)) from None
        return value.strip()

    return PlainValidator(check)


def vector(what: str = "numbers") -> BeforeValidator:
    """Return the validator of a list of 2 or 3 entries (2 in plane scenes)."""

    def check(value: Any) -> Any:
        if not isinstance(value, list | tuple):
            raise wrong(f"must be a list of 2 or 3 {what}")
        if len(value) not in (2, 3):
            raise wrong(f"has {len(value)} entries; must be a list of 2 or 3 {what}")
        return tuple(value)

    return BeforeValidator(check)


def _rotation(value: Any) -> float | tuple[float, ...]:
    if isinstance(value, list | tuple):
        if len(value) != 3:
            raise wrong("must be a rotation vector of 3 entries [rad], or one angle in the plane")
        return tuple(_number(entry) for entry in value)
    return float(_number(value))


FieldQuantity = Annotated[float | str, quantity(SPACE)]
MovingQuantity = Annotated[float | str, quantity(SPACE_TIME)]
FreeQuantity = Annotated[float | str | None, quantity(SPACE_TIME, free=True)]
Condition = Annotated[str, condition(SPACE)]
Rotation = Annotated[float | tuple[float, ...], BeforeValidator(_rotation)]
Vector = Annotated[tuple[Number, ...], vector()]
MovingVector = Annotated[tuple[MovingQuantity, ...], vector("numbers or expressions of x, y, z, t")]
FreeVector = Annotated[tuple[FreeQuantity, ...], vector('numbers, expressions of x, y, z, t or "free"')]
FieldVector = Annotated[tuple[FieldQuantity, ...], vector("numbers or expressions of x, y, z")]
