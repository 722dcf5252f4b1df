"""Elastic bodies meet curved obstacles: exact tangents, walls and teeth, closed surface meshes."""

from __future__ import annotations

import numpy as np
import pytest
from elastic_bodies import material, on, problem
from mpi4py import MPI

from extremal.forms import Prescribed
from extremal.obstacles.colliders import Rigid
from extremal.obstacles.gear import Gear
from extremal.obstacles.hollow import Tube
from extremal.obstacles.motion import RigidMotion
from extremal.obstacles.shapes import Sphere

REACH = 0.05


def pressed(obstacle, comm=MPI.COMM_SELF, **how):
    """A plate of 1 m x 1 m, E = 1 Pa, held below, into the top of which an obstacle has come from above."""
    down = RigidMotion([0, 1], [[0, 0], [0, -0.1]], dimension=2)
    body = problem(
        on(comm, "box", size=1.0, cell_size=0.125, dimension=2),
        prescribed=[Prescribed(boundary=("bottom",))],
        obstacles=[Rigid(obstacle, motion=down)],
        contact={"distance": REACH},
        **how,
    )
    for _ in range(5):
        body.advance(0.2)
    return body


# lowest points half a d̂ above the plate
FROM_ABOVE = {
    "sphere": Sphere([0.5, 1.225], 0.2),
    "gear": Gear([0.5, 1.425], 0.4, 8, 0.12),
    "lip of a tube": Tube([0.5, 1.475], 0.2, 0.2, 0.5, flare=0.1),
}


@pytest.mark.parametrize("name", FROM_ABOVE)
def test_the_tangent_is_the_derivative_of_the_force_where_the_obstacle_is_curved(name):
    body = pressed(FROM_ABOVE[name])
    rng, equations = np.random.default_rng(0), body.equations
    equations.set_time(1.0)
    way = rng.uniform(-1, 1, body.size)
    way[equations.held] = 0
    x, product, forces, h = body.unknown.duplicate(), body.unknown.duplicate(), [], 1e-6
    for s in (h, -h):
        x.array[:] = body.motion.u + s * way
        forces.append(equations.vector.duplicate())
        equations.residual(x, forces[-1])
    x.array[:] = body.motion.u
    equations.tangent(x, equations.matrix, False)
    change, matrix = x.duplicate(), equations.matrix
    change.array[:] = way
    matrix.mult(change, product)
    difference = (forces[0].array - forces[1].array) / (2 * h)
    product.array[equations.held] = 0
    assert body.diagnostics()["contact_force"] > 0.01
    # second differences over h = 1e-6 m of a force that changes over 1e-2 m
    assert np.abs(product.array - difference).max() < 1e-5 * np.abs(difference).max()
