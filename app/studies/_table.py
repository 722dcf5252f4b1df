"""What the studies share: a growing CSV file of results, tables for the eye, PETSc options, facts about the machine."""

from __future__ import annotations

import csv
import os
import platform
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

from ..errors import InputError
from ..results import atomic, output_error

Row = dict[str, str]


def read_rows(path: Path, columns: Sequence[str]) -> list[Row]:
    """Return the rows of an earlier run, none if there is no such file; its folder is made.

    Raises
    ------
    InputError
        If the file has other columns: it is not of this study.
    """
    make_folder(path.parent)
    if not path.exists():
        return []
    with open(path, newline="", encoding="utf-8") as file:
        reader = csv.DictReader(file)
        if list(reader.fieldnames or ()) != list(columns):
            raise InputError(f"{path}: its columns are not of this study; move it away or choose another -o")
        return list(reader)


def write_rows(path: Path, columns: Sequence[str], rows: Sequence[Mapping[str, object]]) -> None:
    """Write all rows, whole or not at all."""
    with atomic(path) as partial, open(partial, "w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, columns, lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)


def make_folder(folder: Path) -> None:
    """Create the folder of results.

    Raises
    ------
    OutputError
        If that cannot be done.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise output_error(folder, error) from error


def aligned(columns: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    """Return a Markdown table whose columns line up on a terminal too; numbers to the right."""
    cells = [[str(value) for value in row] for row in [columns, *rows]]
    widths = [max(len(row[k]) for row in cells) for k in range(len(columns))]
    lines = [_line([value.ljust(width) for value, width in zip(cells[0], widths)])]
    lines.append(_line(["-" * (w - 1) + (":" if k else "-") for k, w in enumerate(widths)]))
    for row in cells[1:]:
        first = row[0].ljust(widths[0])
        lines.append(_line([first, *(value.rjust(width) for value, width in zip(row[1:], widths[1:]))]))
    return "\n".join(lines)


def _line(values: Sequence[str]) -> str:
    return "| " + " | ".join(values) + " |"


def machine() -> str:
    """Return processor, cores, load and library versions, for beside a table of times."""
    from ..record import versions

    found = versions()
    model = platform.processor() or platform.machine()
    try:
        with open("/proc/cpuinfo", encoding="utf-8") as file:
            model = next(line.partition(":")[2].strip() for line in file if line.startswith("model name"))
    except (OSError, StopIteration):
        pass
    libraries = ", ".join(f"{name} {found[name]}" for name in ("dolfinx", "petsc", "numpy") if name in found)
    load = os.getloadavg()[0]
    return f"{model}, {os.cpu_count()} cores (load {load:.1f}), Python {found['python']}, {libraries}"


@contextmanager
def petsc_options(prefix: str, chosen: Mapping[str, object]) -> Iterator[None]:
    """PETSc options with a prefix, for as long as the context lasts."""
    from petsc4py import PETSc

    options = PETSc.Options(prefix)
    before = {name: options.getString(name) for name in chosen if options.hasName(name)}
    for name, value in chosen.items():
        options.setValue(name, value)
    try:
        yield
    finally:
        for name in chosen:
            options.delValue(name)
        for name, old in before.items():
            options.setValue(name, old)
