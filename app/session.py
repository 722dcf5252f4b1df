"""The loop every part runs in: advance, look, write, save, until the end, a failure or a request to stop."""

from __future__ import annotations

import contextlib
import time as clock
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from . import checkpoint as checkpoints
from . import record, results
from .errors import EXIT_FINISHED, EXIT_SOLVER, ExtremalError, InputError
from .expectations import Expectation, check_expectations
from .parallel import on_root
from .progress import Progress
from .results import OutputError, Series, Table
from .signals import StopRequest, stop_requests
from .stepsize import StepSize

if TYPE_CHECKING:
    from mpi4py import MPI
    from numpy.typing import NDArray

# A checkpoint is written when this much wall time has passed since the last one, however few the steps [s].
CHECKPOINT_SECONDS = 600.0


class Problem(Protocol):
    """What a session drives; every method is collective.

    Attributes
    ----------
    time : float
        Time [s] or load parameter.
    effects : dict
        Effects that are on, with facts about each.
    on_iteration : callable, optional
        Set by the session; called on all ranks with figures of each solver iteration.
    """

    comm: MPI.Comm
    time: float
    effects: dict[str, dict[str, float]]
    on_iteration: Callable[[dict[str, float]], None] | None

    def advance(self, dt: float) -> dict[str, float]:
        """Make one step to `time + dt`, or raise ArithmeticError on all ranks with the state as before."""
        ...

    def diagnostics(self) -> dict[str, float]:
        """Return the columns of history.csv, the same on all ranks."""
        ...

    def state(self) -> dict[str, NDArray[Any]]:
        """Return on rank 0 everything `restore` needs, in an order that does not depend on the ranks."""
        ...

    def restore(self, state: dict[str, NDArray[Any]]) -> None:
        """Take over a state from rank 0."""
        ...

    def geometry(self) -> tuple[NDArray[Any], NDArray[Any], str] | None:
        """Return on rank 0 points (n, 3) [m], cells (m, k) and their meshio name; None elsewhere or without mesh."""
        ...

    def fields(
        self, names: Sequence[str] | None = None
    ) -> tuple[dict[str, NDArray[Any]], dict[str, NDArray[Any]]] | None:
        """Return on rank 0 the fields at points and in cells."""
        ...


@dataclass(frozen=True)
class Outcome:
    """How a run ended."""

    status: str  # "finished", "stopped" or "failed"
    reason: str
    exit_code: int
    steps: int
    time: float
    diagnostics: dict[str, float]
    expectations: list[Expectation] = field(default_factory=list)


def run(
    problem: Problem,
    scene: Any,
    folder: Path | str,
    *,
    restart: Path | str | None = None,
    scene_path: Path | str | None = None,
    quiet: bool = False,
) -> Outcome:
    """Run a problem to the end of its scene and leave a results folder (collective).

    Parameters
    ----------
    scene : pydantic model
        With `title`, `part`, `analysis`, `output` and `expect`.
    folder : path
        Results folder; what an earlier run left there is replaced, unless this run is its continuation.
    restart : path, optional
        Results folder (the newest good checkpoint counts) or checkpoint file to go on from.
    scene_path : path, optional
        Scene file, copied into the results.
    quiet : bool
        No progress, only notes and the end.

    Returns
    -------
    Outcome
        Exit code 0: finished, every expectation met; 3: failed, stopped by a signal, or an expectation missed.

    Raises
    ------
    InputError
        If the restart cannot be made.
    """
    session = _Session(problem, scene, Path(folder), quiet)
    places = [None if place is None else Path(place) for place in (restart, scene_path)]
    with stop_requests() as request:
        return session.run(request, *places)


