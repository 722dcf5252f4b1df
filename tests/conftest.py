"""Run the tests serially, or the ones marked `mpi` on every rank: `mpirun -n N python -m pytest -m mpi`.

In parallel every rank runs the same tests in the same order, between barriers. A test that fails on one rank
only would leave the others waiting in a collective call, so the first failure ends all ranks. Only rank 0
writes to the terminal.
"""

import csv
import faulthandler
import gc
import logging
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Generator
from pathlib import Path
from typing import Any

_root = Path(__file__).resolve().parent.parent
os.environ.setdefault("OMP_NUM_THREADS", "1")  # before NumPy is loaded: the ranks share the cores already
os.environ.setdefault("MPLBACKEND", "Agg")
os.environ.setdefault("OMPI_MCA_btl", "^tcp")  # all ranks are on this machine
if os.geteuid() == 0:  # mpirun refuses root otherwise
    os.environ.update(OMPI_ALLOW_RUN_AS_ROOT="1", OMPI_ALLOW_RUN_AS_ROOT_CONFIRM="1")
os.environ.setdefault("XDG_CACHE_HOME", str(_root / "build" / "cache"))  # where dolfinx keeps compiled forms

import hypothesis  # noqa: E402
import pytest  # noqa: E402
from mpi4py import MPI  # noqa: E402

_world = MPI.COMM_WORLD
_parallel = _world.size > 1
_TIME_LIMIT = float(os.environ.get("EXTREMAL_TEST_TIMEOUT", "300"))  # [s] one test may take; 0 for no limit
_LONG = 10.0  # how much more a test marked `long` may take

# the same examples on every rank and in every run
hypothesis.settings.register_profile("extremal", derandomize=True, deadline=None, database=None)
hypothesis.settings.load_profile("extremal")


class _Streams:
    """What the hooks share: stderr behind pytest's capture, and a file that only one rank can create."""

    stderr: int
    first_failure: Path


def pytest_configure(config: pytest.Config) -> None:
    for name in (None, "UFL", "FFCX", "UFL_LEGACY"):  # they announce each compilation
        logging.getLogger(name).setLevel(logging.WARNING)


@pytest.hookimpl(tryfirst=True)
def pytest_sessionstart(session: pytest.Session) -> None:
    _Streams.stderr = os.dup(2)
    if _parallel:
        folder = _world.bcast(tempfile.mkdtemp(prefix="extremal-tests-") if _world.rank == 0 else None)
        _Streams.first_failure = Path(folder) / "first_failure"
        if _world.rank > 0:
            session.config.get_terminal_writer()._file = open(os.devnull, "w")  # type: ignore[attr-defined]


def pytest_sessionfinish() -> None:
    if _parallel and _world.rank == 0:
        _Streams.first_failure.parent.rmdir()


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    if not _parallel:
        return
    config.hook.pytest_deselected(items=[item for item in items if not item.get_closest_marker("mpi")])
    items[:] = [item for item in items if item.get_closest_marker("mpi")]
    names = [item.nodeid for item in items]
    if any(other != names for other in _world.allgather(names)):
        raise pytest.UsageError("the ranks collected different tests: parameters must not depend on the rank")


