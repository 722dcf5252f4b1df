"""The points of a sweep: each a whole scene, or the settings of a case, validated before anything is run."""

from __future__ import annotations

import copy
import hashlib
import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..errors import InputError
from ..record import versions
from ..scene import read_toml, validate
from ..scene_errors import literal, toml
from .model import Sweep, settings_of

REFERENCE = "reference"


@dataclass(frozen=True)
class Point:
    """What is run, and what it is called.

    Attributes
    ----------
    method : str
        The line it belongs to, "reference" for the reference.
    value : Any
        Of the knob; None for the reference, and for a method without the knob.
    part : str
        Command that runs it; "" for a case.
    text : str
        The scene in TOML, or the case and its settings in JSON.
    settings : dict
        What distinguishes it from the other points, by dotted keys.
    digest : str
        Of everything that its result depends on.
    """

    method: str
    value: Any
    part: str
    text: str
    settings: dict[str, Any]
    digest: str

    @property
    def folder(self) -> str:
        """Name of its folder."""
        words = self.method if self.value is None else f"{self.method} {self.value}"
        return re.sub(r"[^\w.+-]+", "_", words).strip("_") + "-" + self.digest[:10]

    def __str__(self) -> str:
        return self.method if self.value is None else f"{self.method} at {plain(self.value)}"


def plain(value: Any) -> str:
    """A knob's value as people write it."""
    if value is None:
        return ""
    return f"{value:g}" if isinstance(value, float) else str(value)


def points_of(sweep: Sweep, quick: bool = False, ranks: int = 0) -> list[Point]:
    """All points, the reference first.

    Raises
    ------
    InputError
        For the first point whose scene is wrong, with a line for each thing wrong in it.
    """
    points, told = [], (ranks, sweep.repeats(quick))
    reference = sweep.reference
    if reference is not None and reference.set is not None:
        changes = (reference.quick if quick else None) or reference.set
        points.append(_point(sweep, REFERENCE, None, changes, {}, told))
    for method in sweep.method:
        for value in sweep.values_of(method, quick) or (None,):
            turned = {} if value is None else {key: value for key in sweep.knob.key}
            changes = {**flat(method.set), **turned}
            points.append(_point(sweep, method.name, value, changes, method.petsc, told))
    return points


def _point(
    sweep: Sweep, name: str, value: Any, changes: Mapping[str, Any], petsc: Mapping[str, Any], how: Sequence[int]
) -> Point:
    """A point that is run in the way of which the numbers `how` tell."""
    at = f" at {plain(value)}" if value is not None else ""
    place = f"{sweep.path}: {name}{at}"
    files: list[Path] = []
    settings = {**flat(changes), **{f"petsc.{key}": option for key, option in petsc.items()}}
    if sweep.case is not None:
        chosen = {**settings_of(sweep.case), **sweep.set, **changes}
        content = {"case": sweep.case, "settings": chosen, "petsc": dict(petsc)}
        text, part = json.dumps(content, indent=1), ""
    else:
        tables, files = _scene(sweep, place, settings)
        text = "".join(f"{key} = {literal(entry)}\n" for key, entry in tables.items())
        part = str(tables.get("part", "elastic"))
    told = json.dumps([text, [_content(file) for file in files], _versions(), how])
    return Point(name, value, part, text, settings, hashlib.sha256(told.encode()).hexdigest())


def _scene(sweep: Sweep, place: str, settings: Mapping[str, Any]) -> tuple[dict[str, Any], list[Path]]:
    """The tables of a point's scene, and the files it names, by full paths."""
    tables = copy.deepcopy(read_toml(sweep.scene_path))
    tables.pop("expect", None)  # of the scene as it was
    changes = {**flat(sweep.set), **settings}
    for key, value in changes.items():
        _put(tables, key, value, place)
    output = tables.setdefault("output", {})
    if "output.summary" not in changes:
        output["summary"] = False
    end = tables.get("analysis", {}).get("end_time")
    if end is not None and "output.every" not in changes and tables.get("part") != "hawkes":
        output["every"] = end  # the last frame is all that is compared
    scene = validate(tables, place)
    scene._path = sweep.scene_path
    files = []
    for where, file in scene.files():
        if not file.is_file():
            raise InputError(f"{place}: no such file: {file.resolve()}")
        files.append(file)
        _put(tables, ".".join(map(str, where)), str(file.resolve()), place)
    return tables, files


def flat(table: Mapping[str, Any], before: str = "") -> dict[str, Any]:
    """Tables in tables as dotted keys: {"a": {"b": 1}} and {"a.b": 1} are the same; an empty table is a value."""
    out: dict[str, Any] = {}
    for key, value in table.items():
        if isinstance(value, Mapping) and value:
            out.update(flat(value, f"{before}{key}."))
        else:
            out[before + key] = value
    return out


def _put(tables: dict[str, Any], key: str, value: Any, place: str) -> None:
    """Set what a dotted key names; a number in it is a position, from 0."""
    *way, last = key.split(".")
    at: Any = tables
    for word in way:
        if isinstance(at, list):
            at = at[_index(at, word, key, place)]
        elif isinstance(at, dict):
            at = at.setdefault(word, {})
    if isinstance(at, list):
        at[_index(at, last, key, place)] = value
    elif isinstance(at, dict):
        at[last] = value
    else:
        raise InputError(f"{place}: {key} = {toml(value)}: {'.'.join(way)} is {toml(at)}, not a table")


def _index(entries: list[Any], word: str, key: str, place: str) -> int:
    if not word.isdigit() or int(word) >= len(entries):
        raise InputError(f"{place}: {key}: {word} must be a position in the list, from 0 to {len(entries) - 1}")
    return int(word)


def _content(file: Path) -> str:
    return hashlib.sha256(file.read_bytes()).hexdigest()


def _versions() -> dict[str, str]:
    found = versions()
    # others are known only where something has loaded them
    return {name: found[name] for name in ("extremal", "python", "numpy", "petsc", "petsc4py", "mpi")}
