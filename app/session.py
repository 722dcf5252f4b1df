"""The loop every part runs in: advance, look, write, save, until the end, a failure or a request to stop."""

from __future__ import annotations

import contextlib
import importlib
import math
import sys
import time as clock
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from . import checkpoint as checkpoints
from . import record, results
from .errors import EXIT_FINISHED, EXIT_SOLVER, ExtremalError, InputError
from .expectations import Expectation, check_expectations
from .output import Counts, Output
from .parallel import on_root
from .problem import Problem
from .progress import Progress
from .results import OutputError
from .signals import StopRequest, stop_requests
from .stepsize import StepSize

# A checkpoint is written when this much wall time has passed since the last one, however few the steps [s].
CHECKPOINT_SECONDS = 600.0
SUMMARIES = {"snow": "snow_summary", "hawkes": "hawkes_summary"}


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
        Exit code 0: finished, all expectations met; 3: failed, stopped by a signal, or one missed.

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
        analysis = scene.analysis
        self.step_size = StepSize(
            first=analysis.time_step,
            end=analysis.end_time,
            smallest=analysis.smallest_step,
            largest=analysis.largest_step,
            adaptive=analysis.adaptive,
            every=getattr(scene.output, "every", None),
        )
        self.counts = Counts()
        self.output = Output(problem, scene.output, folder, self.counts)
        self.checkpoint_event = PETSc.Log.Event("session:checkpoint")
        self.plain_scene = scene.model_dump(mode="json")
        self.scene_path: Path | None = None
        self.diagnostics: dict[str, float] = {}
        self.saved_step = -1
        self.wall_before = 0.0  # seconds spent before a restart
        self.cpu_before = clock.process_time()  # seconds that libraries, mesh and assembly have taken
        self.begin = self.saved_clock = clock.monotonic()
        self.began = record.now()

    # ------------------------------------------------------------------ the main path

    def run(self, request: StopRequest, restart: Path | None, scene_path: Path | None) -> Outcome:
        status, reason = "finished", ""
        self.scene_path = scene_path
        try:
            self._start(restart, scene_path)
            while not self.step_size.finished(self.problem.time):
                dt, cutbacks = self._advance(request)
                self._look(dt, cutbacks)
                self._save_if_due()
                self._stop_if_asked(request)
            self._save()
            self.output.tables()
        except _Ended as end:
            status, reason = end.status, end.reason + (self._try_to_save() if end.state_is_good else "")
        except OutputError as error:
            status, reason = "failed", str(error)
        except InputError:
            raise
        except Exception as error:
            self._write_crash(error)
            raise
        finally:
            self.output.close()
        return self._finish(status, reason)

    def _start(self, restart: Path | None, scene_path: Path | None) -> None:
        """Prepare the folder and the problem, from the beginning or from a checkpoint."""
        geometry = self.problem.geometry()
        notes: list[str] = []
        frame_times: list[float] = []
        if restart is not None:
            frame_times, notes = self._restore(restart, geometry)

        def prepare() -> None:
            if restart is None:
                results.prepare(self.folder, keep=False)
            if scene_path is not None:
                results.write_text(self.folder / results.SCENE, scene_path.read_text(encoding="utf-8"))
            record.write_record(self.folder, self._record("running", ""))

        on_root(self.comm, prepare)
        progress = None
        if self.comm.rank == 0:
            title = self.scene.title or self.scene.part
            progress = Progress(title, self.problem.time, self.step_size.end, self.quiet, self.step_size.first)
        self.output.open(geometry, frame_times, progress)
        for note in notes:
            self.output.note(note)
        self._measure()
        if restart is None:
            self.output.row(0.0, 0, self._wall(), self.diagnostics)
            self.output.frame()

    def _advance(self, request: StopRequest) -> tuple[float, int]:
        """Make one step, with as many shorter attempts as it takes; return its length and how many failed."""
        cutbacks = 0
        while True:
            dt, end = self.step_size.propose(self.problem.time)
            before = self.counts.iterations
            try:
                figures = self.problem.advance(dt)
            except ArithmeticError as error:
                self.output.agree()
                self._stop_if_asked(request)
                self._shorten(dt, error)
                cutbacks += 1
                continue
            self.problem.time = end  # a milestone is hit exactly
            self.counts.add(figures, self.counts.iterations - before)
            self.step_size.accepted(dt, figures.get("newton_iterations"), figures.get("wanted_step"))
            return dt, cutbacks

    def _shorten(self, dt: float, error: ArithmeticError) -> None:
        """Choose a shorter step after a failed one of length `dt`, or end the run."""
        words = str(error).splitlines() or [type(error).__name__]
        step = f"step {self.counts.step + 1}"
        attempt = f"{step}: dt {dt:.3g}"
        wanted = getattr(error, "wanted_step", None)
        if not self.step_size.rejected(dt, wanted):
            which = "the smallest step" if self.step_size.adaptive else "the fixed step"
            where = step if wanted == math.inf else f"{attempt} ({which})"  # no length would help
            raise _Ended("failed", f"{where}: {words[0]}") from error
        self.output.note(f"{attempt} failed ({words[0]}); trying {self.step_size.dt:.3g}")

    def _look(self, dt: float, cutbacks: int) -> None:
        """Write down what the step brought."""
        self.output.agree()
        self._measure()
        self.output.row(dt, cutbacks, self._wall(), self.diagnostics)
        if self.step_size.on_milestone(self.problem.time):
            self.output.frame()

    def _measure(self) -> None:
        """Take the diagnostics; a state that has none ends the run, and is not saved."""
        try:
            self.diagnostics = self.problem.diagnostics()
        except ArithmeticError as error:
            raise _Ended("failed", f"step {self.counts.step}: {error}", state_is_good=False) from error
        energy = self.diagnostics.get("energy", 0.0)
        if not math.isfinite(energy):
            raise _Ended("failed", f"step {self.counts.step}: the energy is {energy:g}", state_is_good=False)

    def _stop_if_asked(self, request: StopRequest) -> None:
        """End the run if any rank has been sent a signal, except where it has just reached its end."""
        from mpi4py import MPI

        number = self.comm.allreduce(request.number, MPI.MAX)
        if number and not self.step_size.finished(self.problem.time):
            raise _Ended("stopped", f"by {request.name(number)} after step {self.counts.step}")

    def _finish(self, status: str, reason: str) -> Outcome:
        """Write the record and the picture, tell the end, and return it."""
        steps = self.counts.step
        found: dict[str, float | str] = {**self.diagnostics, "status": status, "steps": float(steps)}
        expectations = check_expectations(self.scene.expect, found)
        missed = [expectation.name for expectation in expectations if not expectation.met]
        exit_code = EXIT_FINISHED if status == "finished" and not missed else EXIT_SOLVER
        events = record.event_seconds(self.comm)
        facts = self._record(status, reason) | {
            "exit_code": exit_code,
            "expect": expectations,
            "events": events,
            "effects": record.effects_with_cost(self.scene.part, self.problem.effects, events),
        }
        facts |= record.resources(self.comm, self.cpu_before) or {}
        unwritten = on_root(self.comm, lambda: self._write_end(facts))
        if unwritten and status == "finished":
            status, reason, exit_code = "failed", unwritten, EXIT_SOLVER
        if self.comm.rank == 0:
            for expectation in expectations:
                print(expectation)
            words = [status + (f" {reason}" if status == "stopped" else f": {reason}" if reason else "")]
            words += [f"{len(missed)} of {len(expectations)} expectations MISSED"] if missed else []
            stream = sys.stderr if status == "failed" else sys.stdout
            print(", ".join([*words, f"results in {self.folder}"]), file=stream, flush=True)
        return Outcome(status, reason, exit_code, steps, self.problem.time, self.diagnostics, expectations)

    # ------------------------------------------------------------------ checkpoints

    def _save_if_due(self) -> None:
        every = self.scene.output.checkpoint_every
        late = clock.monotonic() - self.saved_clock > CHECKPOINT_SECONDS
        # rank 0's clock decides, so that all take part in the checkpoint
        if self.comm.bcast(late) or (every and self.counts.step % every == 0):
            self._save()

    def _save(self) -> None:
        """Write a checkpoint of this step, unless there is one."""
        if self.saved_step == self.counts.step:
            return
        with self.checkpoint_event:
            state = self.problem.state()
            geometry = self.problem.geometry()

            def write() -> None:
                series = self.output.series
                facts = {
                    "step": self.counts.step,
                    "time": self.problem.time,
                    "step_size": self.step_size.state(),
                    "iterations": self.counts.iterations,
                    "totals": self.counts.totals,
                    "frame_times": series.times if series is not None else [],
                    "wall": self._wall(),
                    "scene": self.plain_scene,
                }
                checkpoints.save(checkpoints.path_of(self.folder, self.counts.step), state, facts, geometry)

            on_root(self.comm, write)
        self.saved_step = self.counts.step
        self.saved_clock = clock.monotonic()

    def _try_to_save(self) -> str:
        """Save the last good state after a failure or a stop; return what to add to the reason."""
        try:
            # in this order a restart drops the frame, which a run that had gone on would not have
            self._save()
            self.output.frame()
        except OutputError as error:
            return f"; {error}"
        return ""

    def _restore(self, restart: Path, geometry: Any) -> tuple[list[float], list[str]]:
        """Take over a checkpoint; return the times of its frames, and lines about what was found."""
        kept: list[checkpoints.Checkpoint] = []  # the arrays stay on rank 0

        def read() -> tuple[Path, dict[str, Any], list[str]]:
            found, passed_over = checkpoints.newest(restart)
            checkpoints.check_same(found, self.plain_scene, geometry)
            kept.append(found)
            return found.path, found.facts, passed_over

        path, facts, notes = on_root(self.comm, read)
        try:
            self.problem.restore(kept[0].state if kept else {})
        except ValueError as error:
            raise InputError(f"{path}: {error}") from None
        self.problem.time = facts["time"]
        self.step_size.restore(facts["step_size"])
        self.counts.step, self.counts.iterations = facts["step"], facts["iterations"]
        self.counts.totals.update(facts["totals"])
        self.saved_step = self.output.frame_step = facts["step"]
        self.wall_before = facts["wall"]

        def take_over() -> None:
            source = path.parent.parent
            here = source.resolve() == self.folder.resolve()
            results.prepare(self.folder, keep=here)
            if not here:
                results.adopt(source, self.folder, len(facts["frame_times"]))
            for later in checkpoints.list_checkpoints(self.folder):
                if checkpoints.step_of(later) > facts["step"]:
                    later.unlink()

        on_root(self.comm, take_over)
        notes.append(f"restarted from {path}: step {facts['step']}, time {facts['time']:g}")
        return facts["frame_times"], notes

    # ------------------------------------------------------------------ the record

    def _record(self, status: str, reason: str) -> dict[str, Any]:
        """Return what one rank knows about the run (no communication)."""
        return {
            "title": self.scene.title,
            "part": self.scene.part,
            "status": status,
            "reason": reason,
            "size": self.problem.size,
            "steps": self.counts.step,
            "time": self.problem.time,
            "diagnostics": self.diagnostics,
            "solver_iterations": {"total": self.counts.iterations, **self.counts.totals},
            "began": self.began,
            "ended": None if status == "running" else record.now(),
            "wall_seconds": self._wall(),
            "ranks": self.comm.size,
            "effects": self.problem.effects,
            "versions": record.versions(),
            "petsc_options": record.petsc_options(),
            "scene": self.plain_scene,
            "scene_file": None if self.scene_path is None else str(self.scene_path.resolve()),
        }

    def _write_end(self, facts: dict[str, Any]) -> str:
        """Write run.json and draw the summary (rank 0); return what could not be written, and why."""
        try:
            record.write_record(self.folder, facts)
            if self.scene.output.summary:
                drawn_by = SUMMARIES.get(self.scene.part, "summary")
                importlib.import_module(f".{drawn_by}", __package__).draw(self.folder)
        except ImportError as error:
            print(f"{results.SUMMARY} not drawn: {error}")
        except OutputError as error:
            return str(error)
        return ""

    def _write_crash(self, error: Exception) -> None:
        """Record an exception that is perhaps this rank's alone (no communication)."""
        if self.comm.rank == 0 and self.folder.is_dir():
            reason = f"{type(error).__name__}: {error}".splitlines()[0]
            with contextlib.suppress(ExtremalError):
                record.write_record(self.folder, self._record("failed", reason))

    def _wall(self) -> float:
        return self.wall_before + clock.monotonic() - self.begin


class _Ended(Exception):
    """The run ends before its time."""

    def __init__(self, status: str, reason: str, *, state_is_good: bool = True) -> None:
        super().__init__(reason)
        self.status, self.reason, self.state_is_good = status, reason, state_is_good
