"""Below the parts: machine code for loops that Python cannot afford (compiled once on this machine, kept in the user's
cache), and, in `options`, defaults for PETSc's objects."""

from __future__ import annotations

import ctypes
import hashlib
import os
import platform
import shlex
import subprocess
import sysconfig
import tempfile
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from mpi4py import MPI

# No -ffast-math: nan and signed zeros keep their meaning, and linking it would flush denormals process-wide.
FLAGS = ("-O3", "-march=native", "-fno-math-errno", "-fno-trapping-math", "-fPIC", "-shared")
STANDARD = {"c": "-std=gnu11", "c++": "-std=c++17"}  # gnu: multiplications and additions may be fused
COMPILER = {"c": ("CC", "cc"), "c++": ("CXX", "c++")}


class CompileError(RuntimeError):
    """The compiler refused the source; the message is its first complaint."""


def load(
    comm: MPI.Comm,
    name: str,
    key: str,
    source: Callable[[], str],
    *,
    language: str = "c",
    include: Path | None = None,
) -> ctypes.CDLL:
    """A shared library made from `source` (collective: rank 0 compiles).

    Parameters
    ----------
    comm : mpi4py.MPI.Comm
    name : str
        Beginning of the file's name in the cache.
    key : str
        Whatever the machine code depends on besides compiler flags and processor.
    source : callable
        Gives the source; called only where the cache does not have the library.
    language : str
        "c" or "c++".
    include : Path, optional
        Folder of headers.

    Raises
    ------
    CompileError, OSError
        On all ranks.
    """
    outcome: str | Exception = ""
    if comm.rank == 0:
        try:
            outcome = str(_build(name, key, source, language, include))
        except (OSError, CompileError) as error:
            outcome = error
    outcome = comm.bcast(outcome)
    if isinstance(outcome, Exception):
        raise outcome
    return ctypes.CDLL(outcome)


def argument(value: Any) -> Any:
    """A number, a C-contiguous array or a structure as C takes it: double, int64_t, pointer.

    Raises
    ------
    ValueError
        If the array is not C-contiguous.
    """
    if isinstance(value, np.ndarray):
        if not value.flags.c_contiguous:
            raise ValueError("array is not C-contiguous")
        return ctypes.c_void_p(value.ctypes.data)
    if isinstance(value, ctypes.Structure):
        return ctypes.byref(value)
    return ctypes.c_double(value) if isinstance(value, float | np.floating) else ctypes.c_int64(int(value))


@cache
def _machine() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        return next(line for line in lines if line.startswith("flags"))
    except (OSError, StopIteration):
        return platform.machine()


def _build(name: str, key: str, source: Callable[[], str], language: str, include: Path | None) -> Path:
    flags = [*FLAGS, STANDARD[language]]
    digest = hashlib.sha256("|".join([key, _machine(), *flags]).encode()).hexdigest()[:24]
    folder = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "extremal"
    library = folder / f"{name}_{digest}.so"
    if library.exists():
        return library
    folder.mkdir(parents=True, exist_ok=True)
    variable, default = COMPILER[language]
    compiler = shlex.split(os.environ.get(variable) or sysconfig.get_config_var(variable) or default)[:1]
    with tempfile.TemporaryDirectory(dir=folder) as scratch:
        text = Path(scratch) / ("code.c" if language == "c" else "code.cpp")
        text.write_text(source(), encoding="utf-8")
        made = Path(scratch) / "code.so"
        folders = [f"-I{include}"] if include is not None else []
        done = subprocess.run(
            [*compiler, *flags, *folders, str(text), "-o", str(made), "-lm"], capture_output=True, text=True
        )
        if done.returncode:
            said = done.stderr.splitlines() or ["no reason given"]
            raise CompileError(next((line for line in said if "error" in line), said[0]).strip())
        made.replace(library)
    return library
