"""Exceptions a person is meant to read, and the exit codes they lead to."""

from __future__ import annotations

import difflib
from collections.abc import Iterable

EXIT_FINISHED = 0
EXIT_UNEXPECTED = 1
EXIT_INPUT = 2
EXIT_SOLVER = 3
EXIT_INTERRUPTED = 130


class ExtremalError(Exception):
    """Base of the errors that end a run with plain lines instead of a traceback.

    Parameters
    ----------
    message : str
        One line naming file, key (or element), value and what would be accepted.
    *more : str
        Further errors of the same kind, one line each: all are shown together.
    """

    exit_code = EXIT_UNEXPECTED

    def __init__(self, message: str, *more: str) -> None:
        super().__init__(message, *more)
        self.messages: tuple[str, ...] = (message, *more)

    def __str__(self) -> str:
        return "\n".join(self.messages)


class InputError(ExtremalError):
    """A scene, mesh, option or folder which cannot be used as given (exit code 2)."""

    exit_code = EXIT_INPUT


def nearest(name: str, known: Iterable[str]) -> str | None:
    """Return the known name most like `name`, or None when none is near enough to be meant."""
    known = list(known)
    folded = {candidate.lower(): candidate for candidate in known}
    found = difflib.get_close_matches(name.lower(), folded, n=1, cutoff=0.6)
    return folded[found[0]] if found else None


def suggestion(name: str, known: Iterable[str], most: int = 24) -> str:
    """Return what to say after an unknown name: the nearest known one, or all when they are few.

    Examples
    --------
    >>> suggestion("yung_modulus", ["young_modulus", "density"])
    'did you mean young_modulus?'
    >>> suggestion("q", ["x", "y"])
    'known: x, y'
    """
    known = list(dict.fromkeys(known))
    found = nearest(name, known)
    if found is not None:
        return f"did you mean {found}?"
    if not known:
        return "none is known"
    return "known: " + ", ".join(known[:most]) + (", ..." if len(known) > most else "")
