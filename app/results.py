"""The results folder: files whole or absent, tables that grow by whole lines, frames for ParaView."""

from __future__ import annotations

import contextlib
import csv
import os
import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any
from xml.sax.saxutils import quoteattr

from .errors import EXIT_SOLVER, ExtremalError, InputError

if TYPE_CHECKING:
    import meshio
    from numpy.typing import NDArray

SCENE, RECORD, SUMMARY = "scene.toml", "run.json", "summary.png"
HISTORY, ITERATIONS = "history.csv", "iterations.csv"
SERIES, FRAMES, CHECKPOINTS = "fields.pvd", "fields", "checkpoints"
SOLID = "solid"  # folder for the frames of an elastic body among particles
PREDICTIONS, PARAMETERS, EVENTS, SCORES = "predictions.csv", "parameters.csv", "events.csv", "scores.csv"
UNRESOLVABLE, CALIBRATION = "unresolvable.csv", "calibration.csv"
TABLES = (PREDICTIONS, PARAMETERS, EVENTS, SCORES, UNRESOLVABLE, CALIBRATION)
PARTIAL = ".partial"


class OutputError(ExtremalError):
    """A result that cannot be written: the disk is full, the folder is gone or not ours (exit code 3)."""

    exit_code = EXIT_SOLVER


def output_error(path: Path, error: OSError) -> OutputError:
    """Return the one line a person needs: which file, what happened, how many bytes are free."""
    try:
        free = f"{shutil.disk_usage(path.parent).free:,} bytes free"
    except OSError:
        free = "its folder cannot be reached"
    words = str(error).splitlines() or [type(error).__name__]
    reason = os.strerror(error.errno) if error.errno else words[0]
    return OutputError(f"{path}: cannot be written: {reason} ({free})")


@contextlib.contextmanager
def atomic(path: Path) -> Iterator[Path]:
    """Yield the name of a file to write; it becomes `path`, whole and on disk, when the context ends well.

    Raises
    ------
    OutputError
        If the file cannot be written; nothing is left of it, and what stood under `path` is still there.
    """
    partial = path.with_name(f".{path.name}.{os.getpid()}{PARTIAL}")
    try:
        yield partial
        with open(partial, "rb") as written:
            os.fsync(written.fileno())
        os.replace(partial, path)
        _sync_folder(path.parent)
    except OSError as error:
        raise output_error(path, error) from error
    finally:
        with contextlib.suppress(OSError):
            partial.unlink()


def _sync_folder(folder: Path) -> None:
    """Make new names in `folder` survive a power cut."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def write_text(path: Path, text: str) -> None:
    """Write a text file, whole or not at all."""
    with atomic(path) as partial:
        partial.write_text(text, encoding="utf-8")


def prepare(folder: Path, keep: bool) -> None:
    """Make `folder` ready for a run: create it, and remove what an earlier run or a killed one left there.

    Parameters
    ----------
    keep : bool
        The run goes on with what stands there (a restart): remove only unfinished files.
    """
    try:
        for place in (folder, folder / FRAMES, folder / CHECKPOINTS):
            place.mkdir(parents=True, exist_ok=True)
        for place in (folder, folder / FRAMES, folder / CHECKPOINTS, folder / SOLID, folder / SOLID / FRAMES):
            for partial in place.glob(f".*{PARTIAL}"):
                partial.unlink()
        if keep:
            return
        # only files of ours: the folder may hold a user's notes too
        for name in (SCENE, HISTORY, ITERATIONS, RECORD, SUMMARY, SERIES, *TABLES):
            (folder / name).unlink(missing_ok=True)
        (folder / SOLID / SERIES).unlink(missing_ok=True)
        frames = [*(folder / FRAMES).glob("frame_*.vtu"), *(folder / FRAMES).glob("density_*.vdb")]
        frames += (folder / SOLID / FRAMES).glob("frame_*.vtu")
        for old in [*frames, *(folder / CHECKPOINTS).glob("step_*.h5")]:
            old.unlink()
    except OSError as error:
        raise InputError(
            f"-o {folder}: cannot be used: {error.strerror} ({error.filename}); "
            "accepted is a folder you may write to"
        ) from error


class Table:
    """A CSV file of numbers that grows by whole lines and can be cut back.

    Parameters
    ----------
    path : pathlib.Path
        Read if it exists: new rows follow the old ones.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.columns: list[str] = read_table(path)[0] if path.exists() else []

    def append(self, row: Mapping[str, float]) -> None:
        """Add one row; a column not seen before is added to the earlier rows too, empty."""
        new = [name for name in row if name not in self.columns]
        if new:
            rows = read_table(self.path)[1] if self.columns else []
            self.columns += new
            self._rewrite(rows)
        self._append_line(self._line(row))

    def keep(self, wanted: Callable[[dict[str, float]], bool]) -> None:
        """Drop the rows which are not `wanted`, and a last line that a crash cut short."""
        if self.path.exists():
            self._rewrite([row for row in read_table(self.path)[1] if wanted(row)])

    def _line(self, row: Mapping[str, float]) -> str:
        return ",".join(_number(row[name]) if name in row else "" for name in self.columns) + "\n"

    def _rewrite(self, rows: list[dict[str, float]]) -> None:
        write_text(self.path, "".join([",".join(self.columns) + "\n", *(self._line(row) for row in rows)]))

    def _append_line(self, line: str) -> None:
        data = line.encode()
        try:
            with open(self.path, "ab", buffering=0) as file:
                size = file.tell()
                try:
                    while data:  # one system call unless the disk is full: a killed run leaves whole lines
                        data = data[file.write(data) :]
                except OSError:
                    file.truncate(size)
                    raise
        except OSError as error:
            raise output_error(self.path, error) from error


