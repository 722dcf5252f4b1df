"""Scene files: read on rank 0, validated, and handed to all ranks as one frozen object."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pydantic import ValidationError

from .elastic_checks import cross_checks
from .elastic_scene import ElasticScene
from .errors import InputError
from .parallel import on_root
from .scene_errors import problem_line, problems_of

if TYPE_CHECKING:
    from mpi4py import MPI

LARGEST_FILE = 10_000_000  # bytes; a scene is written by hand

# What stands in for a required table with errors, so that the other tables can be checked all the same.
STAND_INS: dict[str, dict[str, Any]] = {
    "mesh": {"file": "mesh.msh"},
    "material": {"young_modulus": 1.0, "poisson_ratio": 0.3, "density": 1.0},
}


def load_scene(path: str | Path, comm: MPI.Comm) -> ElasticScene:
    """Read and validate a scene file on rank 0 and return it on all ranks (collective).

    Raises
    ------
    InputError
        On all ranks, with a line for each thing wrong.
    """
    return on_root(comm, lambda: read_scene(path))


def read_scene(path: str | Path) -> ElasticScene:
    """Read and validate a scene file (not collective).

    Raises
    ------
    InputError
        With a line for each thing wrong.
    """
    path = Path(path)
    scene = validate(read_toml(path), str(path))
    scene._path = path
    if scene.mesh_file is not None and not scene.mesh_file.is_file():
        where = ("mesh", "file")
        raise InputError(
            problem_line(str(path), scene._source, where, f"no such file: {scene.mesh_file.resolve()}")
        )
    return scene


def read_toml(path: Path) -> dict[str, Any]:
    """Return what a TOML file says; raises InputError with line and column of a syntax error."""
    try:
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


def validate(data: Mapping[str, Any], name: str = "scene") -> ElasticScene:
    """Return the scene that `data` describes.

    Parameters
    ----------
    data : mapping
        What a scene file says.
    name : str
        The file's name, for messages.

    Raises
    ------
    InputError
        With a line for each thing wrong in and between the tables.
    """
    try:
        scene = ElasticScene.model_validate(data)
        found = list(cross_checks(scene))
    except ValidationError as error:
        found = list(problems_of(error, ElasticScene))
        found += _checks_of_the_rest(data, {str(where[0]) for where, _ in found if where})
    else:
        scene._source = dict(data)
    if found:
        raise InputError(*(problem_line(name, data, where, message) for where, message in found))
    return scene


def _checks_of_the_rest(data: Mapping[str, Any], wrong: set[str]) -> list[Any]:
    """Return what is wrong between the tables that are right by themselves."""
    rest = {key: value for key, value in data.items() if key not in wrong}
    try:
        scene = ElasticScene.model_validate(
            {**{key: STAND_INS[key] for key in STAND_INS if key in wrong}, **rest}
        )
    except ValidationError:
        return []
    return list(cross_checks(scene, missing=wrong))
