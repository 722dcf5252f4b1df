"""Contact of a body with itself, or of several bodies: a barrier between all parts of the surface, lagged friction."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from petsc4py import PETSc
from scipy import sparse

from .contacts import FOLLOWED, REACH, STILL, mean_edge
from .equations import event
from .laws import LawError
from .proximity import Proximity
from .space import Space
from .surface import Surface


class SelfContact:
    """No two parts of the surface meet, by the energy

        κ Σ_k A_k b(d_k(x)) + Σ_k μ λ_k f(|u_k|)

    over the pairs k of `Proximity`, with the barrier b of Li et al., *Incremental Potential Contact* (2020), in its
    convergent form (Li et al. 2023): A_k is a part of the surface, so that b' κ is a pressure. λ_k is the force of
    the last solve, u_k the slip since the beginning of the step, f as for obstacles. Energies and derivatives are
    ipctk's. Displacements are local values; all methods are collective.

    Parameters
    ----------
    space : Space
    held : (n,) int
        Degrees of freedom with prescribed displacement.
    young_modulus : float
        E [Pa].
    distance : float or None
        d̂ [m]; None: a tenth of the mean edge of cells, or half the smallest distance of two parts of one body at
        rest where that is less.
    stiffness : float
        c in κ = c E [1].
    friction : float
        μ [1].

    Raises
    ------
    LawError
        Without ipctk.
    """

    at_rest = True

    def __init__(
        self,
        space: Space,
        held: NDArray,
        young_modulus: float,
        *,
        distance: float | None = None,
        stiffness: float = 1.0,
        friction: float = 0.0,
    ) -> None:
        self._space, self._comm, self._event = space, space.comm, event("self_contact")
        self._surface = Surface(space, held)
        self._near = Proximity(space.comm, self._surface, distance, REACH * mean_edge(space))
        self._mesh, ipctk = self._near.mesh, self._near.library
        self._barrier = ipctk.BarrierPotential(self._near.reach, stiffness * young_modulus, True)
        self._friction, self._slip = friction, ipctk.FrictionPotential(STILL * self._near.reach)
        self._touches: Any = None
        self._anchor = self._normal_force = np.zeros(0)

    @property
    def reach(self) -> float:
        """d̂ [m]"""
        return self._near.reach

    # ------------------------------------------------------------------ what the equations ask

    def energy(self) -> float:
        """Energy at the displacement of the space [J]; infinite where parts have met since the search began."""
        with self._event:
            x = self._places()
            if self._near.crossed(x):
                return np.inf
            total = self._barrier(self._near.close(x), self._mesh, x)
            if self._touches is not None:
                total += self._slip(self._touches, self._mesh, self._since(x))
            return self._comm.allreduce(float(total))

    def add_force(self, out: PETSc.Vec) -> None:
        """out += gradient of `energy`; not a number where that is infinite."""
        with self._event:
            x = self._places()
            if self._near.crossed(x):
                out.array[:] = np.nan
                return
            self._surface.add(self._gradient(x), out)

    def add_tangent(self, matrix: PETSc.Mat, projected: bool) -> None:
        """A search along a line begins here; the Hessian does not fit a pattern of cells: see `coupling`."""
        with self._event:
            self._near.search_from(self._places())

    def coupling(self, projected: bool) -> sparse.csr_array:
        """Hessian in the rows that this rank owns, without prescribed ones, (owned, all).

        Parameters
        ----------
        projected : bool
            Positive semi-definite, pair by pair.
        """
        with self._event:
            hessian = self._hessian(self._places(), projected).tocoo()
            free = self._surface.free[hessian.row] & self._surface.free[hessian.col]
            rows, columns = (self._surface.dofs[part[free]] for part in (hessian.row, hessian.col))
            return self._distributed(rows, columns, hessian.data[free])

    def add_linear(self, change: NDArray, out: PETSc.Vec) -> None:
        """out += positive semi-definite Hessian at the displacement searched from, times `change`."""
        with self._event:
            moved = self._surface.gather(change).ravel()
            self._surface.add(self._sum(self._hessian(self._near.origin, True) @ moved), out)

    def _places(self) -> NDArray:
        """Where the nodes of the surface are, (n, d) [m]."""
        return self._placed(self._space.u.x.array)

    def _placed(self, u: NDArray) -> NDArray:
        return self._surface.rest + self._surface.gather(u)

    def _since(self, x: NDArray) -> NDArray:
        """Displacement since the beginning of the step [m]."""
        return np.asfortranarray(x - self._anchor)

    def _gradient(self, x: NDArray) -> NDArray:
        """Gradient of all pairs, (n * d,) [N]."""
        total = self._barrier.gradient(self._near.close(x), self._mesh, x)
        if self._touches is not None:
            total = total + self._slip.gradient(self._touches, self._mesh, self._since(x))
        return self._sum(total)

    def _hessian(self, x: NDArray, projected: bool) -> Any:
        """Hessian of this rank's share of the pairs, (n * d, n * d) sparse."""
        methods = self._near.library.PSDProjectionMethod
        how = methods.CLAMP if projected else methods.NONE
        total = self._barrier.hessian(self._near.close(x), self._mesh, x, how)
        if self._touches is not None:
            total = total + self._slip.hessian(self._touches, self._mesh, self._since(x), how)
        return total

    def _sum(self, values: NDArray) -> NDArray:
        out = np.empty_like(values)
        self._comm.Allreduce(np.ascontiguousarray(values), out)
        return out

    def _distributed(self, rows: NDArray, columns: NDArray, values: NDArray) -> sparse.csr_array:
        """The sum of all ranks' entries, by rows to those who own them."""
        index_map, d = self._space.vectors.dofmap.index_map, self._space.dimension
        first, size = index_map.local_range[0] * d, index_map.size_local * d
        if self._comm.size > 1:
            ends = np.cumsum(self._comm.allgather(size))
            owner = np.searchsorted(ends, rows, side="right")
            order = np.argsort(owner, kind="stable")
            cuts = np.searchsorted(owner[order], np.arange(1, self._comm.size))
            parts = [np.split(part[order], cuts) for part in (rows, columns, values)]
            got = self._comm.alltoall(list(zip(*parts)))
            rows, columns, values = (np.concatenate(part) for part in zip(*got))
        return sparse.csr_array((values, (rows - first, columns)), shape=(size, index_map.size_global * d))

    # ------------------------------------------------------------------ a step

    def set_time(self, time: float) -> None:
        """Nothing depends on the time."""

    def search_from(self, u: NDArray) -> None:
        """Searches begin at displacement `u`."""
        self._near.search_from(self._placed(u))

    def fits(self, u: NDArray) -> bool:
        """Whether no parts meet on the straight way to displacement `u` from where the search began."""
        return not self._near.crossed(self._placed(u))

    def begin(self, u: NDArray, start: float, time: float) -> NDArray:
        """Begin a step from displacement `u`, which is returned."""
        x = self._placed(u)
        self._near.search_from(x)
        self._anchor, self._touches = x, None
        if self._friction > 0:
            self._normal_force = np.zeros(x.size)
            self._follow(x)
        return u

    def follow(self) -> bool:
        """Take normal forces at the displacement of the space into friction; whether they are hardly new."""
        return self._friction == 0 or self._follow(self._places())

    def _follow(self, x: NDArray) -> bool:
        pairs, before = self._near.close(x), self._normal_force
        self._normal_force = self._sum(self._barrier.gradient(pairs, self._mesh, x))
        self._touches = self._near.library.TangentialCollisions()
        self._touches.build(self._mesh, x, pairs, self._barrier, self._friction)
        return bool(np.abs(self._normal_force - before).sum() <= FOLLOWED * np.abs(self._normal_force).sum())

    # ------------------------------------------------------------------ its start and its figures

    def clear(self, u: NDArray, time: float) -> bool:
        """Whether nothing intersects or touches at displacement `u`."""
        x = self._placed(u)
        return not self._near.intersects(x) and self._near.nearest(x) > 0

    def check(self, u: NDArray) -> None:
        """Refuse a start in which parts of the surface intersect or touch.

        Raises
        ------
        LawError
            On all ranks, naming the first such pair.
        """
        if not self.clear(u, 0.0):
            raise LawError(
                f"[contact] self: {self._near.first_meeting(self._placed(u))}; move them apart, or let contact begin "
                'later by [contact] after = "untangled"'
            )

    def diagnostics(self, u: NDArray, time: float, active: bool) -> dict[str, float]:
        """Smallest distance [m], at most d̂; half the sum of the nodes' forces [N]; whether anything intersects."""
        with self._event:
            x = self._placed(u)
            force = self._gradient(x).reshape(x.shape) if active else np.zeros_like(x)
            return {
                "smallest_gap": self._near.nearest(x),
                "contact_force": float(np.linalg.norm(force, axis=1).sum()) / 2,
                "intersections": int(self._near.intersects(x)),
            }

    def barrier_energy(self, u: NDArray, time: float) -> float:
        """Energy of the barrier [J], what contact can give back."""
        x = self._placed(u)
        return self._comm.allreduce(float(self._barrier(self._near.close(x), self._mesh, x)))