def _number(value: float) -> str:
    """Return a number as text that gives the very same number back."""
    number = float(value)
    return str(int(number)) if number.is_integer() and abs(number) < 1e15 else repr(number)


def write_columns(path: Path, columns: Mapping[str, Sequence[Any]]) -> None:
    """Write a CSV file, column by column, whole or not at all; None is left blank."""
    with atomic(path) as partial, open(partial, "w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(columns)
        writer.writerows(zip(*columns.values(), strict=True))


def read_table(path: Path) -> tuple[list[str], list[dict[str, float]]]:
    """Return the columns and rows of a CSV file of numbers, less empty entries and a last line cut short."""
    text = path.read_text(encoding="utf-8")
    lines = text[: text.rfind("\n") + 1].splitlines()
    if not lines:
        return [], []
    columns = lines[0].split(",")
    rows = [{k: float(v) for k, v in zip(columns, row, strict=False) if v} for row in csv.reader(lines[1:])]
    return columns, rows


class Frames:
    """Frames played in order by ParaView through `fields.pvd`.

    Parameters
    ----------
    folder : pathlib.Path
        The results folder.
    times : list of float
        Times of the frames which stand there already.
    """

    def __init__(self, folder: Path, times: list[float]) -> None:
        self.folder = folder
        self.times = list(times)
        (folder / FRAMES).mkdir(parents=True, exist_ok=True)
        # written after the checkpoint that the run goes on from
        for frame in (folder / FRAMES).glob("*_*.*"):
            number = frame.stem.rpartition("_")[2]
            if number.isdigit() and int(number) >= len(times):
                frame.unlink()
        self._write_index()

    @staticmethod
    def name(index: int) -> str:
        """Return the file of a frame, relative to the results folder."""
        return f"{FRAMES}/frame_{index:05d}.vtu"

    def write_mesh(self, time: float, mesh: meshio.Mesh) -> None:
        """Write the next frame; a last frame of the same time is replaced."""
        from meshio import vtu

        if self.times and self.times[-1] == time:
            self.times.pop()
        with atomic(self.folder / self.name(len(self.times))) as partial:
            vtu.write(str(partial), mesh, binary=True, compression="zlib")
        self.times.append(time)
        self._write_index()

    def _write_index(self) -> None:
        entries = "".join(
            f'    <DataSet timestep="{time!r}" part="0" file={quoteattr(self.name(index))}/>\n'
            for index, time in enumerate(self.times)
        )
        write_text(
            self.folder / SERIES,
            '<?xml version="1.0"?>\n<VTKFile type="Collection" version="0.1" byte_order="LittleEndian">\n'
            f"  <Collection>\n{entries}  </Collection>\n</VTKFile>\n",
        )


class Series(Frames):
    """Frames of the fields on a mesh.

    Parameters
    ----------
    geometry : tuple of points, shape (n, 3) [m], cells, shape (m, k), and the cells' meshio name
    """

    def __init__(
        self, folder: Path, geometry: tuple[NDArray[Any], NDArray[Any], str], times: list[float]
    ) -> None:
        super().__init__(folder, times)
        self.points, self.cells, self.cell_type = geometry

    def write(
        self,
        time: float,
        point_data: Mapping[str, NDArray[Any]],
        cell_data: Mapping[str, NDArray[Any]],
    ) -> None:
        """Write the next frame: arrays of shape (n,) or (n, 3) at points, (m,) or (m, 3) in cells."""
        import meshio

        mesh = meshio.Mesh(
            self.points,
            [(self.cell_type, self.cells)],
            point_data={name: _plain(values) for name, values in point_data.items()},
            cell_data={name: [_plain(values)] for name, values in cell_data.items()},
        )
        self.write_mesh(time, mesh)


def _plain(values: NDArray[Any]) -> NDArray[Any]:
    """Return an array as VTK takes it: contiguous, and no truth values."""
    import numpy as np

    return np.ascontiguousarray(values.astype(np.uint8) if values.dtype == bool else values)


def volume_name(index: int) -> str:
    """Return the file of a frame's density on the grid, relative to the results folder."""
    return f"{FRAMES}/density_{index:05d}.vdb"


def adopt(source: Path, folder: Path, frames: int) -> None:
    """Take over tables and the first `frames` frames of another results folder, to go on in this one."""
    shown = [name for index in range(frames) for name in (Frames.name(index), volume_name(index))]
    shown += [f"{SOLID}/{Frames.name(index)}" for index in range(frames)]
    for name in [HISTORY, ITERATIONS, *shown]:
        if (source / name).exists():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            with atomic(folder / name) as partial:
                try:
                    # frames never change once written, so they can be shared; tables grow and cannot
                    if name not in shown:
                        raise OSError
                    os.link(source / name, partial)
                except OSError:
                    shutil.copyfile(source / name, partial)
