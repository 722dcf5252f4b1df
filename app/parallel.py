"""Running the same program on every rank: results and failures of one rank reach all of them."""

from __future__ import annotations

import errno
import pickle
import sys
import time
import traceback
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, TypeVar

from .errors import EXIT_FINISHED, EXIT_INPUT, EXIT_INTERRUPTED, EXIT_UNEXPECTED, ExtremalError

if TYPE_CHECKING:
    from mpi4py import MPI

T = TypeVar("T")

# How long [s] a failed rank 0 waits for the others to fail in the same way before it ends them.
PATIENCE = 1.0

# What provides the libraries which do not come with this package.
DEBIAN_PACKAGES = {
    "dolfinx": "python3-dolfinx",
    "gmsh": "python3-gmsh",
    "h5py": "python3-h5py",
    "matplotlib": "python3-matplotlib",
    "meshio": "python3-meshio",
    "petsc4py": "python3-petsc4py",
    "scipy": "python3-scipy",
    "sympy": "python3-sympy",
}


def on_root(comm: MPI.Comm, function: Callable[[], T]) -> T:
    """Run `function` on rank 0 and return its result, or raise its exception, on all ranks (collective).

    Parameters
    ----------
    comm : MPI.Comm
    function : callable
        Takes nothing; its result must be picklable. It may not itself be collective.

    Raises
    ------
    Exception
        Whatever `function` raised, the same on all ranks.
    """
    if comm.size == 1:
        return function()
    outcome: tuple[bool, Any] = (True, None)
    if comm.rank == 0:
        try:
            outcome = (True, function())
        except Exception as error:
            outcome = (False, _picklable(error))
    succeeded, value = comm.bcast(outcome, root=0)
    if not succeeded:
        raise value
    return value


def _picklable(error: Exception) -> Exception:
    """Return the exception itself if it survives pickling, or a RuntimeError that says the same."""
    try:
        copy = pickle.loads(pickle.dumps(error))
        if type(copy) is type(error) and str(copy) == str(error):
            return error
    except Exception:
        pass
    return RuntimeError(f"{type(error).__name__}: {error}")


def run_on_all(comm: MPI.Comm, main: Callable[[], int], program: str = "extremal") -> int:
    """Run `main` on every rank and turn any exception into one message and an exit code (collective).

    An `ExtremalError`, a `MeshError` or a `LawError`, is expected on all ranks: rank 0 prints
    its lines and every rank returns the exit code. Any other exception is a fault of the program: its
    traceback is printed once. Where only some ranks fail the rest would wait for them for ever, so they are
    ended through `comm.Abort` after a moment.

    Parameters
    ----------
    comm : MPI.Comm
    main : callable
        The program; returns its exit code.
    program : str
        Put before each message.

    Returns
    -------
    int
        The process's exit code.
    """
    # A communicator of its own: a failed rank's barrier must not be taken for a step of the computation.
    private = comm.Dup() if comm.size > 1 else None
    try:
        return main()
    except BrokenPipeError:
        # The reader of our output (`| head`) has gone: nothing is wrong, and nobody is left to tell.
        sys.stdout = open("/dev/null", "w")  # noqa: SIM115 - must outlive this function, to silence the flush at exit
        return EXIT_FINISHED
    except KeyboardInterrupt:
        # mpirun sends the signal to every rank: none has to be waited for.
        if comm.rank == 0:
            print(f"{program}: interrupted", file=sys.stderr, flush=True)
        return EXIT_INTERRUPTED
    except Exception as error:
        text, code = _explain(error, program)
        if comm.rank == 0:
            print(text, file=sys.stderr, flush=True)
        if private is not None and not _all_here(private):
            if comm.rank != 0:
                print(f"rank {comm.rank}: {text}", file=sys.stderr, flush=True)
            comm.Abort(code)
        return code


def _explain(error: Exception, program: str) -> tuple[str, int]:
    """Return what to print about an exception, and the exit code."""
    if isinstance(error, ExtremalError):
        return "\n".join(f"{program}: {line}" for line in error.messages), error.exit_code
    if isinstance(error, _input_errors()):
        return f"{program}: {error}", EXIT_INPUT
    if isinstance(error, OSError) and error.errno == errno.ENAMETOOLONG:
        return f"{program}: {str(error.filename)[:60]} ...: is too long for the name of a file", EXIT_INPUT
    if isinstance(error, ModuleNotFoundError) and str(error.name).partition(".")[0] in DEBIAN_PACKAGES:
        name = str(error.name).partition(".")[0]
        return f"{program}: {name} is not installed; apt install {DEBIAN_PACKAGES[name]}", EXIT_UNEXPECTED
    shown = "".join(traceback.format_exception(error)).rstrip()
    return f"{shown}\n{program}: unexpected {type(error).__name__}: {error}", EXIT_UNEXPECTED


def _input_errors() -> tuple[type[Exception], ...]:
    """Return the input errors of the packages this run has loaded: they do not know ours."""
    names = {
        "extremal.meshes": "MeshError",
        "extremal.forms.laws": "LawError",
        "extremal.obstacles.geometry": "BodyError",
        "extremal.mpm.law": "LawError",
        "extremal.hawkes.events": "DataError",
    }
    return tuple(
        getattr(sys.modules[module], name) for module, name in names.items() if module in sys.modules
    )


def _all_here(private: MPI.Comm) -> bool:
    """Wait for all ranks to come here; tell whether they did.

    Rank 0 waits least, the others in the order of their ranks: the first to give up speaks for all.
    """
    request = private.Ibarrier()
    wait = PATIENCE * (1.0 if private.rank == 0 else 2.0 + 0.25 * min(private.rank, 20))
    end = time.monotonic() + wait
    while not request.Test():
        if time.monotonic() > end:
            return False
        time.sleep(0.01)
    return True
