"""From what pydantic finds wrong to one plain line for each error: file, key, value, what is accepted."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, get_args

from pydantic import BaseModel, ValidationError

from .errors import nearest, suggestion
from .scene_fields import Problem

LONGEST_VALUE = 60
_ABSENT = object()


def problem_line(name: str, data: Mapping[str, Any], where: Sequence[str | int], message: str) -> str:
    """Return one line such as `scene.toml: [material] poisson_ratio = 0.7: must be ...`.

    Parameters
    ----------
    name : str
        The scene file.
    data : mapping
        What the file says, to quote the value.
    where : sequence of str or int
        Keys and positions (from 0; shown from 1) that lead to the value.
    message : str
        What is wrong and what would be accepted.
    """
    place = _place(data, where)
    value = _value_at(data, where)
    if not where or value is _ABSENT or (isinstance(value, Mapping | list) and place.endswith("]")):
        shown = ""
    else:
        shown = f" = {toml(value)}"
    return ": ".join(part for part in (name, place + shown, message) if part)


def problems_of(error: ValidationError, model: type[BaseModel]) -> Iterator[Problem]:
    """Yield the location and the plain message of each error of a validation by `model`."""
    details = error.errors(include_url=False)
    for detail in details:
        where = detail["loc"]
        below = any(
            len(other["loc"]) > len(where) and other["loc"][: len(where)] == where for other in details
        )
        # Consequences of another error, of no interest to a person.
        if detail["type"] == "default_factory_not_called" or (detail["type"] == "too_short" and below):
            continue
        if detail["type"] == "problems":
            for keys, message in detail["ctx"]["found"]:
                yield (*where, *keys), message
        else:
            yield where, _sentence(detail, where, model)


def toml(value: Any) -> str:
    """Return a value as TOML writes it, cut short where it is long."""
    text = literal(value)
    return text if len(text) <= LONGEST_VALUE else text[: LONGEST_VALUE - 4] + " ..."


def literal(value: Any) -> str:
    """Return a value as TOML writes it, tables inline."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False)
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{_key(key)} = {literal(entry)}" for key, entry in value.items()) + "}"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(literal(entry) for entry in value) + "]"
    return str(value)


def _place(data: Mapping[str, Any], where: Sequence[str | int]) -> str:
    """Return `[material] poisson_ratio`, `[[motion]] #2 displacement #1`, `[regions.soft] density`."""
    if not where:
        return ""
    top = data.get(str(where[0]), _ABSENT)
    first, rest = _key(where[0]), list(where[1:])
    if rest and isinstance(rest[0], int):
        place = f"[[{first}]] #{int(rest.pop(0)) + 1}"
    elif first == "regions" and rest:
        place = f"[regions.{_key(rest.pop(0))}]"
    elif rest or isinstance(top, Mapping) or top is _ABSENT:
        place = f"[{first}]"
    elif isinstance(top, list) and top and isinstance(top[0], Mapping):
        place = f"[[{first}]]"
    else:
        place = first
    dot = " "
    for key in rest:
        place += f" #{key + 1}" if isinstance(key, int) else dot + _key(key)
        dot = " " if isinstance(key, int) else "."
    return place


def _key(key: str | int) -> str:
    """Return a key as TOML writes it, in quotes where it needs them."""
    text = str(key)
    return text if re.fullmatch(r"[\w-]+", text) else json.dumps(text, ensure_ascii=False)


def _value_at(data: Any, where: Sequence[str | int]) -> Any:
    for key in where:
        try:
            data = data[key]
        except (KeyError, IndexError, TypeError):
            return _ABSENT
    return data


def _sentence(detail: Mapping[str, Any], where: Sequence[str | int], model: type[BaseModel]) -> str:
    kind, context, value = detail["type"], detail.get("ctx", {}), detail["input"]
    if kind == "scene":
        return str(detail["msg"])
    if kind == "missing":
        return "is missing" + _description(model, where)
    if kind == "extra_forbidden":
        return "unknown key; " + suggestion(str(where[-1]), _keys(model, where[:-1]))
    if kind == "literal_error":
        return _choice(value, context["expected"])
    bounds = {"gt": "above", "ge": "at least", "lt": "below", "le": "at most"}
    for key, word in bounds.items():
        if kind in ("greater_than", "greater_than_equal", "less_than", "less_than_equal") and key in context:
            return f"must be {word} {context[key]:g}"
    if kind == "too_short":
        return "must have at least one entry"
    if kind in ("model_type", "dict_type", "model_attributes_type"):
        if isinstance(value, list):
            return f"may be given once only; write [{where[-1]}]"
        return "must be a table"
    if kind in ("tuple_type", "list_type"):
        if isinstance(value, Mapping):
            return f"may be given several times; write [[{where[-1]}]]"
        return "must be a list"
    return str(detail["msg"])


def _choice(value: Any, expected: str) -> str:
    names = [quoted or number for quoted, number in re.findall(r"'([^']*)'|(\d+)", expected)]
    shown = [f'"{name}"' if f"'{name}'" in expected else name for name in names]
    listing = shown[0] if len(shown) == 1 else ", ".join(shown[:-1]) + " or " + shown[-1]
    near = nearest(value, names) if isinstance(value, str) and len(names) > 1 else None
    return (f'did you mean "{near}"? ' if near else "") + f"must be {listing}"


def _description(model: type[BaseModel], where: Sequence[str | int]) -> str:
    owner = _model_at(model, where[:-1])
    field = owner.model_fields.get(str(where[-1])) if owner is not None else None
    return f"; {field.description}" if field is not None and field.description else ""


def _keys(model: type[BaseModel], where: Sequence[str | int]) -> list[str]:
    owner = _model_at(model, where)
    return list(owner.model_fields) if owner is not None else []


def _model_at(model: type[BaseModel], where: Sequence[str | int]) -> type[BaseModel] | None:
    """Return the model of the table at a location, by the annotations of the models on the way."""
    current: type[BaseModel] | None = model
    inside_mapping = False
    for key in where:
        if isinstance(key, int) or inside_mapping:
            inside_mapping = False
            continue
        field = current.model_fields.get(key) if current is not None else None
        if field is None:
            return None
        models = list(_models_in(field.annotation))
        inside_mapping = getattr(field.annotation, "__origin__", None) is dict
        current = models[0] if models else None
    return current


def _models_in(annotation: Any) -> Iterator[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    for argument in get_args(annotation):
        yield from _models_in(argument)
