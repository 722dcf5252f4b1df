"""The compiled loops: a C file for each subject."""

from __future__ import annotations

import ctypes
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from mpi4py import MPI

from extremal import native

FLOATS = {"kernel": ("sweep",), "relaxations": ("relax",)}  # what returns a number
_LONG, _DOUBLE, _POINTER = ctypes.c_int64, ctypes.c_double, ctypes.c_void_p


@cache
def library(subject: str = "kernel") -> ctypes.CDLL:
    """The compiled `subject`.c of this folder; every rank loads it, any of them may be first to compile it."""
    source = Path(__file__).with_name(f"{subject}.c").read_text(encoding="utf-8")
    made = native.load(MPI.COMM_SELF, f"hawkes_{subject}", source, lambda: source)
    for name in FLOATS.get(subject, ()):
        getattr(made, f"extremal_{name}").restype = _DOUBLE
    return made


def call(name: str, *arguments: Any, subject: str = "kernel") -> Any:
    """Call extremal_`name` of `subject`.c; arrays go as pointers, C-contiguous and of the types stated there."""
    return getattr(library(subject), f"extremal_{name}")(*(_argument(a) for a in arguments))


def _argument(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        if not value.flags.c_contiguous:
            raise ValueError("array is not C-contiguous")
        return _POINTER(value.ctypes.data)
    return _DOUBLE(value) if isinstance(value, float | np.floating) else _LONG(int(value))
