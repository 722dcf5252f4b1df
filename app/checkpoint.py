"""Checkpoints: everything a run needs to go on, in one HDF5 file that is known to be whole before it is read.

A file begins with a block of 512 bytes (HDF5 calls it the user block and leaves it alone) that holds the
SHA-256 of all bytes after it. It is compared before the HDF5 library sees the file, because that library may
crash on damaged input.
"""

from __future__ import annotations

import hashlib
import io
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import h5py
import numpy as np

from .errors import InputError
from .results import CHECKPOINTS, atomic

if TYPE_CHECKING:
    from numpy.typing import NDArray

FORMAT = 1
KEPT = 2
BLOCK = 512
MARK = b"extremal checkpoint, sha256 of what follows: "

# Points nearer than this, relative to the mesh's size, are the same.
SAME_POINT = 1e-9

# What a person may change in a scene before a restart: how long, how finely, how watched, how solved.
HARMLESS = (
    "title", "description", "output", "expect", "solver", "petsc", "continuation", "mesh.file",
    "analysis.end_time", "analysis.time_step", "analysis.smallest_step", "analysis.largest_step",
    "analysis.adaptive", "analysis.error_tolerance", "method.gap", "method.sweeps",
)  # fmt: skip

Geometry: TypeAlias = "tuple[NDArray[Any], NDArray[Any], str] | None"


class CheckpointError(ValueError):
    """A checkpoint file that cannot be trusted; the message says why, in a few words."""


@dataclass(frozen=True)
class Checkpoint:
    """What a checkpoint file holds: the problem's state, and plain facts about the session and the scene."""

    path: Path
    state: dict[str, NDArray[Any]]
    facts: dict[str, Any]
    geometry: Geometry


def path_of(folder: Path, step: int) -> Path:
    """Return where the checkpoint of a step stands in a results folder."""
    return folder / CHECKPOINTS / f"step_{step:06d}.h5"


def list_checkpoints(folder: Path) -> list[Path]:
    """Return the checkpoint files of a results folder, newest first."""
    found = (folder / CHECKPOINTS).glob("step_*.h5")
    return sorted((path for path in found if path.stem[5:].isdigit()), key=step_of, reverse=True)


def step_of(path: Path) -> int:
    """Return the step a checkpoint file was written after, from its name."""
    return int(path.stem.removeprefix("step_"))


def save(
    path: Path, state: Mapping[str, NDArray[Any]], facts: Mapping[str, Any], geometry: Geometry = None
) -> None:
    """Write a checkpoint (whole or not at all) and remove all but the last two.

    Raises
    ------
    OutputError
        If the file cannot be written; the earlier checkpoints still stand.
    """
    # made in memory: HDF5 that finds the disk full complains in many lines, and once more when it is let go
    buffer = io.BytesIO()
    with h5py.File(buffer, "w", userblock_size=BLOCK) as file:
        file.attrs["format"] = FORMAT
        text = json.dumps({**facts, "arrays": list(state)})
        file["facts"] = np.frombuffer(text.encode(), np.uint8)
        if geometry is not None:
            file["mesh/points"], file["mesh/cells"], file["mesh"].attrs["cell_type"] = geometry
        group = file.create_group("state")
        for name, values in state.items():
            group[name] = values
    whole = buffer.getbuffer()
    digest = hashlib.sha256(whole[BLOCK:]).hexdigest()
    whole[:BLOCK] = (MARK + digest.encode()).ljust(BLOCK, b"\n")
    with atomic(path) as partial:
        partial.write_bytes(whole)
    for old in list_checkpoints(path.parent.parent)[KEPT:]:
        old.unlink(missing_ok=True)


