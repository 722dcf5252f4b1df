"""Snow and an elastic body that push each other, as one problem for the session."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray
from petsc4py import PETSc

from extremal.forms import ElasticProblem, StepFailure
from extremal.forms.moving_surface import MovingSurface
from extremal.mpm.exchange import Exchange
from extremal.mpm.problem import SnowProblem
from extremal.obstacles.colliders import Contact
from extremal.obstacles.facets import Facets

from . import elastic
from .errors import InputError

if TYPE_CHECKING:
    from .snow_scene import SnowScene
    from .solid_scene import Solid

# of the body's diagnostics those that the history of the coupled problem has
SHOWN = (
    "energy", "elastic_energy", "kinetic_energy", "inverted", "smallest_J", "max_displacement", "newton_iterations",
    "smallest_gap", "contact_force", "intersections",
)  # fmt: skip

GROWTH = 1.2  # of the step, at most, after one that the body could not make


class CoupledProblem:
    """Snow and a body, in steps of the same length: the body's, without snow; the snow's, which collides with the body
    where it is then; and the body is given the impulses of these collisions, within the step it has made.

    Parameters
    ----------
    snow : SnowProblem
    solid : ElasticProblem
        Dynamic, of first degree, by backward Euler or the midpoint rule.
    contact : Contact
        Friction and stickiness of the body for snow.
    gravity : sequence of float or None
        Of the snow [m/s²].
    """

    def __init__(
        self, snow: SnowProblem, solid: ElasticProblem, contact: Contact, gravity: Sequence[float] | None = None
    ) -> None:
        self.comm, self.h, self.snow, self.solid = snow.comm, snow.h, snow, solid
        self.on_iteration: Callable[[dict[str, float]], None] | None = None
        self.surface = MovingSurface(solid)
        self._exchange = Exchange(self.comm, contact)
        snow.exchange = self._exchange
        self._event = PETSc.Log.Event("snow:solid:step")
        facts = {"unknowns": solid.size, "facets": len(self.surface.facets)}
        self.effects: dict[str, dict[str, Any]] = {**snow.effects, "solid": facts}
        self.size = snow.size + solid.size
        d = solid.space.dimension
        self._given = np.zeros(d)  # impulse of the snow on the body [N s]
        self._outside = np.zeros(d)  # on snow, of all but the body
        self._passed = 0.0  # sum of the sizes of the steps' impulses
        self._longest = np.inf  # step that the body is thought to manage [s]
        mass = self.comm.allreduce(float(snow.particles.mass.sum()))
        self._weight = mass * np.array(gravity or (0.0,) * d)  # [N]
        self._start = self._momentum()

    @property
    def time(self) -> float:
        """[s]"""
        return self.snow.time

    @time.setter
    def time(self, value: float) -> None:
        self.snow.time = self.solid.time = value

    def advance(self, dt: float) -> dict[str, float]:
        """One step of both; raises ArithmeticError on all ranks, with the states as before."""
        kept = self.surface.keep()
        try:
            with self._event:
                self._move_solid(dt)
                surface = Facets(self.surface.positions(), self.surface.facets, self.surface.cells)
                self._exchange.place(surface, self.surface.velocities(), self.surface.mass, self.surface.mobility)
            figures = self.snow.advance(dt)
        except ArithmeticError:
            self.surface.put_back(kept)
            raise
        self.surface.push(self._exchange.impulse)
        given = self._exchange.impulse.sum(axis=0)
        self._given += given
        self._passed += float(np.linalg.norm(given))
        self._outside += self.comm.allreduce(self._exchange.outside) + dt * self._weight
        self._longest = max(self._longest, GROWTH * dt)
        return figures | {"wanted_step": min(figures["wanted_step"], self._longest)}

    def _move_solid(self, dt: float) -> None:
        try:
            self.solid.advance(dt)
        except StepFailure as failure:
            self._longest = dt / 2
            raise StepFailure(f"solid: {failure}", self._longest) from failure

    def _momentum(self) -> NDArray:
        """Of snow and body (d,) [N s] (collective)."""
        p = self.snow.particles
        return self.comm.allreduce(p.mass @ p.velocity) + self.surface.momentum()

    def diagnostics(self) -> dict[str, float]:
        """Those of the snow, some of the body, the impulse on it [N s], and what is amiss in the sum of momenta.

        `momentum_error` is the size of P(t) - P(0) - (impulses of gravity, obstacles, and of what holds the body)
        relative to the sum of the impulses between snow and body; to m v of all particles where that is larger.
        """
        snow = self.snow.diagnostics()
        body = {name: value for name, value in self.solid.diagnostics().items() if name in SHOWN}
        found = {f"solid_{name}": value for name, value in body.items()}
        now, own = self._momentum(), self.surface.momentum()
        found["contact_sweeps"] = float(self._exchange.sweeps)
        found |= {f"solid_momentum_{axis}": float(c) for axis, c in zip("xyz", own)}
        found |= {f"solid_impulse_{axis}": float(c) for axis, c in zip("xyz", self._given)}
        error = now - self._start - self._outside - self.surface.outside
        size = max(self._passed, float(np.linalg.norm(now)), float(np.linalg.norm(self._start)))
        found["momentum_error"] = float(np.linalg.norm(error)) / size if size > 0 else 0.0
        return snow | found | {"total_energy": snow["energy"] + body["energy"]}

    def state(self) -> dict[str, NDArray]:
        """All that a restart needs, on rank 0 in an order that does not depend on the ranks; {} elsewhere."""
        snow, body = self.snow.state(), self.solid.state()
        if self.comm.rank > 0:
            return {}
        sums = np.stack([self._given, self._outside, self._start, self.surface.outside])
        account = {"solid sums": sums, "solid scalars": np.array([self._passed, 1 / self._longest])}
        return snow | {f"solid {name}": values for name, values in body.items()} | account

    def restore(self, state: dict[str, NDArray]) -> None:
        """Take over what `state` gave, on any number of ranks; raises ValueError on all where it gave too little."""
        if not self.comm.bcast(all(f"solid {name}" in state for name in ("u", "v", "sums", "scalars"))):
            raise ValueError("has no solid; accepted is a checkpoint of the same scene")
        self.snow.restore(state)
        own = {name.removeprefix("solid "): values for name, values in state.items() if name.startswith("solid ")}
        sums, scalars = self.comm.bcast((own.pop("sums", None), own.pop("scalars", None)))
        self.solid.restore(own)
        self._given, self._outside, self._start, self.surface.outside = sums
        self._passed, self._longest = float(scalars[0]), float(1 / scalars[1]) if scalars[1] else np.inf

    def geometry(self) -> None:
        """Particles have no mesh; that of the body is `solid.geometry`."""
        return None

    def fields(self, names: Sequence[str] | None = None) -> None:
        """See `particle_fields` and `solid.fields`."""
        return None

    def particle_fields(self, names: Sequence[str] | None = None) -> dict[str, NDArray] | None:
        """Those of the snow."""
        return self.snow.particle_fields(names)


def build(scene: SnowScene, solid: Solid, snow: SnowProblem, comm: MPI.Comm) -> CoupledProblem:
    """The problem of a scene with [solid], at its start (collective).

    Raises
    ------
    InputError
        On all ranks, where mesh, names or values do not fit together.
    """
    name = str(scene.path or "scene")
    try:
        body = elastic.build(solid.elastic(scene), comm)
    except InputError as error:
        raise InputError(*(line.replace(f"{name}: [", f"{name}: [solid] [", 1) for line in error.messages)) from None
    if body.space.dimension != scene.dimension:
        raise InputError(
            f"{name}: [solid] mesh: is {body.space.dimension}-dimensional; "
            f"must be {scene.dimension}-dimensional, as the grid"
        )
    gravity = None if scene.gravity is None else scene.gravity.acceleration
    return CoupledProblem(snow, body, Contact(solid.friction, solid.sticky), gravity)
