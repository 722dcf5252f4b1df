"""The compiled loops over particles, and the arrays they share with Python."""

from __future__ import annotations

import ctypes
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from mpi4py import MPI

from extremal import native

NODES = {"cubic": 4, "quadratic": 3}
_SOURCES = ("kernel.c", "splines.h", "grid.h", "snow.h", "transfer.h", "flow.h")


class Box(ctypes.Structure):
    """Bounding box of nodes (grid.h), for two or three dimensions."""

    _fields_ = [("low", ctypes.c_int32 * 3), ("nodes", ctypes.c_int32 * 3), ("words", ctypes.c_int64)]


class Box2(ctypes.Structure):
    """Bounding box of nodes in the plane."""

    _fields_ = [("low", ctypes.c_int32 * 2), ("nodes", ctypes.c_int32 * 2), ("words", ctypes.c_int64)]


MODULI = 4  # numbers a particle, see snow.h
# one body's parameters, as `Law` in snow.h
LAW = np.dtype(
    [
        ("mu", "f8"),
        ("lambda", "f8"),
        ("hardening", "f8"),
        ("least", "f8"),
        ("largest", "f8"),
        ("cap", "f8"),
        ("wave_speed", "f8"),
        ("energy", "i4"),
        ("plastic", "i4"),
    ]
)


@dataclass(frozen=True)
class Kernel:
    """Compiled loops for one dimension, spline and precision of the node arrays.

    `call("to_grid", ...)` hands arrays over as pointers, numbers as they are.
    """

    dimension: int
    spline: str
    real: np.dtype
    library: ctypes.CDLL

    @property
    def rows(self) -> int:
        """Rows of nodes in a particle's stencil."""
        return NODES[self.spline] ** (self.dimension - 1)

    def call(self, name: str, *arguments: Any) -> Any:
        """Call extremal_`name`; arrays must be C-contiguous and of the types that kernel.c states."""
        return getattr(self.library, f"extremal_{name}")(*(native.argument(a) for a in arguments))


def load(comm: MPI.Comm, dimension: int, spline: str = "cubic", precision: str = "double") -> Kernel:
    """The kernel for `dimension` 2 or 3, `spline` "cubic" or "quadratic", `precision` "double" or "single"."""
    here = Path(__file__).parent
    single = {"double": 0, "single": 1}[precision]
    head = f"#define D {dimension}\n#define N {NODES[spline]}\n#define SINGLE {single}\n"
    text = {name: (here / name).read_text(encoding="utf-8") for name in _SOURCES}
    library = native.load(
        comm, f"snow{dimension}d", head + "".join(text.values()), lambda: head + text["kernel.c"], include=here
    )
    for name in ("box", "sort", "number"):
        getattr(library, f"extremal_{name}").restype = ctypes.c_int64
    return Kernel(dimension, spline, np.dtype(np.float32 if single else np.float64), library)


def box_for(dimension: int) -> Box | Box2:
    """An empty box."""
    return Box() if dimension == 3 else Box2()