def load(path: Path) -> Checkpoint:
    """Read a checkpoint.

    Raises
    ------
    CheckpointError
        If the file is missing, truncated, damaged, or of another format.
    """
    try:
        with open(path, "rb") as raw:
            block = raw.read(BLOCK)
            if not block.startswith(MARK):
                raise CheckpointError("does not begin as a checkpoint does")
            if hashlib.file_digest(raw, "sha256").hexdigest().encode() != block[len(MARK) :].strip():
                raise CheckpointError("is damaged or cut short: its SHA-256 differs")
        with h5py.File(path, "r") as file:
            if file.attrs["format"] != FORMAT:
                raise CheckpointError(f"has format {file.attrs['format']}: accepted is {FORMAT}")
            facts = json.loads(file["facts"][()].tobytes())
            state = {name: file["state"][name][()] for name in facts["arrays"]}
            geometry = None
            if "mesh" in file:
                mesh = file["mesh"]
                geometry = mesh["points"][()], mesh["cells"][()], mesh.attrs["cell_type"]
    except OSError as error:
        raise CheckpointError(f"cannot be read: {error.strerror or error}") from error
    return Checkpoint(path, state, facts, geometry)


def newest(place: Path) -> tuple[Checkpoint, list[str]]:
    """Return the newest good checkpoint, and a line about each newer one that had to be passed over.

    Parameters
    ----------
    place : pathlib.Path
        A results folder, or one checkpoint file in it.

    Raises
    ------
    InputError
        If there is no good one.
    """
    candidates = [place] if place.is_file() else list_checkpoints(place)
    if not candidates:
        raise InputError(
            f"--restart {place}: no checkpoint there; accepted is the results folder of an earlier run"
        )
    passed_over: list[str] = []
    for path in candidates:
        try:
            return load(path), passed_over
        except CheckpointError as error:
            passed_over.append(f"{path} {error}")
    raise InputError(f"--restart {place}: no good checkpoint: {'; '.join(passed_over)}")


def _same_mesh(mine: Geometry, its: Geometry) -> bool:
    """Tell whether two meshes are the same, but for rounding of points (it depends on the rank count)."""
    if mine is None or its is None:
        return mine is its
    points, cells, cell_type = mine
    if cell_type != its[2] or points.shape != its[0].shape or not np.array_equal(cells, its[1]):
        return False
    return bool(
        np.allclose(points, its[0], rtol=0.0, atol=SAME_POINT * max(np.ptp(points, axis=0), default=0.0))
    )


def check_same(checkpoint: Checkpoint, scene: Mapping[str, Any], geometry: Geometry) -> None:
    """Refuse to go on with another scene or mesh than the checkpoint's.

    Parameters
    ----------
    scene : mapping
        The scene as plain values, as `run.json` holds it.
    geometry : tuple of points, shape (n, 3) [m], cells, shape (m, k), and the cells' meshio name, or None
        The mesh in use.

    Raises
    ------
    InputError
        Naming the keys that were changed.
    """
    before, now = flatten(checkpoint.facts["scene"]), flatten(scene)
    changed = [
        f"{key} (was {before.get(key, 'absent')}, is {now.get(key, 'absent')})"
        for key in sorted(before.keys() | now.keys())
        if before.get(key, "absent") != now.get(key, "absent") and not _is_harmless(key)
    ]
    if changed:
        raise InputError(
            f"{checkpoint.path}: the scene has been changed since: {', '.join(changed)}; "
            "accepted are changes of output, expect, solver, petsc, gap, sweeps and the analysis's times and steps"
        )
    if not _same_mesh(geometry, checkpoint.geometry):
        raise InputError(f"{checkpoint.path}: the mesh has been changed since; accepted is the same mesh")


def flatten(tree: Any, key: str = "") -> dict[str, Any]:
    """Return nested tables and lists as one table with dotted keys; what is None or empty is absent."""
    if isinstance(tree, Mapping):
        pairs = [(str(name), value) for name, value in tree.items()]
    elif isinstance(tree, list | tuple):
        pairs = [(str(index), value) for index, value in enumerate(tree)]
    else:
        return {} if tree is None else {key: tree}
    flat: dict[str, Any] = {}
    for name, value in pairs:
        flat |= flatten(value, f"{key}.{name}" if key else name)
    return flat


def _is_harmless(key: str) -> bool:
    return any(key == name or key.startswith(f"{name}.") for name in HARMLESS)
