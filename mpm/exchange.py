"""Collisions of snow with a body that gives way: what the one loses in momentum the other gets."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

from extremal.obstacles.colliders import Collider, Contact
from extremal.obstacles.facets import Facets

from .colliders import collide, respond

# of a body's extent: what is nearer to its surface is on it. A body may start with its surface on nodes of the grid,
# and rounding shall not choose which of them it meets.
ON = 1e-10
START = 0.05  # of τ
CLOSE = 1e-3  # relative change of impulses at which no further sweep is made
MOST = 50

Mobility = Callable[[NDArray], NDArray]


class Exchange:
    """Momentum that snow exchanges with an elastic body, and with what else it meets.

    The body is met as its surface. Points i of snow (nodes of the grid, or particles) inside of it, with masses m_i and
    weights W_ik of the facets' corners k at the nearest place of the surface, get impulses p_i and the body -Wᵀ p, so
    that the velocities relative to the body afterwards

        r = v - W ṽ + G p,   G = 1/m + W B Wᵀ

    are those of 7.7: no approach, and friction as there. B is the body's mobility, the change of its velocities ṽ by
    impulses within the step. What a rigid collider does, G = 1/m, would gain energy on a body lighter than the snow.
    p is found by accelerated projected gradients (Mazhar et al., 2015): with a diagonal D >= G each sweep lets every
    point answer by itself,

        p_i <- (response(q_i) - q_i)/D_i,   q = r - D p,   D_i = (1 + τ s_i)/m_i,   s_i = Σ_k W_ik M_k/m_k

    with M_k = Σ_j W_jk m_j. τ grows until D is enough; B is at most (d + 2)/m_k, at which it always is. However many
    sweeps: impulses only push, and are opposite and equal.

    In the implicit step a point that has collided moves with the part m_i/s_i of the body's mass.

    Linear momentum is conserved to rounding, the angular one up to the arm from point to place, φ n, which forces along
    n, all but friction, do not see.

    Parameters
    ----------
    comm : mpi4py.MPI.Comm
    contact : Contact
        Friction and stickiness of the body.

    Attributes
    ----------
    impulse : (corners, d) [N s]
        What the body has got since `place`, the same on all ranks.
    outside : (d,) [N s]
        What snow, and with it the body's surface, has got from rigid obstacles since `place`, on this rank.
    sweeps : int
        Since `place`.
    """

    def __init__(self, comm: MPI.Comm, contact: Contact) -> None:
        self._comm, self._contact, self.sweeps = comm, contact, 0

    def place(self, surface: Facets, velocity: NDArray, mass: NDArray, mobility: Mobility) -> None:
        """Take the body as it is at the end of the step.

        Parameters
        ----------
        surface : Facets
        velocity : (corners, d) [m/s]
        mass : (corners,) [kg]
            Infinite where they are held.
        mobility : callable
            B: impulses (corners, d) [N s], the same on all ranks -> changes of velocity [m/s] (collective).
        """
        self._surface, self._velocity, self._mobility, self._lightness = surface, velocity.copy(), mobility, 1 / mass
        low, high = surface.bounds()
        self._on = ON * float((high - low).max())
        self.impulse = np.zeros_like(velocity)
        self.outside = np.zeros(velocity.shape[1])
        self.sweeps, self._first = 0, True

    def collide(
        self, rigid: Sequence[Collider], x: NDArray, v: NDArray, mass: NDArray, t: float
    ) -> tuple[NDArray, NDArray, NDArray]:
        """Velocities after collisions with the body and then with rigid colliders (collective).

        Parameters
        ----------
        rigid : sequence of Collider
        x : (n, d) [m]
            Nodes of the grid or particles of this rank.
        v : (n, d) [m/s]
        mass : (n,) [kg]
        t : float [s]

        Returns
        -------
        velocities : (n, d) [m/s]
        free : (n,) bool
            What nothing holds that does not give way.
        attached : (n,) [kg]
            Mass of the body that moves with each free point.
        """
        given, attached = self._meet(x, v, mass)
        after, hit = collide(rigid, x, given, t)
        self.outside += mass @ (after - given)
        free = ~hit & np.isfinite(attached)
        return after, free, np.where(free, attached, 0.0)

    def follow(self, change: NDArray, mass: NDArray, attached: NDArray) -> None:
        """Let the body have its part of an implicit step (collective).

        Parameters
        ----------
        change : (n, d) [m/s]
            Of the velocities of the points of the last `collide`.
        mass, attached : (n,) [kg]
            Of these points, and of the body.
        """
        # the forces of the step add up to nothing but for those at nodes that are held
        self.outside += (mass + attached) @ change
        self._give((attached[:, None] * change)[self._points])

    def _meet(self, x: NDArray, v: NDArray, mass: NDArray) -> tuple[NDArray, NDArray]:
        near = self._surface.near(x, self._on)
        found = self._surface.nearest(x[near])
        inside = (found.phi <= self._on) & (mass[near] > 0)
        self._points, self._nodes, self._weights = near[inside], found.nodes[inside], found.weights[inside]
        out, attached = v.copy(), np.zeros(len(x))
        if not self._comm.allreduce(len(self._points)):
            return out, attached
        m = mass[self._points]
        share = np.einsum("nk,nk->n", self._weights, (self._sum(m[:, None])[:, 0] * self._lightness)[self._nodes])
        relative = v[self._points] - self._there(self._velocity)
        # particles, the second to collide, are met by what the nodes have left to them
        impulses = self._impulses(relative, found.normal[inside], m, share, MOST if self._first else 1)
        self._first = False
        out[self._points] += impulses / m[:, None]
        held = np.divide(m, share, out=np.full(len(m), np.inf), where=share > 0)
        attached[self._points] = np.where(impulses.any(axis=1), held, 0.0)
        self._give(-impulses)
        return out, attached

    def _impulses(self, relative: NDArray, normal: NDArray, m: NDArray, share: NDArray, most: int) -> NDArray:
        """p (n, d) [N s] of points with masses m (n,), velocities `relative` (n, d) to the body, by `most` sweeps."""
        bound = relative.shape[1] + 2.0
        scale = bound if most == 1 else START
        p = z = np.zeros_like(relative)
        at_p = at_z = relative
        t = 1.0
        for _ in range(most):
            self.sweeps += 1
            while True:
                D = ((1 + scale * share) / m)[:, None]
                q = at_z - D * z
                new = (self._answer(q, normal) - q) / D
                if most == 1:
                    return new
                at_new = relative + new / m[:, None] - self._there(self._mobility(self._sum(-new)))
                step = new - z
                bent, allowed, moved, size, uphill = self._totals(
                    step * (at_new - at_z), D * step**2, D * (new - p) ** 2, D * new**2, -step * D * (new - p)
                )
                if bent <= allowed * (1 + 1e-9) or scale >= bound:
                    break
                scale = min(4 * scale, bound)
            t, before = (1.0, 1.0) if uphill > 0 else (0.5 * (1 + np.sqrt(1 + 4 * t * t)), t)
            ahead = (before - 1) / t
            z, at_z = new + ahead * (new - p), at_new + ahead * (at_new - at_p)
            p, at_p = new, at_new
            if moved <= CLOSE**2 * size:
                break
        return p

    def _answer(self, relative: NDArray, normal: NDArray) -> NDArray:
        """Relative velocities (n, d) after each point's collision by itself (7.7)."""
        if self._contact.sticky:
            return np.zeros_like(relative)
        out = relative.copy()
        after, on = respond(relative, normal, self._contact.friction)
        out[on] = after
        return out

    def _give(self, impulses: NDArray) -> None:
        """Give the body impulses (m, d) [N s] at the points that collided last."""
        total = self._sum(impulses)
        self.impulse += total
        if total.any():
            self._velocity += self._mobility(total)

    def _there(self, values: NDArray) -> NDArray:
        """Values (corners, d) at the places of the points that collided last."""
        return np.einsum("nk,nkd->nd", self._weights, values[self._nodes])

    def _sum(self, values: NDArray) -> NDArray:
        """Values (m, c) of the points that collided last, added up at the corners (corners, c) over all ranks."""
        out = np.zeros((len(self._velocity), values.shape[1]))
        np.add.at(out, self._nodes, self._weights[:, :, None] * values[:, None, :])
        self._comm.Allreduce(MPI.IN_PLACE, out)
        return out

    def _totals(self, *values: NDArray) -> NDArray:
        """Sum of each array over all ranks."""
        out = np.array([value.sum() for value in values])
        self._comm.Allreduce(MPI.IN_PLACE, out)
        return out
