"""What a session writes as it runs: history of the steps and iterations, frames of the fields."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .parallel import on_root
from .problem import Problem
from .progress import Progress
from .results import HISTORY, ITERATIONS, SOLID, Frames, OutputError, Series, Table, write_columns

if TYPE_CHECKING:
    from numpy.typing import NDArray


@dataclass
class Counts:
    """How far a run has come.

    Attributes
    ----------
    step : int
        Steps made.
    iterations : int
        Solver iterations of all steps, failed attempts included.
    totals : dict
        Sums over the steps of the solver's figures which count iterations.
    """

    step: int = 0
    iterations: int = 0
    totals: dict[str, float] = field(default_factory=dict)

    def add(self, figures: Mapping[str, float], seen: int) -> None:
        """Count a finished step with the solver's `figures`, of whose iterations `seen` have been counted."""
        self.step += 1
        if not seen:  # a problem that does not call back tells its iterations afterwards
            self.iterations += int(figures.get("newton_iterations", figures.get("krylov_iterations", 0)))
        for name, figure in figures.items():
            if name.endswith("_iterations"):
                self.totals[name] = self.totals.get(name, 0) + figure


class Output:
    """The tables and the series of a run; methods are collective unless said otherwise.

    Parameters
    ----------
    settings : pydantic model
        The scene's `[output]`.
    """

    def __init__(self, problem: Problem, settings: Any, folder: Path, counts: Counts) -> None:
        from petsc4py import PETSc

        self.problem, self.settings, self.folder, self.counts = problem, settings, folder, counts
        self.comm = problem.comm
        self.event = PETSc.Log.Event("session:output")
        self.series: Frames | None = None
        self.solid_series: Series | None = None
        self.progress: Progress | None = None
        self.every = getattr(settings, "iterations", None)
        self.has_fields = self.has_particles = False
        self.frame_step = -1
        self.postponed: OutputError | None = None  # rank 0's, until the ranks can agree on it

    def open(
        self,
        geometry: tuple[NDArray[Any], NDArray[Any], str] | None,
        frame_times: list[float],
        progress: Progress | None,
    ) -> None:
        """Go on with the tables and frames in the folder, less what came after the current step."""
        self.has_particles = hasattr(self.problem, "particle_fields")
        self.has_fields = self.comm.bcast(geometry is not None) or self.has_particles
        solid = getattr(self.problem, "solid", None)
        shape = None if solid is None else solid.geometry()

        def go_on() -> None:
            self.history = Table(self.folder / HISTORY)
            self.iterations = Table(self.folder / ITERATIONS)
            for table in (self.history, self.iterations):
                table.keep(lambda row: row["step"] <= self.counts.step)
            if geometry is not None:
                self.series = Series(self.folder, geometry, frame_times)
            elif self.has_particles:
                from .particles_output import ParticleFrames

                h = self.problem.h if self.settings.vdb else None  # type: ignore[attr-defined]
                self.series = ParticleFrames(self.folder, frame_times, h)
            if shape is not None:
                self.solid_series = Series(self.folder / SOLID, shape, frame_times)

        on_root(self.comm, go_on)
        self.progress = progress
        self.problem.on_iteration = self.iteration

    def row(self, dt: float, cutbacks: int, wall: float, diagnostics: Mapping[str, float]) -> None:
        """Add a row to history.csv and tell about the step."""
        step, time = self.counts.step, self.problem.time
        facts = {"step": step, "time": time, "dt": dt, "cutbacks": cutbacks, "wall": round(wall, 3)}
        with self.event:
            on_root(self.comm, lambda: self.history.append({**facts, **diagnostics}))
        if self.progress is not None and step > 0:
            self.progress.step(step, time, dt, diagnostics, wall)

    def frame(self) -> None:
        """Write a frame of the fields, unless there is one of this step."""
        if self.has_fields and self.frame_step != self.counts.step:
            with self.event:
                write = self._gather_frame()
                on_root(self.comm, write)
            self.frame_step = self.counts.step

    def tables(self) -> None:
        """Write the tables of the result, of a problem that has some."""
        if hasattr(self.problem, "tables"):
            with self.event:
                found = self.problem.tables()

                def write() -> None:
                    for name, columns in found.items():
                        write_columns(self.folder / name, columns)

                on_root(self.comm, write)

    def iteration(self, figures: dict[str, float]) -> None:
        """Note an iteration of the solver.

        Called inside `advance`, where the ranks cannot agree on a failure to write: it is kept for `agree`.
        """
        if figures.get("iteration", 1) > 0:
            self.counts.iterations += 1
        if self.comm.rank == 0:
            row = {"step": self.counts.step + 1, "total": self.counts.iterations, **figures}
            self._postpone(lambda: self.iterations.append(row))
            if self.progress is not None:
                self.progress.iteration(figures)
        counted = figures.get("iteration", 1) > 0
        if self.has_fields and self.every and counted and self.counts.iterations % self.every == 0:
            with self.event:
                write = self._gather_frame()
                if self.comm.rank == 0:
                    self._postpone(write)

    def agree(self) -> None:
        """Raise on all ranks the OutputError that rank 0 has kept, if any."""

        def tell() -> None:
            if self.postponed is not None:
                raise self.postponed

        on_root(self.comm, tell)

    def note(self, text: str) -> None:
        """Say a line (rank 0 only has a progress to say it with)."""
        if self.progress is not None:
            self.progress.note(text)

    def close(self) -> None:
        """Leave problem and terminal as they were (not collective)."""
        self.problem.on_iteration = None
        if self.progress is not None:
            self.progress.close()

    def _gather_frame(self) -> Callable[[], None]:
        """Return what rank 0 must do to write a frame of the fields as they are now."""
        # among frames of solver iterations, the count of iterations is the only clock that moves
        time = float(self.counts.iterations) if self.every else self.problem.time
        if self.has_particles:
            return self._gather_particles(time)
        fields = self.problem.fields(self.settings.fields)

        def write() -> None:
            assert isinstance(self.series, Series) and fields is not None
            self.series.write(time, *fields)

        return write

    def _gather_particles(self, time: float) -> Callable[[], None]:
        particles = self.problem.particle_fields(self.settings.fields)  # type: ignore[attr-defined]
        mass = self.problem.state().get("mass") if self.settings.vdb else None
        solid = getattr(self.problem, "solid", None)
        body = None if solid is None else solid.fields()

        def write() -> None:
            from .particles_output import ParticleFrames

            assert isinstance(self.series, ParticleFrames)
            self.series.write(time, particles, mass)
            if self.solid_series is not None and body is not None:
                self.solid_series.write(time, *body)

        return write

    def _postpone(self, write: Callable[[], None]) -> None:
        if self.postponed is not None:
            return
        try:
            write()
        except OutputError as error:
            self.postponed = error
