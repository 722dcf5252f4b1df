"""The compiled loops: a C file for each subject."""

from __future__ import annotations

import ctypes
from functools import cache
from pathlib import Path
from typing import Any

from mpi4py import MPI

from extremal import native

FLOATS = {"kernel": ("sweep",), "relaxations": ("relax",)}  # what returns a number


@cache
def library(subject: str = "kernel") -> ctypes.CDLL:
    """The compiled `subject`.c of this folder; every rank loads it, any of them may be first to compile it."""
    source = Path(__file__).with_name(f"{subject}.c").read_text(encoding="utf-8")
    made = native.load(MPI.COMM_SELF, f"hawkes_{subject}", source, lambda: source)
    for name in FLOATS.get(subject, ()):
        getattr(made, f"extremal_{name}").restype = ctypes.c_double
    return made


def call(name: str, *arguments: Any, subject: str = "kernel") -> Any:
    """Call extremal_`name` of `subject`.c; arrays go as pointers, C-contiguous and of the types stated there."""
    return getattr(library(subject), f"extremal_{name}")(*(native.argument(a) for a in arguments))