def _petsc_options() -> set[str]:
    """Names in PETSc's options database, which all tests of a process share."""
    petsc = sys.modules.get("petsc4py.PETSc")
    if petsc is None:
        return set()
    return set(petsc.Options().getAll())


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Generator[None, object, object]:
    """Limit the time of one test; in parallel keep the ranks together and collect garbage on all at once.

    PETSc and dolfinx objects are destroyed collectively: were each rank's collector to choose its moment, the
    ranks could deadlock.
    """
    limit = _TIME_LIMIT * (_LONG if item.get_closest_marker("long") else 1.0)
    if limit > 0:
        # one rank after the other says where it is; the last one ends the run
        faulthandler.dump_traceback_later(
            limit + 0.3 * _world.rank, exit=_world.rank == _world.size - 1, file=_Streams.stderr
        )
    if _parallel:
        gc.disable()
    options = _petsc_options()
    try:
        result = yield
        for name in _petsc_options() - options:  # they would configure the next test's solvers
            sys.modules["petsc4py.PETSc"].Options().delValue(name)
        if _parallel:
            gc.collect()
            _world.barrier()
        return result
    finally:
        faulthandler.cancel_dump_traceback_later()


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_runtest_makereport(
    item: pytest.Item, call: pytest.CallInfo[None]
) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    report = yield
    if _parallel and report.failed:
        try:
            _Streams.first_failure.touch(exist_ok=False)
        except OSError:  # another rank prints the same failure; leave it the time to do so
            time.sleep(20)
        else:
            where = f"rank {_world.rank} of {_world.size} ({report.when})"
            text = f"\n{item.nodeid} failed on {where}\n{report.longreprtext}\n"
            for title, output in report.sections:
                text += f"--- {title} ---\n{output}\n"
            os.write(_Streams.stderr, text.encode())
            _Streams.first_failure.unlink()
            _Streams.first_failure.parent.rmdir()
        _world.Abort(1)
    return report


@pytest.fixture
def figures(request: pytest.FixtureRequest) -> Callable[..., None]:
    """Keep figures of a hard case for the record that `-m hard` writes: `figures(energy=0.9)`."""

    def keep(**values: float) -> None:
        request.node.user_properties.extend(values.items())

    return keep


def pytest_terminal_summary(terminalreporter: Any, config: pytest.Config) -> None:
    """Where hard cases alone are run, list what came of them, and write build/hard_cases.csv."""
    if config.getoption("markexpr") != "hard" or _world.rank > 0:
        return
    outcomes = ("passed", "failed", "error", "skipped")
    reports = [(name, report) for name in outcomes for report in terminalreporter.stats.get(name, ())]
    rows = [
        (report.nodeid.partition("/")[2], name, f"{getattr(report, 'duration', 0.0):.2f}", _figures(report))
        for name, report in reports
    ]
    path = _root / "build" / "hard_cases.csv"
    path.parent.mkdir(exist_ok=True)
    with open(path, "w", newline="", encoding="utf-8") as file:
        csv.writer(file).writerows([("case", "outcome", "seconds", "figures"), *sorted(rows)])
    terminalreporter.section("hard cases")
    for row in sorted(rows):
        if row[3]:
            terminalreporter.write_line(f"{row[0]}: {row[1]}, {row[3]}")
    terminalreporter.write_line(f"all {len(rows)}: {path}")


def _figures(report: pytest.TestReport) -> str:
    return ", ".join(f"{name.replace('_', ' ')} {value:.3g}" for name, value in report.user_properties)


@pytest.fixture
def launch() -> Callable[..., subprocess.CompletedProcess[str]]:
    """Run this Python in new processes: `launch(2, "-m", "extremal.app", ...)`; 0 ranks: without mpirun.

    This process has started MPI, which leaves marks in the C environment that keep mpirun from working;
    `os.environ` has none.
    """

    def run(ranks: int, *arguments: object, timeout: float = 240, **options: Any) -> subprocess.CompletedProcess[str]:
        mpirun = ["mpirun", "--oversubscribe", "-n", str(ranks)] if ranks else []
        command = [*mpirun, sys.executable, *map(str, arguments)]
        options = {"env": dict(os.environ), "stdin": subprocess.DEVNULL, **options}
        return subprocess.run(command, capture_output=True, text=True, timeout=timeout, **options)

    return run


@pytest.fixture
def comm() -> MPI.Intracomm:
    """Every rank of this run."""
    return _world


@pytest.fixture
def shared_path(tmp_path_factory: pytest.TempPathFactory, comm: MPI.Intracomm) -> Path:
    """One new temporary folder, the same on all ranks."""
    return comm.bcast(tmp_path_factory.mktemp("shared") if comm.rank == 0 else None)
