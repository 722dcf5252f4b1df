"""First guesses for a step: the body follows its boundary by linear solves, or its own motion."""

from __future__ import annotations

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray
from petsc4py import PETSc

from .equations import Equations
from .integrators import Terms
from .newton import Newton

MOST_SOLVES = 24


def follow_boundary(equations: Equations, newton: Newton, start: NDArray, moved: NDArray) -> NDArray:
    """Where Newton should begin when the boundary has moved.

    Each linear solve takes the boundary part of the way, the body after it, and corrects what is left of the
    residual; the part is halved where an element of a body without inverted ones would invert, or something in contact
    would be entered. A jump of the boundary alone, the crudest guess, is kept where it has less energy.

    Parameters
    ----------
    equations : Equations
    newton : Newton
        Its Krylov solver is used.
    start, moved : (local nodes * d,)
        Displacement before the step, and the same with the new prescribed values.

    Returns
    -------
    (local nodes * d,)
    """
    jump = moved - start
    comm, contact = equations.comm, equations.contact
    if comm.allreduce(float(np.abs(jump).max(initial=0)), op=MPI.MAX) == 0 or not equations.has_energy:
        return moved
    here, done, part = start, 0.0, 1.0
    may_invert = _inverted(equations, start)
    x = equations.vector.duplicate()
    try:
        for _ in range(MOST_SOLVES):
            part = min(part, 1 - done)
            ahead = _follow(equations, newton, x, here, part * jump)
            upright = may_invert or not _inverted(equations, ahead)
            if upright and (contact is None or contact.fits(ahead)):
                here, done = ahead, done + part
                part *= 2
            else:
                part /= 2
            if done >= 1:
                return here if _energy(equations, x, here) < _energy(equations, x, moved) else moved
        return moved
    finally:
        x.destroy()


def coast(equations: Equations, start: NDArray, guess: NDArray, terms: Terms | None) -> NDArray:
    """Where Newton should begin when the body moves and may be held by friction to what moves along with it.

    As far towards where inertia alone would take it as nothing is crossed, if that has less energy than `guess`.

    Parameters
    ----------
    equations : Equations
    start, guess : (local nodes * d,)
        Displacement before the step, and where Newton would begin otherwise.
    terms : Terms or None
        Of the time integration; None in statics.

    Returns
    -------
    (local nodes * d,)
    """
    if terms is None or equations.contact is None or not equations.has_energy:
        return guess
    way = terms.u_hat - start
    way[equations.held] = 0
    equations.contact.search_from(start)
    x = equations.vector.duplicate()
    least = _energy(equations, x, guess)
    for part in (1.0, 0.5, 0.25):
        if _energy(equations, x, guess + part * way) < least:
            guess = equations.space.u.x.array.copy()
            break
    x.destroy()
    return guess


def _follow(equations: Equations, newton: Newton, x: PETSc.Vec, here: NDArray, jump: NDArray) -> NDArray:
    owned = equations.owned
    x.array[:] = here[:owned]
    force = equations.linear_force(x, jump)
    newton.solve_linear(equations.matrix, force, x)
    x.array[:] = here[:owned] + jump[:owned] - x.array
    equations.set(x)
    return equations.space.u.x.array.copy()


def _energy(equations: Equations, x: PETSc.Vec, u: NDArray) -> float:
    x.array[:] = u[: equations.owned]
    return equations.energy(x)


def _inverted(equations: Equations, u: NDArray) -> bool:
    equations.space.u.x.array[:] = u
    equations.space.gradient(equations.laws.gradient)
    found = bool((equations.laws.determinants() < 0).any())
    return equations.comm.allreduce(found, op=MPI.LOR)
