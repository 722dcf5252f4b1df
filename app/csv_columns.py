"""CSV files by columns: quick for millions of lines, and every error names its line."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .errors import InputError, nearest

DELIMITERS = {",": "comma", ";": "semicolon", "\t": "tab"}
LONGEST_VALUE = 40


@dataclass(frozen=True)
class Columns:
    """A table: texts without surrounding spaces, column by column, and the line each row ends in."""

    path: Path
    texts: dict[str, list[str]]
    line: NDArray

    def __getitem__(self, name: str) -> list[str]:
        return self.texts[name]

    def __contains__(self, name: str) -> bool:
        return name in self.texts

    def __len__(self) -> int:
        return len(self.line)

    def refuse(self, name: str, wrong: ArrayLike, accepted: str | Callable[[int], str]) -> None:
        """Raise InputError about the first row that is `wrong`, and say how many others there are."""
        rows = np.flatnonzero(wrong)
        if not len(rows):
            return
        k = int(rows[0])
        words = accepted if isinstance(accepted, str) else accepted(k)
        more = f" ({len(rows) - 1} more like it)" if len(rows) > 1 else ""
        raise InputError(f"{self.path}: line {self.line[k]}: {name} = {_quoted(self[name][k])}: {words}{more}")

    def numbers(
        self, name: str, accepted: str, blank: float | None = None, good: Callable[[NDArray], NDArray] | None = None
    ) -> NDArray:
        """A column of finite numbers, `blank` where the field is empty.

        Raises
        ------
        InputError
            Naming the first that is not one or not `good`, and what is `accepted`.
        """
        texts = self[name] if blank is None else [text or repr(blank) for text in self[name]]
        words = f"must be a number, {accepted}" if accepted else "must be a number"
        try:
            values = np.array(texts, dtype=str).astype(float)
        except ValueError:
            self.refuse(name, [not is_number(text) for text in texts], words)
            raise
        self.refuse(name, ["_" in text for text in texts], words)  # Python's own way to write numbers
        self.refuse(name, ~np.isfinite(values), "must be a finite number" + f", {accepted}" * bool(accepted))
        if good is not None:
            self.refuse(name, ~good(values), f"must be {accepted}")
        return values


def is_number(text: str) -> bool:
    """Tell whether a text is a number, finite or not."""
    try:
        float(text)
    except ValueError:
        return False
    return "_" not in text


def read_columns(path: Path, needed: Sequence[str], optional: Sequence[str], notes: list[str]) -> Columns:
    """Read a table with a header; blank rows are passed over.

    Parameters
    ----------
    needed, optional : sequence of str
        Columns, in any order; others are ignored, with a note, unless one looks like a slip of the pen.

    Raises
    ------
    InputError
        Naming file and line.
    """
    text = _text(path)
    delimiter = max(DELIMITERS, key=text.partition("\n")[0].count)
    reader = csv.reader(io.StringIO(text, newline=""), delimiter=delimiter, strict=True)
    rows: list[list[str]] = []
    line: list[int] = []
    try:
        header = [name.strip() for name in next(reader, [])]
        names = _names(path, header, needed, optional, notes)
        for row in reader:
            if any(row):
                rows.append(row)
                line.append(reader.line_num)
    except csv.Error as error:
        raise InputError(f"{path}: line {reader.line_num}: not CSV: {error}") from None
    wrong = next((k for k, row in enumerate(rows) if len(row) != len(header)), None)
    if wrong is not None:
        found, between = len(rows[wrong]), DELIMITERS[delimiter]
        raise InputError(f"{path}: line {line[wrong]}: has {found} fields ({between} between them), not {len(header)}")
    if not rows:
        raise InputError(f"{path}: has no row below its header {','.join(header)}")
    texts = list(zip(*rows))
    return Columns(path, {name: [t.strip() for t in texts[header.index(name)]] for name in names}, np.array(line))


def _text(path: Path) -> str:
    try:
        text = path.read_bytes().decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = error.object[: error.start].count(b"\n") + 1
        raise InputError(f"{path}: line {line}: is not UTF-8 text; save the table as CSV in UTF-8") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from None
    if not text.strip():
        raise InputError(f"{path}: is empty; must begin with a line that names its columns")
    return text


def _names(
    path: Path, header: Sequence[str], needed: Sequence[str], optional: Sequence[str], notes: list[str]
) -> list[str]:
    """The columns to read."""
    known = (*needed, *optional)
    twice = next((name for name in known if header.count(name) > 1), None)
    if twice is not None:
        raise InputError(f"{path}: line 1: column {twice} is given twice")
    others = [name for name in header if name not in known]
    for name in others:
        meant = nearest(name, [k for k in known if k not in header])
        if meant is not None:
            raise InputError(f"{path}: line 1: column {_quoted(name)}: did you mean {meant}?")
    missing = [name for name in needed if name not in header]
    if missing:
        found = ", ".join(map(_quoted, header))
        words = f"column {missing[0]} is missing; must name {', '.join(needed)}, found {found}"
        raise InputError(f"{path}: line 1: {words}")
    if others:
        notes.append(f"{path}: columns without a meaning here: {', '.join(map(_quoted, others))}")
    return [name for name in known if name in header]


def _quoted(text: str) -> str:
    """A text in quotes, on one line, cut short where it is long."""
    shown = text if len(text) <= LONGEST_VALUE else text[: LONGEST_VALUE - 4] + " ..."
    return json.dumps(shown, ensure_ascii=False)
