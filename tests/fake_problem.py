"""A small problem that obeys the session's protocol: every node of a box of tetrahedra is a damped spring.

Run as a program it makes a results folder: `python fake_problem.py FOLDER [--restart] [--sleep SECONDS] ...`.
"""

from __future__ import annotations

import argparse
import sys
import time as clock
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from mpi4py import MPI
from pydantic import BaseModel, Field

from extremal.app import session
from extremal.app.elastic_scene import Analysis, OutputSettings
from extremal.app.parallel import run_on_all
from extremal.app.scene_common import Expectation


def box_of_tetrahedra(n: int, dimension: int = 3) -> tuple[np.ndarray, np.ndarray, str]:
    """Return points (p, 3), cells and cell type of a unit box cut into simplices, n divisions an edge."""
    axis = np.linspace(0.0, 1.0, n + 1)
    index = np.arange((n + 1) ** dimension).reshape((n + 1,) * dimension)
    if dimension == 2:
        x, y = np.meshgrid(axis, axis, indexing="ij")
        points = np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])
        a, b, c, d = (index[i : i + n, j : j + n].ravel() for i, j in ((0, 0), (1, 0), (1, 1), (0, 1)))
        return points, np.vstack([np.column_stack([a, b, c]), np.column_stack([a, c, d])]), "triangle"
    points = np.column_stack([g.ravel() for g in np.meshgrid(axis, axis, axis, indexing="ij")])
    corner = {
        (i, j, k): index[i : i + n, j : j + n, k : k + n].ravel()
        for i in (0, 1)
        for j in (0, 1)
        for k in (0, 1)
    }
    cells = []
    for path in (
        (0, 1, 2),
        (0, 2, 1),
        (1, 0, 2),
        (1, 2, 0),
        (2, 0, 1),
        (2, 1, 0),
    ):  # the six paths along edges
        at, nodes = [0, 0, 0], [corner[0, 0, 0]]
        for direction in path:
            at[direction] = 1
            nodes.append(corner[at[0], at[1], at[2]])
        if path in ((0, 2, 1), (1, 0, 2), (2, 1, 0)):  # odd permutations turn the cell inside out
            nodes[2], nodes[3] = nodes[3], nodes[2]
        cells.append(np.column_stack(nodes))
    return points, np.vstack(cells), "tetra"


class FakeProblem:
    """Springs u'' = -k u - c u' by the trapezoidal rule, nodes shared among the ranks in blocks.

    Parameters
    ----------
    fails : callable, optional
        Given (time, dt), tells whether a step fails.
    iterations : int
        Solver iterations each step pretends to take.
    sleep : float
        Seconds each iteration takes.
    """

    def __init__(
        self,
        comm: MPI.Comm,
        n: int = 3,
        dimension: int = 3,
        fails: Callable[[float, float], bool] | None = None,
        iterations: int = 3,
        sleep: float = 0.0,
        amplitude: float = 0.3,
        k: float = 40.0,
        c: float = 4.0,
    ) -> None:
        self.comm, self.time = comm, 0.0
        self.effects: dict[str, dict[str, float]] = {"springs": {"stiffness": k}}
        self.on_iteration: Callable[[dict[str, float]], None] | None = None
        self.points, self.cells, self.cell_type = box_of_tetrahedra(n, dimension)
        self.size = dimension * len(self.points)
        self.dimension, self.fails, self.iterations, self.sleep, self.k, self.c = (
            dimension,
            fails,
            iterations,
            sleep,
            k,
            c,
        )
        bounds = np.linspace(0, len(self.points), comm.size + 1).astype(int)
        self.mine = slice(bounds[comm.rank], bounds[comm.rank + 1])
        start = np.random.default_rng(0).uniform(-amplitude, amplitude, self.points.shape)
        start[:, dimension:] = 0
        self.u = start[self.mine]
        self.v = np.zeros_like(self.u)
        self.attempts = 0

    def advance(self, dt: float) -> dict[str, float]:
        self.attempts += 1
        before = self.u, self.v
        # trapezoidal rule: (I - dt/2 A) y1 = (I + dt/2 A) y0 with A = [[0, 1], [-k, -c]]
        A = np.array([[0.0, 1.0], [-self.k, -self.c]])
        step = np.linalg.solve(np.eye(2) - dt / 2 * A, np.eye(2) + dt / 2 * A)
        u1, v1 = step[0, 0] * self.u + step[0, 1] * self.v, step[1, 0] * self.u + step[1, 1] * self.v
        for i in range(1, self.iterations + 1):
            clock.sleep(self.sleep)
            part = i / self.iterations
            self.u, self.v = before[0] + part * (u1 - before[0]), before[1] + part * (v1 - before[1])
            if self.on_iteration is not None:
                self.on_iteration({"iteration": i, "energy": self._energy(), "residual": 10.0 ** (-3 * i)})
        if self.fails is not None and self.fails(self.time, dt):
            self.u, self.v = before
            raise ArithmeticError("the fake solver was told to fail")
        self.u, self.v = u1, v1
        self.time += dt
        return {"newton_iterations": self.iterations, "krylov_iterations": 7 * self.iterations}

    def _energy(self) -> float:
        return float(self.comm.allreduce(0.5 * float(np.sum(self.v**2) + self.k * np.sum(self.u**2))))

    def _gathered(self, values: np.ndarray) -> np.ndarray | None:
        parts = self.comm.gather(values)
        return None if parts is None else np.concatenate(parts)

    def diagnostics(self) -> dict[str, float]:
        J, smallest = stretches(
            self.points, self.cells, np.concatenate(self.comm.allgather(self.u)), self.dimension
        )
        largest = self.comm.allreduce(float(np.max(np.linalg.norm(self.u, axis=1), initial=0)), MPI.MAX)
        return {
            "time": self.time,
            "energy": self._energy(),
            "inverted": float(np.sum(J < 0)),
            "smallest_J": float(J.min()),
            "smallest_stretch": float(smallest.min()),
            "newton_iterations": self.iterations if self.attempts else 0,
            "max_displacement": largest,
        }

    def state(self) -> dict[str, np.ndarray]:
        u, v = self._gathered(self.u), self._gathered(self.v)
        return {} if u is None or v is None else {"displacement": u, "velocity": v}

    def restore(self, state: dict[str, np.ndarray]) -> None:
        state = self.comm.bcast(state)
        self.u, self.v = state["displacement"][self.mine].copy(), state["velocity"][self.mine].copy()

    def geometry(self) -> tuple[np.ndarray, np.ndarray, str] | None:
        return (self.points, self.cells, self.cell_type) if self.comm.rank == 0 else None

    def fields(self, names: Sequence[str] | None = None) -> Any:
        u, v = self._gathered(self.u), self._gathered(self.v)
        if u is None or v is None:
            return None
        J, smallest = stretches(self.points, self.cells, u, self.dimension)
        at_points = {"displacement": u, "velocity": v}
        in_cells = {
            "J": J,
            "smallest_stretch": smallest,
            "inverted": J < 0,
            "region": np.ones(len(J), np.int32),
        }
        wanted = set(names or [*at_points, *in_cells]) | {"displacement"}
        return {n: a for n, a in at_points.items() if n in wanted}, {
            n: a for n, a in in_cells.items() if n in wanted
        }


