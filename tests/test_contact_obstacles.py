"""Elastic bodies meet curved obstacles: exact tangents, walls and teeth, closed surface meshes."""

from __future__ import annotations

import meshio
import numpy as np
import pytest
from elastic_bodies import on, problem
from mpi4py import MPI

from extremal import meshes
from extremal.app import cli
from extremal.forms import Prescribed
from extremal.obstacles.colliders import Rigid
from extremal.obstacles.facets import boundary
from extremal.obstacles.gear import Gear
from extremal.obstacles.hollow import Tube
from extremal.obstacles.motion import RigidMotion
from extremal.obstacles.shapes import Sphere
from extremal.obstacles.surfaces import ClosedSurface

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


# ------------------------------------------------------------------------------------------ closed surface meshes


def triangles_of(path, comm, shape, **parameters):
    """A file with the surface of a generated body."""
    if comm.rank == 0:
        data = meshes.generate(shape, **parameters)
        meshio.write_points_cells(path, data.points, [("triangle", boundary(data.points, data.cells))])
    comm.barrier()
    return path


def dented(obstacle, comm):
    """A cube of 1 m, held below, into which an obstacle comes by 0.2 m from above."""
    down = RigidMotion([0, 1], [[0, 0, 0], [0, 0, -0.2]], dimension=3)
    body = problem(
        on(comm, "box", size=1.0, cell_size=0.25),
        prescribed=[Prescribed(boundary=("bottom",))],
        obstacles=[Rigid(obstacle, motion=down)],
        contact={"distance": 0.02},
    )
    taken = [body.advance(0.2)["newton_iterations"] for _ in range(5)]
    return body.diagnostics(), sum(taken)


@pytest.mark.mpi
def test_a_ball_of_triangles_presses_like_a_ball_and_is_as_easy_to_solve(shared_path):
    comm = MPI.COMM_WORLD
    middle = [0.5, 0.5, 1.42]
    path = triangles_of(shared_path / "ball.stl", comm, "sphere", radius=0.4, cell_size=0.06, center=middle)
    triangles, taken = dented(ClosedSurface(path), comm)
    ball, fewest = dented(Sphere(middle, 0.4), comm)
    assert ball["contact_force"] > 0.01
    # facets lie inside the ball by up to h²/8R, a hundredth of the depth, and reach it at their corners
    assert triangles["contact_force"] == pytest.approx(ball["contact_force"], rel=0.03)
    assert triangles["smallest_gap"] > 0
    assert taken < 1.5 * fewest


SURFACES = """
[mesh]
file = "animal.stl"
[material]
young_modulus = 1e5
poisson_ratio = 0.3
extension = "c2"
[[fixed]]
where = "z < 1e-6"
[[collider]]
shape = "surface"
file = "ball.stl"
[[collider.keyframes]]
time = 0
[[collider.keyframes]]
time = 1
translation = [-0.2, 0, 0]
[analysis]
time_step = 0.25
[expect]
status = "finished"
inverted = 0
smallest_gap = { above = 0 }
contact_force = { above = 10 }
max_displacement = { above = 0.1 }
"""


def test_a_users_surface_becomes_a_body_and_another_one_an_obstacle(tmp_path):
    """An animal given by its skin is pushed back by the nose."""
    comm = MPI.COMM_SELF
    triangles_of(tmp_path / "animal.stl", comm, "creature", cell_size=0.16)
    triangles_of(tmp_path / "ball.stl", comm, "sphere", radius=0.25, cell_size=0.1, center=[1.02, 0, 0.88])
    (tmp_path / "scene.toml").write_text(SURFACES)
    assert cli.main(["elastic", str(tmp_path / "scene.toml"), "-o", str(tmp_path / "out"), "--quiet"]) == 0