class _Session:
    """The state of one run besides the problem's own."""

    def __init__(self, problem: Problem, scene: Any, folder: Path, quiet: bool) -> None:
        from petsc4py import PETSc

        record.start_log()
        self.problem, self.scene, self.folder, self.quiet = problem, scene, folder, quiet
        self.comm = problem.comm
        self.is_root = self.comm.rank == 0
        analysis = scene.analysis
        self.step_size = StepSize(
            first=analysis.time_step,
            end=analysis.end_time,
            smallest=analysis.smallest_step,
            largest=analysis.largest_step,
            adaptive=analysis.adaptive,
            every=scene.output.every,
        )
        self.output_event = PETSc.Log.Event("session:output")
        self.checkpoint_event = PETSc.Log.Event("session:checkpoint")
        self.plain_scene = scene.model_dump(mode="json")

        self.step = 0
        self.iterations = 0  # solver iterations of all steps and attempts
        self.totals: dict[str, float] = {}
        self.frame_times: list[float] = []
        self.frame_step = self.saved_step = -1
        self.wall_before = 0.0  # seconds spent before a restart
        self.begin = self.saved_clock = clock.monotonic()
        self.began = record.now()
        self.diagnostics: dict[str, float] = {}
        self.postponed: OutputError | None = None  # of rank 0, until the ranks can agree on it
        self.series: Series | None = None
        self.progress: Progress | None = None

    # ------------------------------------------------------------------ the main path

    def run(self, request: StopRequest, restart: Path | None, scene_path: Path | None) -> Outcome:
        status, reason = "finished", ""
        try:
            self._start(restart, scene_path)
            while not self.step_size.finished(self.problem.time):
                cutbacks = self._advance(request)
                self._look(cutbacks)
                self._save_if_due(request)
            self._save()
        except _Ended as end:
            status, reason = end.status, end.reason
            reason += self._try_to_save()
        except OutputError as error:
            status, reason = "failed", str(error)
        except InputError:
            raise
        except Exception as error:
            # perhaps of this rank alone: nothing collective any more
            self._write_crash(error)
            raise
        finally:
            self.problem.on_iteration = None
            if self.progress is not None:
                self.progress.close()
        return self._finish(status, reason)

    def _start(self, restart: Path | None, scene_path: Path | None) -> None:
        """Prepare the folder and the problem, from the beginning or from a checkpoint."""
        geometry = self.problem.geometry()
        notes: list[str] = []
        if restart is not None:
            notes = self._restore(restart, geometry)

        def prepare() -> None:
            results.prepare(self.folder, keep=restart is not None)
            if scene_path is not None:
                results.write_text(self.folder / results.SCENE, scene_path.read_text(encoding="utf-8"))
            self.history = Table(self.folder / results.HISTORY)
            self.iteration_table = Table(self.folder / results.ITERATIONS)
            self._drop_what_came_later()
            if geometry is not None:
                self.series = Series(self.folder, geometry, self.frame_times)
            record.write_record(self.folder, self._record("running", ""))
            title = self.scene.title or self.scene.part
            self.progress = Progress(title, self.problem.time, self.step_size.end, self.quiet)
            for note in notes:
                self.progress.note(note)

        on_root(self.comm, prepare)
        self.has_fields = self.comm.bcast(geometry is not None)
        self.problem.on_iteration = self._on_iteration
        self.diagnostics = self.problem.diagnostics()
        if restart is None:
            self._write_row(0.0, 0)
            self._write_frame()

    def _advance(self, request: StopRequest) -> int:
        """Make one step, with as many shorter attempts as it takes; return how many failed."""
        cutbacks = 0
        while True:
            dt, end = self.step_size.propose(self.problem.time)
            before = self.iterations
            try:
                figures = self.problem.advance(dt)
            except ArithmeticError as error:
                reason = (str(error).splitlines() or [type(error).__name__])[0]
                self._agree_on_postponed()
                self._stop_if_asked(request)
                if not self.step_size.rejected(dt, getattr(error, "wanted_step", None)):
                    which = "the smallest step" if self.step_size.adaptive else "the fixed step"
                    raise _Ended("failed", f"step {self.step + 1}, dt {dt:.3g} ({which}): {reason}") from error
                cutbacks += 1
                shorter = self.step_size.dt
                self._note(f"step {self.step + 1}: dt {dt:.3g} failed ({reason}); trying {shorter:.3g}")
                continue
            self.problem.time = end  # a milestone is hit exactly
            self.dt = dt
            self.step += 1
            if self.iterations == before:  # a problem that does not call back still counts what it did
                self.iterations += int(figures.get("newton_iterations", 0))
            iterations = figures.get("newton_iterations")
            self.step_size.accepted(dt, iterations, figures.get("wanted_step"))
            for name, figure in figures.items():
                if name.endswith("_iterations"):
                    self.totals[name] = self.totals.get(name, 0) + figure
            return cutbacks

    def _look(self, cutbacks: int) -> None:
        """Write down what the step brought."""
        self._agree_on_postponed()
        self.diagnostics = self.problem.diagnostics()
        self._write_row(self.dt, cutbacks)
        if self.step_size.on_milestone(self.problem.time):
            self._write_frame()
        if self.progress is not None:
            self.progress.step(self.step, self.problem.time, self.dt, self.diagnostics, self._wall())

    def _save_if_due(self, request: StopRequest) -> None:
        late = clock.monotonic() - self.saved_clock > CHECKPOINT_SECONDS
        # Rank 0's clock decides, so that all take part in the checkpoint.
        every = self.scene.output.checkpoint_every
        if self.comm.bcast(late) or (every and self.step % every == 0):
            self._save()
        self._stop_if_asked(request)

    def _stop_if_asked(self, request: StopRequest) -> None:
        from mpi4py import MPI

        number = self.comm.allreduce(request.number, MPI.MAX)
        if number and not self.step_size.finished(self.problem.time):
            raise _Ended("stopped", f"by {request.name(number)} after step {self.step}")

    def _finish(self, status: str, reason: str) -> Outcome:
        """Write the record and the picture, tell the end, and return it."""
        found: dict[str, float | str] = {**self.diagnostics, "status": status, "steps": float(self.step)}
        expectations = check_expectations(self.scene.expect, found)
        missed = [expectation.name for expectation in expectations if not expectation.met]
        good = status == "finished" and not missed
        facts = self._record(status, reason)
        facts["events"] = record.event_seconds(self.comm)
        facts["effects"] = record.effects_with_cost(self.scene.part, self.problem.effects, facts["events"])
        facts |= {"expect": expectations, "exit_code": EXIT_FINISHED if good else EXIT_SOLVER}
        facts |= record.resources(self.comm) or {}

        if self.is_root:
            with contextlib.suppress(OutputError):  # a full disk has been told of already
                record.write_record(self.folder, facts)
            self._draw()
            for expectation in expectations:
                print(expectation)
            words = [status + (f" {reason}" if status == "stopped" else f": {reason}" if reason else "")]
            words += [f"{len(missed)} of {len(expectations)} expectations MISSED"] if missed else []
            print(", ".join([*words, f"results in {self.folder}"]), flush=True)
        self.comm.barrier()
        exit_code = EXIT_FINISHED if good else EXIT_SOLVER
        return Outcome(status, reason, exit_code, self.step, self.problem.time, self.diagnostics, expectations)

    # ------------------------------------------------------------------ output

    def _write_row(self, dt: float, cutbacks: int) -> None:
        row = {"step": self.step, "time": self.problem.time, "dt": dt, "cutbacks": cutbacks}
        row |= {"wall": self._wall(), **self.diagnostics}
        with self.output_event:
            on_root(self.comm, lambda: self.history.append(row))

    def _write_frame(self, agreed: bool = True) -> None:
        """Write a frame of the fields; with `agreed` false, keep rank 0's failure for later."""
        if not self.has_fields:
            return
        with self.output_event:
            fields = self.problem.fields(self.scene.output.fields)

            def write() -> None:
                assert self.series is not None and fields is not None
                # among frames of solver iterations, the count of iterations is the only clock that moves
                pseudo_time = float(self.iterations) if self.scene.output.iterations else self.problem.time
                self.series.write(pseudo_time, *fields)

            if agreed:
                on_root(self.comm, write)
                self.frame_step = self.step
            elif self.is_root and self.postponed is None:
                self._postpone(write)

    def _on_iteration(self, figures: dict[str, float]) -> None:
        """Note one iteration of the solver (called inside `advance`, where nothing may be raised)."""
        if figures.get("iteration", 1) > 0:
            self.iterations += 1
        if self.is_root:
            row = {"step": self.step + 1, "total": self.iterations, **figures}
            self._postpone(lambda: self.iteration_table.append(row))
            if self.progress is not None:
                self.progress.iteration(figures)
        every = self.scene.output.iterations
        if every and figures.get("iteration", 1) > 0 and self.iterations % every == 0:
            self._write_frame(agreed=False)

    def _postpone(self, write: Callable[[], None]) -> None:
        try:
            write()
        except OutputError as error:
            self.postponed = self.postponed or error

    def _agree_on_postponed(self) -> None:
        """Raise on all ranks what went wrong on rank 0 while only it could know."""

        def tell() -> None:
            if self.postponed is not None:
                raise self.postponed

        on_root(self.comm, tell)

    def _draw(self) -> None:
        if not self.scene.output.summary:
            return
        try:
            from .summary import draw

            draw(self.folder)
        except (OutputError, ImportError) as error:
            print(f"{results.SUMMARY} not drawn: {error}")

    def _note(self, text: str) -> None:
        if self.progress is not None:
            self.progress.note(text)

    # ------------------------------------------------------------------ checkpoints

    def _save(self) -> None:
        """Write a checkpoint of this step, unless there is one."""
        if self.saved_step == self.step:
            return
        with self.checkpoint_event:
            state = self.problem.state()
            geometry = self.problem.geometry()
            facts = {
                "step": self.step,
                "time": self.problem.time,
                "step_size": self.step_size.state(),
                "iterations": self.iterations,
                "totals": self.totals,
                "frame_times": self.series.times if self.series is not None else [],
                "wall": self._wall(),
                "scene": self.plain_scene,
                "geometry": checkpoints.geometry_digest(geometry),
            }
            path = checkpoints.path_of(self.folder, self.step)
            on_root(self.comm, lambda: checkpoints.save(path, state, facts))
        self.saved_step = self.step
        self.saved_clock = clock.monotonic()

    def _try_to_save(self) -> str:
        """Save the last good state after a failure or a stop; return what to add to the reason."""
        try:
            if self.frame_step != self.step:
                self._write_frame()
            self._save()
        except OutputError as error:
            return f"; {error}"
        return ""

    def _restore(self, restart: Path, geometry: Any) -> list[str]:
        """Take over a checkpoint; return lines about damaged ones."""

        kept: list[checkpoints.Checkpoint] = []  # the arrays stay on rank 0

        def read() -> tuple[Path, dict[str, Any], list[str]]:
            found, passed_over = checkpoints.newest(restart)
            checkpoints.check_same(found, self.plain_scene, checkpoints.geometry_digest(geometry))
            kept.append(found)
            return found.path, found.facts, passed_over

        path, facts, notes = on_root(self.comm, read)
        self.problem.restore(kept[0].state if kept else {})
        self.problem.time = facts["time"]
        self.step = self.saved_step = self.frame_step = facts["step"]
        self.step_size.restore(facts["step_size"])
        self.iterations, self.totals = facts["iterations"], facts["totals"]
        self.frame_times = facts["frame_times"]
        self.wall_before = facts["wall"]
        source = path.parent.parent

        def adopt() -> None:
            if source.resolve() != self.folder.resolve():
                results.prepare(self.folder, keep=False)
                results.adopt(source, self.folder, len(self.frame_times))

        on_root(self.comm, adopt)
        return [*notes, f"restarted from {path}: step {self.step}, time {self.problem.time:g}"]

    def _drop_what_came_later(self) -> None:
        """Forget rows and checkpoints later than the step the run goes on from (rank 0)."""
        self.history.keep(lambda row: row["step"] <= self.step)
        self.iteration_table.keep(lambda row: row["step"] <= self.step)
        for path in checkpoints.list_checkpoints(self.folder):
            if checkpoints.step_of(path) > self.step:
                path.unlink()

    # ------------------------------------------------------------------ the record

    def _record(self, status: str, reason: str) -> dict[str, Any]:
        """Return what one rank knows about the run (no communication)."""
        return {
            "title": self.scene.title,
            "part": self.scene.part,
            "status": status,
            "reason": reason,
            "steps": self.step,
            "time": self.problem.time,
            "diagnostics": self.diagnostics,
            "solver_iterations": {"total": self.iterations, **self.totals},
            "began": self.began,
            "ended": None if status == "running" else record.now(),
            "wall_seconds": self._wall(),
            "ranks": self.comm.size,
            "effects": self.problem.effects,
            "versions": record.versions(),
            "petsc_options": record.petsc_options(),
            "scene": self.plain_scene,
        }

    def _write_crash(self, error: Exception) -> None:
        if self.is_root and self.folder.is_dir():
            reason = f"{type(error).__name__}: {error}".splitlines()[0]
            with contextlib.suppress(ExtremalError):
                record.write_record(self.folder, self._record("failed", reason))

    def _wall(self) -> float:
        return self.wall_before + clock.monotonic() - self.begin


class _Ended(Exception):
    """The run ends before its time."""

    def __init__(self, status: str, reason: str) -> None:
        super().__init__(reason)
        self.status, self.reason = status, reason