def stretches(
    points: np.ndarray, cells: np.ndarray, u: np.ndarray, dimension: int
) -> tuple[np.ndarray, np.ndarray]:
    """Return J and the signed smallest stretch of each cell."""
    X, x = points[cells][:, :, :dimension], (points + u)[cells][:, :, :dimension]
    F = np.einsum("cij,cjk->cki", np.linalg.inv(X[:, 1:] - X[:, :1]), x[:, 1:] - x[:, :1])
    J = np.linalg.det(F)
    return J, np.linalg.svd(F, compute_uv=False)[:, -1] * np.where(J < 0, -1.0, 1.0)


class FakeScene(BaseModel):
    """The tables of a scene that the session looks at, as they are in every part."""

    title: str = "springs"
    part: str = "fake"
    stiffness: float = 40.0
    analysis: Analysis = Field(
        default_factory=lambda: Analysis(end_time=1.0, time_step=0.1, largest_step=0.1)
    )
    output: OutputSettings = Field(default_factory=lambda: OutputSettings(summary=False))
    expect: dict[str, Expectation] = Field(default_factory=dict)


def scene(
    analysis: dict[str, Any] | None = None,
    output: dict[str, Any] | None = None,
    expect: dict[str, Any] | None = None,
    **rest: Any,
) -> FakeScene:
    """Return a scene of ten steps of 0.1 s, except for what is given."""
    return FakeScene(
        analysis=Analysis(**({"end_time": 1.0, "time_step": 0.1, "largest_step": 0.1} | (analysis or {}))),
        output=OutputSettings(**({"summary": False} | (output or {}))),
        expect={name: Expectation(**wanted) for name, wanted in (expect or {}).items()},
        **rest,
    )


def main() -> int:
    """Run forty steps, slowly enough to be interrupted; return the exit code."""
    parser = argparse.ArgumentParser()
    parser.add_argument("folder")
    parser.add_argument("--restart", action="store_true")
    parser.add_argument("--sleep", type=float, default=0.002)
    parser.add_argument("--n", type=int, default=3)
    options = parser.parse_args()
    settings = scene(analysis={"time_step": 0.025, "largest_step": 0.025}, output={"checkpoint_every": 4})
    problem = FakeProblem(MPI.COMM_WORLD, n=options.n, sleep=options.sleep)
    restart = options.folder if options.restart else None
    return run_on_all(
        MPI.COMM_WORLD, lambda: session.run(problem, settings, options.folder, restart=restart).exit_code
    )


if __name__ == "__main__":
    sys.exit(main())
