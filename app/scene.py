"""Scene files: read on rank 0, validated, and handed to all ranks as one frozen object."""

from __future__ import annotations

import os
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pydantic import ValidationError

from . import elastic_checks, hawkes_checks, snow_checks
from .elastic_scene import ElasticScene
from .errors import InputError, suggestion
from .hawkes_scene import HawkesScene
from .parallel import on_root
from .scene_common import Check, Scene, cross_checks
from .scene_errors import problem_line, problems_of, toml
from .scene_fields import Problem
from .snow_scene import SnowScene

if TYPE_CHECKING:
    from mpi4py import MPI

LARGEST_FILE = 10_000_000  # bytes; a scene is written by hand


@dataclass(frozen=True)
class Part:
    """What validates the scenes of a part of the application.

    Attributes
    ----------
    model : type of Scene
        Its tables.
    checks : tuple of Check
        Between the tables.
    stand_ins : dict
        What stands in for a required table with errors, so that the other tables can be checked all the same.
    """

    model: type[Scene]
    checks: tuple[Check, ...]
    stand_ins: dict[str, Any]


PARTS = {
    "elastic": Part(
        ElasticScene,
        elastic_checks.CHECKS,
        {
            "mesh": {"file": "mesh.msh"},
            "material": {"young_modulus": 1.0, "poisson_ratio": 0.3, "density": 1.0},
        },
    ),
    "snow": Part(
        SnowScene,
        snow_checks.CHECKS,
        {
            "grid": {"cell_size": 1.0},
            "body": [{"shape": "sphere", "center": [0.0, 0.0, 0.0], "radius": 1.0}],
            "analysis": {"end_time": 1.0},
        },
    ),
    "hawkes": Part(
        HawkesScene,
        hawkes_checks.CHECKS,
        {"network": {"agents": 3}, "simulation": {"count": 1, "incomplete": 1}},
    ),
}


def load_scene(path: str | Path, comm: MPI.Comm) -> Any:
    """Read and validate a scene file on rank 0 and return it on all ranks (collective).

    Raises
    ------
    InputError
        On all ranks, with a line for each thing wrong.
    """
    return on_root(comm, lambda: read_scene(path))


def read_scene(path: str | Path) -> Any:
    """Read and validate a scene file (not collective); `part` says of which kind, elastic where it is silent.

    Raises
    ------
    InputError
        With a line for each thing wrong.
    """
    path = Path(path)
    scene = validate(read_toml(path), str(path))
    scene._path = path
    missing = [
        problem_line(str(path), scene._source, where, f"no such file: {file.absolute()}")
        for where, file in scene.files()
        if not os.path.isfile(file)
    ]
    if missing:
        raise InputError(*missing)
    return scene


def read_toml(path: Path) -> dict[str, Any]:
    """Return what a TOML file says; raises InputError with line and column of a syntax error."""
    try:
        if path.exists() and not path.is_file() and not path.is_dir():
            raise InputError(f"{path}: is no file; give a scene file")
        if path.is_file() and path.stat().st_size > LARGEST_FILE:
            raise InputError(f"{path}: has {path.stat().st_size} bytes; a scene has at most {LARGEST_FILE}")
        text = path.read_bytes().decode("utf-8")
    except UnicodeDecodeError as error:
        line = error.object[: error.start].count(b"\n") + 1
        raise InputError(f"{path}: line {line}: is not UTF-8 text") from None
    except FileNotFoundError:
        raise InputError(f"{path}: no such file") from None
    except IsADirectoryError:
        raise InputError(f"{path}: is a folder; give a scene file") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from None
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        reason, _, place = str(error).rpartition(" (at ")
        if not reason:
            reason, place = str(error), "end of document)"
        if place.startswith("end of document"):
            place = f"line {text.count(chr(10)) + 1}, at the end)"
        raise InputError(f"{path}: {place.removesuffix(')')}: not TOML: {reason}") from None
    except RecursionError:
        raise InputError(f"{path}: is nested too deeply for a scene") from None


def validate(data: Mapping[str, Any], name: str = "scene") -> Any:
    """Return the scene that `data` describes.

    Parameters
    ----------
    data : mapping
        What a scene file says.
    name : str
        The file's name, for messages.

    Returns
    -------
    ElasticScene, SnowScene or HawkesScene

    Raises
    ------
    InputError
        With a line for each thing wrong in and between the tables.
    """
    wanted = data.get("part", "elastic")
    if not isinstance(wanted, str) or wanted not in PARTS:
        hint = suggestion(wanted, PARTS) if isinstance(wanted, str) else f"known: {', '.join(PARTS)}"
        raise InputError(f"{name}: part = {toml(wanted)}: unknown part; {hint}")
    part = PARTS[wanted]
    try:
        scene = part.model.model_validate(data)
        found = list(cross_checks(scene, part.checks))
    except ValidationError as error:
        found = list(problems_of(error, part.model))
        found += _checks_of_the_rest(data, part, {str(where[0]) for where, _ in found if where})
    else:
        scene._source = dict(data)
    if found:
        raise InputError(*(problem_line(name, data, where, message) for where, message in found))
    return scene


def _checks_of_the_rest(data: Mapping[str, Any], part: Part, wrong: set[str]) -> list[Problem]:
    """Return what is wrong between the tables that are right by themselves."""
    rest = {key: value for key, value in data.items() if key not in wrong}
    instead = {key: table for key, table in part.stand_ins.items() if key in wrong}
    try:
        scene = part.model.model_validate({**instead, **rest})
    except ValidationError:
        return []
    return list(cross_checks(scene, part.checks, wrong))
