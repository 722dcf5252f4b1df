"""Collisions of snow with a body that gives way: what snow loses in momentum the body gets, and what it gets."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

from extremal.obstacles.colliders import Collider, Contact
from extremal.obstacles.facets import Facets

from .colliders import collide, respond

# of a body's extent: what is nearer to its surface is on it. A body may start with its surface on nodes of the grid,
# and rounding shall not choose which of them it meets.
ON = 1e-10


class Exchange:
    """Momentum that snow exchanges with an elastic body, and with what else it meets.

    The body is met as its surface: facets whose corners k have velocities ṽ_k and masses m_k, infinite where they are
    held. A point i of snow (a grid node or a particle) inside of it, with the corners' weights w_ik at the nearest
    place of the surface, gets the response of 7.7 to v_co = Σ_k w_ik ṽ_k in part only::

        Δv_i = (response - v_i) / (1 + s_i),   s_i = Σ_k w_ik M_k / m_k,   M_k = Σ_j w_jk m_j over all that collide

    and corner k the impulse -Σ_i w_ik m_i Δv_i. This is the inelastic collision of masses M_k and m_k: both go on
    together, and for any masses no energy is gained, since G = M⁻¹ + W m⁻¹ Wᵀ, which makes relative velocities of
    impulses, is at most diag((1 + s_i)/m_i). The response to a rigid collider, s = 0, would gain energy on a body
    lighter than the snow.

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
    heaviest : float
        Largest M_k/m_k since `place`.
    """

    def __init__(self, comm: MPI.Comm, contact: Contact) -> None:
        self._comm, self._contact = comm, contact

    def place(self, surface: Facets, velocity: NDArray, mass: NDArray) -> None:
        """Take the surface at the end of the step, and velocities (corners, d) [m/s] and masses [kg] of its corners."""
        self._surface, self._velocity, self._mobility = surface, velocity.copy(), 1 / mass
        low, high = surface.bounds()
        self._on = ON * float((high - low).max())
        self.impulse = np.zeros_like(velocity)
        self.outside = np.zeros(velocity.shape[1])
        self.heaviest = 0.0

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
        inside = found.phi <= self._on
        points, nodes, weights = near[inside], found.nodes[inside], found.weights[inside]
        relative = v[points] - np.einsum("nk,nkd->nd", weights, self._velocity[nodes])
        if self._contact.sticky:
            change = -relative
        else:
            after, on = respond(relative, found.normal[inside], self._contact.friction)
            points, nodes, weights = points[on], nodes[on], weights[on]
            change = after - relative[on]
        self._points, self._nodes, self._weights = points, nodes, weights

        load = self._sum(mass[points, None])[:, 0] * self._mobility
        self.heaviest = max(self.heaviest, float(load.max(initial=0.0)))
        share = np.einsum("nk,nk->n", weights, load[nodes])
        out, attached = v.copy(), np.zeros(len(x))
        out[points] += change / (1 + share)[:, None]
        attached[points] = np.divide(mass[points], share, out=np.full(len(points), np.inf), where=share > 0)
        self._give(-mass[points, None] * (out - v)[points])
        return out, attached

    def _give(self, impulses: NDArray) -> None:
        """Give the body impulses (m, d) [N s] at the points that collided last."""
        total = self._sum(impulses)
        self.impulse += total
        self._velocity += total * self._mobility[:, None]

    def _sum(self, values: NDArray) -> NDArray:
        """Values (m, c) of the points that collided last, added up at the corners (corners, c) over all ranks."""
        out = np.zeros((len(self._mobility), values.shape[1]))
        np.add.at(out, self._nodes, self._weights[:, :, None] * values[:, None, :])
        self._comm.Allreduce(MPI.IN_PLACE, out)
        return out
