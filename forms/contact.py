"""Contact of an elastic body with obstacles: a barrier on the nodes of its surface, and lagged friction."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import ufl
from mpi4py import MPI
from numpy.typing import NDArray
from petsc4py import PETSc

from extremal.obstacles.colliders import Collider

from . import compat
from .barrier import barrier, slip
from .contacts import FOLLOWED, REACH, STILL, mean_edge
from .equations import event
from .laws import LawError
from .newton import StepFailure
from .space import Space

GRAZING = 100  # points looked at on a node's way along an obstacle: a longer way is refused
CURVED = 1e-3  # of d̂: half the way over which normals are compared
ATTEMPTS = 50  # pushes of nodes out of an obstacle that has come to them


@dataclass
class _Touch:
    """What friction at an obstacle remembers: normal forces λ [N], normals, where the touched places have gone [m]."""

    force: NDArray
    normal: NDArray
    anchor: NDArray


class Contact:
    """Obstacles φ_j(x, t) > 0 for all surface nodes x_i = X_i + u_i, by the energy

        κ Σ_ij A_i b(φ_j(x_i)) + Σ_ij μ_j λ_ij f(|u_ij|)

    with the barrier b and the smooth friction f of `barrier`, the part A_i of the surface of node i, κ = c E/d̂,
    λ = κ A |b'| of the last solve, and u the slip tangential to the obstacle since the beginning of the step.

    The Hessian is κ A (b'' n nᵀ + b' ∇²φ); the projected one lacks the obstacle's curvature ∇²φ and is so positive
    semi-definite. Nodes of which all components are prescribed have no contact.

    Parameters
    ----------
    space : Space
    obstacles : sequence of Collider
    held : (n,) int
        Degrees of freedom with prescribed displacement.
    young_modulus : float
        E [Pa].
    distance : float or None
        d̂ [m]; None: a tenth of the mean edge of cells.
    stiffness : float
        c [1].
    """

    def __init__(
        self,
        space: Space,
        obstacles: Sequence[Collider],
        held: NDArray,
        young_modulus: float,
        *,
        distance: float | None = None,
        stiffness: float = 1.0,
    ) -> None:
        self._space, self._comm, self._obstacles, d = space, space.comm, list(obstacles), space.dimension
        self._cell = mean_edge(space)
        self.reach = REACH * self._cell if distance is None else distance
        self.stiffness = stiffness * young_modulus / self.reach
        self._time = 0.0
        self._event = event("contact")
        areas = _areas(space)
        self._free = space.free(held)[: len(areas)]
        self._nodes = np.flatnonzero((areas > 0) & self._free.any(axis=1))
        self._free, self._areas = self._free[self._nodes], areas[self._nodes]
        self._dofs = (self._nodes[:, None] * d + np.arange(d)).astype(np.int32)
        self._origin: NDArray | None = None
        self._known: list[tuple[float, NDArray, list[NDArray]]] = []
        self._touches: list[_Touch] | None = None
        self.has_friction = any(o.contact.friction > 0 or o.contact.sticky for o in self._obstacles)

    # ------------------------------------------------------------------ what the equations ask

    def energy(self) -> float:
        """Energy at the displacement of the space [J]; infinite where a node has crossed an obstacle."""
        with self._event:
            x = self._places()
            if self._crossed(x):
                return np.inf
            total = 0.0
            for j, phi in enumerate(self._distances(x)):
                near = phi < self.reach
                total += self.stiffness * float(self._areas[near] @ barrier(phi[near], self.reach)[0])
                total += self._friction(j, x)[0]
            return self._comm.allreduce(total)

    def add_force(self, out: PETSc.Vec) -> None:
        """out += gradient of `energy`; not a number where a node has crossed an obstacle."""
        with self._event:
            x = self._places()
            if self._crossed(x):
                out.array[:] = np.nan
                return
            for j in range(len(self._obstacles)):
                out.array[self._dofs] += self._gradient(j, x)

    def add_tangent(self, matrix: PETSc.Mat, projected: bool) -> None:
        """matrix += Hessian, or what is left of it; a search along a line from here may not cross an obstacle."""
        with self._event:
            x = self._places()
            self._origin = x
            blocks = np.zeros((len(x), x.shape[1], x.shape[1]))
            for j, phi in enumerate(self._distances(x)):
                near = np.flatnonzero(phi < self.reach)
                first, second = self.stiffness * self._areas[near] * barrier(phi[near], self.reach)[1:]
                n = self._obstacles[j].normal(x[near], self._time)
                blocks[near] += second[:, None, None] * n[:, :, None] * n[:, None, :]
                if not projected:
                    blocks[near] += first[:, None, None] * self._curvature(j, x[near])
                blocks += self._friction(j, x)[2]
            blocks *= self._free[:, :, None] & self._free[:, None, :]
            some = np.flatnonzero(np.abs(blocks).max(axis=(1, 2), initial=0) > 0)
            matrix.assemble(PETSc.Mat.AssemblyType.FLUSH)  # ones on the diagonal were inserted, these are added
            if not len(some):  # petsc4py divides by the number of blocks
                return
            dofs = self._dofs[some]
            values = blocks[some].reshape(len(some), dofs.shape[1] ** 2)
            matrix.setValuesLocalRCV(dofs, dofs, values, addv=PETSc.InsertMode.ADD)

    def _gradient(self, j: int, x: NDArray) -> NDArray:
        phi = self._distances(x)[j]
        near = np.flatnonzero(phi < self.reach)
        out = self._friction(j, x)[1]
        first = self.stiffness * self._areas[near] * barrier(phi[near], self.reach)[1]
        out[near] += first[:, None] * self._obstacles[j].normal(x[near], self._time)
        return out

    def _friction(self, j: int, x: NDArray) -> tuple[float, NDArray, NDArray]:
        """Energy, gradients (n, d) and Hessians (n, d, d) of friction at obstacle j."""
        d, how = x.shape[1], self._obstacles[j].contact
        force, stiff = np.zeros_like(x), np.zeros((len(x), d, d))
        if self._touches is None or not (how.friction > 0 or how.sticky):
            return 0.0, force, stiff
        touch = self._touches[j]
        on = np.flatnonzero(touch.force > 0)
        n = touch.normal[on]
        way = x[on] - touch.anchor[on]
        way -= np.einsum("ni,ni->n", way, n)[:, None] * n
        plane = np.eye(d) - n[:, :, None] * n[:, None, :]
        if how.sticky:
            weight = self.stiffness * self._areas[on]
            force[on], stiff[on] = weight[:, None] * way, weight[:, None, None] * plane
            return 0.5 * float(weight @ np.einsum("ni,ni->n", way, way)), force, stiff
        weight, size = how.friction * touch.force[on], np.linalg.norm(way, axis=1)
        f, over, second = slip(size, STILL * self.reach)
        along = way / np.where(size > 0, size, 1.0)[:, None]
        force[on] = (weight * over)[:, None] * way
        both = along[:, :, None] * along[:, None, :]
        stiff[on] = weight[:, None, None] * (over[:, None, None] * plane + (second - over)[:, None, None] * both)
        return float(weight @ f), force, stiff

    def _places(self) -> NDArray:
        """Where the nodes are, (n, d) [m]."""
        return self._space.positions[self._nodes] + self._space.u.x.array[self._dofs]

    def _distances(self, x: NDArray) -> list[NDArray]:
        """φ (n,) [m] of each obstacle now, as `_far_or_near` says; a search asks again for where it began and is."""
        for i, (time, places, found) in enumerate(self._known):
            if time == self._time and np.array_equal(places, x):
                self._known.insert(0, self._known.pop(i))
                return found
        found = [self._far_or_near(obstacle, x, self._time) for obstacle in self._obstacles]
        self._known = [(self._time, x.copy(), found), *self._known[:1]]
        return found

    def _far_or_near(self, obstacle: Collider, x: NDArray, time: float) -> NDArray:
        """φ (n,) [m] where it may be below d̂; elsewhere the distance from what encloses the obstacle, d̂ or more."""
        low, high = obstacle.bounds(time)
        phi = np.linalg.norm(np.maximum(np.maximum(low - x, x - high), 0.0), axis=1)
        near = np.flatnonzero(~(phi >= self.reach))
        phi[near] = obstacle.distance(x[near], time)
        return phi

    def _curvature(self, j: int, x: NDArray) -> NDArray:
        """∇²φ (n, d, d) [1/m], by differences of normals."""
        step, normal = CURVED * self.reach, self._obstacles[j].normal
        ways = step * np.eye(x.shape[1])
        rises = [(normal(x + way, self._time) - normal(x - way, self._time)) / (2 * step) for way in ways]
        found = np.stack(rises, axis=1)
        return (found + found.swapaxes(1, 2)) / 2

    def _crossed(self, x: NDArray) -> bool:
        """Whether a node met an obstacle on its straight way from where the search began (collective)."""
        origin = x if self._origin is None else self._origin
        found = zip(self._obstacles, self._distances(origin), self._distances(x))
        met = not np.isfinite(x).all() or any(self._meets(each, origin, x, *phi) for each, *phi in found)
        return self._comm.allreduce(met, op=MPI.LOR)

    def _meets(self, obstacle: Collider, start: NDArray, end: NDArray, first: NDArray, last: NDArray) -> bool:
        """Whether φ <= 0 somewhere between, where it is `first` and `last`; since |∇φ| <= 1, steps as long as φ do."""
        if (first <= 0).any() or (last <= 0).any():
            return True
        way = end - start
        size = np.linalg.norm(way, axis=1)
        on = np.flatnonzero(first + last <= size)
        phi, done = first[on], np.zeros(len(on))
        for _ in range(GRAZING):
            done += np.maximum(phi, self.reach / 4)
            going = done < size[on]
            on, done = on[going], done[going]
            if not len(on):
                return False
            phi = obstacle.distance(start[on] + (done / size[on])[:, None] * way[on], self._time)
            if (phi <= 0).any():
                return True
        return True

    # ------------------------------------------------------------------ a step

    def set_time(self, time: float) -> None:
        """Put the obstacles where they are at `time` [s]."""
        self._time = time

    def search_from(self, u: NDArray) -> None:
        """Searches begin at displacement `u` (local values)."""
        self._origin = self._space.positions[self._nodes] + u[self._dofs]

    def begin(self, u: NDArray, start: float, time: float) -> NDArray:
        """Begin a step from displacement `u` (local values) at `start` [s] to obstacles at `time` [s].

        Nodes which an obstacle has come closer to than half their former distance are pushed out of its way.

        Returns
        -------
        (local nodes * d,)
            The displacement with those nodes moved.

        Raises
        ------
        StepFailure
            On all ranks, where a node would have to move by more than a cell, or an obstacle has passed over it.
        """
        self.search_from(u)
        x = self._origin
        assert x is not None
        gaps = [self._far_or_near(obstacle, x, start) for obstacle in self._obstacles]
        self._time, self._touches = time, None
        anchors = [obstacle.carry(x, start, time) for obstacle in self._obstacles]
        moved = x.copy()
        for _ in range(ATTEMPTS):
            late = False
            for obstacle, gap in zip(self._obstacles, gaps):
                wanted, phi = np.minimum(gap, self.reach), self._far_or_near(obstacle, moved, time)
                on = np.flatnonzero(phi < wanted / 2)
                push = (wanted - phi)[on, None] * obstacle.normal(moved[on], time)
                moved[on] += np.where(self._free[on], push, 0.0)
                late = late or len(on) > 0
            if not late:
                break
        far = np.linalg.norm(moved - x, axis=1).max(initial=0) > self._cell
        passed = any(
            self._meets(obstacle, anchor, moved, self._far_or_near(obstacle, anchor, time), phi)
            for obstacle, anchor, phi in zip(self._obstacles, anchors, self._distances(moved))
        )
        if self._comm.allreduce(late or far or passed, op=MPI.LOR):
            raise StepFailure("an obstacle comes too far into the body in one step")
        out = self._space.u
        out.x.array[:] = u
        out.x.array[self._dofs] = moved - self._space.positions[self._nodes]
        compat.vector_of(out).ghostUpdate(addv=PETSc.InsertMode.INSERT, mode=PETSc.ScatterMode.FORWARD)
        if self.has_friction:
            none = np.zeros(len(x))
            self._touches = [_Touch(none, np.zeros_like(x), anchor) for anchor in anchors]
            self._origin = moved
            self.follow()
        return out.x.array.copy()

    def follow(self) -> bool:
        """Take normal forces at the displacement of the space into friction; whether they are hardly new."""
        if self._touches is None:
            return True
        change, size, x = 0.0, 0.0, self._places()
        for obstacle, touch, phi in zip(self._obstacles, self._touches, self._distances(x)):
            force = -self.stiffness * self._areas * barrier(phi, self.reach)[1]
            change += float(np.abs(force - touch.force).sum())
            size += float(force.sum())
            on = np.flatnonzero(force > 0)
            touch.force, touch.normal = force, np.zeros_like(x)
            touch.normal[on] = obstacle.normal(x[on], self._time)
        change, size = self._comm.allreduce(change), self._comm.allreduce(size)
        return change <= FOLLOWED * size

    def fits(self, u: NDArray) -> bool:
        """Whether no node is inside an obstacle at displacement `u` (local values; collective)."""
        return self.clear(u, self._time)

    def clear(self, u: NDArray, time: float) -> bool:
        """Whether no node is inside an obstacle at displacement `u` (local values) and `time` [s] (collective)."""
        x = self._space.positions[self._nodes] + u[self._dofs]
        inside = any((obstacle.distance(x, time) <= 0).any() for obstacle in self._obstacles)
        return not self._comm.allreduce(inside, op=MPI.LOR)

    @property
    def at_rest(self) -> bool:
        """Whether no obstacle ever moves."""
        return all(getattr(obstacle, "motion", obstacle) is None for obstacle in self._obstacles)

    # ------------------------------------------------------------------ its start and its figures

    def check(self, u: NDArray) -> None:
        """Refuse a start with nodes inside of obstacles.

        Raises
        ------
        LawError
            On all ranks, naming the first such node and its obstacle.
        """
        x, worst = self._space.positions[self._nodes] + u[self._dofs], []
        for j, obstacle in enumerate(self._obstacles):
            phi = obstacle.distance(x, self._time)
            inside = np.flatnonzero(phi <= 0)
            numbers = self._space.nodes[self._nodes[inside]]
            worst += [(int(k), j, float(phi[i]), tuple(x[i])) for k, i in zip(numbers, inside)][:1000]
        found = [part for part in self._comm.allgather(min(worst, default=None)) if part is not None]
        if found:
            node, j, phi_there, place = min(found)
            words = ", ".join(f"{c:.4g}" for c in place)
            raise LawError(
                f"[[collider]] #{j + 1}: surface node {node} at ({words}) m is not outside, by {abs(phi_there):.3g} m; "
                'leave a gap, or let contact begin later by [contact] after = "untangled"'
            )

    def diagnostics(self, u: NDArray, time: float, active: bool) -> dict[str, float]:
        """Smallest distance [m] and contact force [N], the sum over obstacles of the size of each one's resultant.

        Nodes inside an obstacle, before contact has begun, have negative distances and no force.
        """
        self._time, before = time, self._time
        x = self._space.positions[self._nodes] + u[self._dofs]
        gap, force = np.inf, 0.0
        for j, obstacle in enumerate(self._obstacles):
            gap = min(gap, float(obstacle.distance(x, time).min(initial=np.inf)))
            total = self._gradient(j, x).sum(axis=0) if active else np.zeros(x.shape[1])
            force += float(np.linalg.norm(self._comm.allreduce(total)))
        self._time = before
        return {"smallest_gap": self._comm.allreduce(gap, op=MPI.MIN), "contact_force": force}

    def barrier_energy(self, u: NDArray, time: float) -> float:
        """κ Σ A b(φ) [J], what contact can give back."""
        x, total = self._space.positions[self._nodes] + u[self._dofs], 0.0
        for obstacle in self._obstacles:
            phi = obstacle.distance(x, time)
            total += self.stiffness * float(self._areas @ barrier(phi, self.reach)[0])
        return self._comm.allreduce(total)


def _areas(space: Space) -> NDArray[Any]:
    """Part of the surface of each owned node [m^(d-1)], 0 inside; positive also at corners of second degree.

    Parts are those of the diagonal of the surface's mass matrix.
    """
    d = space.dimension
    v, w = ufl.TestFunction(space.vectors), ufl.TrialFunction(space.vectors)
    ds = ufl.Measure("ds", domain=space.mesh, metadata={"quadrature_degree": 2 * space.degree})
    form = compat.form(ufl.inner(v, w) * ds)
    mass = compat.matrix(form)
    compat.add_matrix(mass, form, [])
    mass.assemble()
    diagonal = mass.getDiagonal()
    parts = diagonal.array[::d].copy()
    ones = mass.createVecRight()
    ones.set(1.0)
    area = ones.dot(mass * ones) / d
    for used in (mass, diagonal, ones):
        used.destroy()
    total = space.comm.allreduce(float(parts.sum()))
    return parts * (area / total)
