"""Elastic bodies meet obstacles: forces, friction, what is never crossed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from elastic_bodies import material, on, problem
from mpi4py import MPI

from extremal import meshes
from extremal.forms import LawError, Prescribed, StepFailure
from extremal.forms.barrier import barrier, slip
from extremal.obstacles.colliders import Contact, Rigid
from extremal.obstacles.motion import RigidMotion
from extremal.obstacles.shapes import HalfSpace, Sphere

GAP = 0.01
FLOOR = HalfSpace([0, -GAP], [0, 1])
REACH = 0.02
SLIDING = {"distance": REACH, "stiffness": 1.0}


def block(comm, traction, friction=0.0, obstacles=None, **how):
    """A plate of 2 m x 0.5 m, E = 1 Pa, on a floor, with a traction (time -> [Pa]) on its top."""
    load = [(("top",), lambda x, t: np.tile(np.array(traction(t), dtype=float), (len(x), 1)))]
    return problem(
        on(comm, "box", size=[2.0, 0.5], cell_size=0.125, dimension=2, structured=True),
        tractions=load,
        obstacles=obstacles or [Rigid(FLOOR, Contact(friction))],
        contact=SLIDING,
        **how,
    )


# ------------------------------------------------------------------------------------------ potentials


@pytest.mark.parametrize("phi", [1e-3, 0.2, 0.6, 0.999])
def test_derivatives_of_the_barrier(phi):
    h = 1e-6 * phi
    ahead, here, behind = (barrier(np.array([phi + s]), 1.0) for s in (h, 0.0, -h))
    for k in (0, 1):
        difference = (ahead[k] - behind[k]) / (2 * h)
        assert difference == pytest.approx(here[k + 1], rel=1e-5, abs=1e-9)  # cancellation in the difference


def test_the_barrier_ends_smoothly_at_its_reach():
    below, beyond = (barrier(np.array([phi]), 2.0) for phi in (2 - 1e-6, 2.5))
    assert [value.item() for value in beyond] == [0, 0, 0]
    assert all(abs(value.item()) < 1e-5 for value in below)  # b'' ~ 6 (d̂ - φ)/d̂


def test_the_barrier_is_convex_and_pushes_outwards():
    phi = np.linspace(1e-6, 1.5, 1000)
    b, first, second = barrier(phi, 1.0)
    assert (b >= 0).all() and (first <= 0).all() and (second >= 0).all()


@pytest.mark.parametrize("size", [1e-4, 0.3, 0.9, 4.0])
def test_derivatives_of_slip(size):
    h = 1e-6 * size
    ahead, here, behind = (slip(np.array([size + s]), 1.0) for s in (h, 0.0, -h))
    first = here[1] * size
    assert (ahead[0] - behind[0]) / (2 * h) == pytest.approx(first, rel=1e-6)
    assert (ahead[1] * (size + h) - behind[1] * (size - h)) / (2 * h) == pytest.approx(here[2], rel=1e-5, abs=1e-9)


def test_residual_is_the_gradient_of_energy_with_contact_and_friction():
    body = block(MPI.COMM_SELF, lambda t: (0.01 * t, -0.02 * t), friction=0.5)
    body.advance(1.0)
    body.equations.set_time(1.0)
    rng = np.random.default_rng(0)
    x, way = body.unknown.duplicate(), rng.uniform(-1, 1, body.unknown.getSize())
    x.array[:] = body.motion.u + 1e-5 * rng.uniform(-1, 1, len(way))
    body.contact.search_from(x.array)
    force, h = body.equations.vector.duplicate(), 1e-7
    body.equations.residual(x, force)
    here = x.array.copy()
    energies = []
    for s in (h, -h):
        x.array[:] = here + s * way
        energies.append(body.equations.energy(x))
    # the energy is about 0.01 J, its difference 1e-9 J: six digits are left
    assert (energies[0] - energies[1]) / (2 * h) == pytest.approx(float(force.array @ way), rel=1e-5)


# ------------------------------------------------------------------------------------------ forces


@pytest.mark.mpi
@pytest.mark.parametrize("degree", [1, 2])
def test_the_floor_carries_what_presses_on_the_block(degree):
    held = [Prescribed(where=lambda x: np.abs(x[:, 0] - 1) < 1e-9, components=(0,))]
    body = block(MPI.COMM_WORLD, lambda t: (0, -0.01 * t), degree=degree, prescribed=held)
    body.advance(1.0)
    found = body.diagnostics()
    # exact in equilibrium; tolerance of the residual 1e-8
    assert found["contact_force"] == pytest.approx(0.02, rel=1e-5)
    assert 0.9 * REACH < found["smallest_gap"] < REACH


@pytest.mark.mpi
def test_contact_is_the_same_on_any_number_of_ranks():
    def pressed(comm):
        body = block(comm, lambda t: (0.002 * t, -0.02 * t), friction=0.5, tolerance=1e-11)
        for _ in range(2):
            body.advance(0.5)
        return body.diagnostics(), body.state()

    (together, state), (alone, own) = pressed(MPI.COMM_WORLD), pressed(MPI.COMM_SELF)
    assert together["contact_force"] == pytest.approx(alone["contact_force"], rel=1e-7)
    assert together["smallest_gap"] == pytest.approx(alone["smallest_gap"], rel=1e-7)
    if MPI.COMM_WORLD.rank == 0:
        np.testing.assert_allclose(state["u"], own["u"], atol=1e-9)  # residual 1e-11 E A over a stiffness of E


@pytest.mark.mpi
def test_force_of_a_sphere_on_a_half_space_is_that_of_hertz():
    """F = 4/3 E* √R δ^(3/2); a quarter of the half-space, whose far sides move as under a point force."""
    n, size, radius, depth, ν = 16, 2.0, 10.0, 0.009, 0.3
    reach = depth / 20
    modulus = 1 / (1 - ν**2)
    force = 4 / 3 * modulus * np.sqrt(radius) * depth**1.5
    data = meshes.generate("box", size=1.0, cell_size=1 / n, structured=True) if MPI.COMM_WORLD.rank == 0 else None
    if data is not None:
        points = size * data.points**2  # finer where the sphere is, at the origin; the half-space is below z = 0
        points[:, 2] *= -1
        cells = data.cells[:, [1, 0, 2, 3]]
        data = replace(data, points=points, cells=cells)

    def far(x, t):
        """Boussinesq's displacements under a force at the origin."""
        r, z = np.linalg.norm(x, axis=1), -x[:, 2]
        flat = np.maximum(np.hypot(x[:, 0], x[:, 1]), 1e-12)
        G = 1 / (2 * (1 + ν))
        down = force / (4 * np.pi * G) * (2 * (1 - ν) / r + z**2 / r**3)
        out = force / (4 * np.pi * G) * (flat * z / r**3 - (1 - 2 * ν) * flat / (r * (r + z)))
        return t * np.column_stack([out * x[:, 0] / flat, out * x[:, 1] / flat, -down])

    along = RigidMotion([0, 1], [[0, 0, 0], [0, 0, -depth]], dimension=3)
    body = problem(
        meshes.distribute(MPI.COMM_WORLD, data),
        material(3, ν),
        prescribed=[
            Prescribed(boundary=("left",), components=(0,)),
            Prescribed(boundary=("front",), components=(1,)),
            Prescribed(boundary=("right", "back", "top"), motion=far),
        ],
        obstacles=[Rigid(Sphere([0, 0, radius + reach], radius), motion=along)],
        contact={"distance": reach},
    )
    for _ in range(4):
        body.advance(0.25)
    # linear elements are stiff: 6 of them under the contact's radius; strains of 3 %
    assert 4 * body.diagnostics()["contact_force"] == pytest.approx(force, rel=0.04)


# ------------------------------------------------------------------------------------------ friction


@pytest.mark.parametrize("μ", [0.2, 0.5])
def test_a_block_holds_until_the_push_is_friction(μ):
    def push(part):
        body = block(MPI.COMM_SELF, lambda t: (part * μ * 0.01 * min(1, 2 * t), -0.01), friction=μ, iterations=30)
        body.advance(0.5)
        body.advance(0.5)
        return body

    held = push(0.99)
    assert held.diagnostics()["contact_force"] == pytest.approx(0.02 * np.hypot(1, 0.99 * μ), rel=1e-4)
    with pytest.raises(StepFailure):
        push(1.01)


def test_what_is_dragged_feels_coulombs_force():
    μ, ahead = 0.4, RigidMotion([0, 1], [[0, 0], [1.0, 0]], dimension=2)
    held = [Prescribed(boundary=("top",), components=(0,))]
    body = block(
        MPI.COMM_SELF,
        lambda t: (0, -0.01),
        prescribed=held,
        obstacles=[Rigid(FLOOR, Contact(μ), ahead)],
    )
    for _ in range(10):
        body.advance(0.1)
    # all nodes slide by more than ε; normal forces lag behind by below 1e-2, their sum by less
    assert body.diagnostics()["contact_force"] == pytest.approx(0.02 * np.hypot(1, μ), rel=2e-3)


def test_what_sticks_is_carried_along():
    ahead = RigidMotion([0, 1], [[0, 0], [0.5, 0]], dimension=2)
    body = block(MPI.COMM_SELF, lambda t: (0, -0.01), obstacles=[Rigid(FLOOR, Contact(sticky=True), ahead)])
    for _ in range(10):
        body.advance(0.1)
    assert np.abs(body.motion.u.reshape(-1, 2)[:, 0] - 0.5).max() < 1e-2  # widened by the pressure, 0.3 * 1 %


# ------------------------------------------------------------------------------------------ motion


@pytest.mark.parametrize("integrator", ["backward_euler", "newmark"])
def test_a_bouncing_disc_gains_no_energy(integrator):
    body = problem(
        on(MPI.COMM_SELF, "sphere", radius=0.5, cell_size=0.15, dimension=2, center=[0.0, 0.55]),
        material(2, young_modulus=100.0),
        integrator=integrator,
        obstacles=[Rigid(HalfSpace([0, 0], [0, 1]))],
    )
    body.start(velocity=lambda x: np.tile([0.0, -1.0], (len(x), 1)))
    start, gaps, energies = body.diagnostics()["energy"], [], []
    for _ in range(60):
        body.advance(0.005)
        found = body.diagnostics()
        gaps.append(found["smallest_gap"])
        energies.append(found["energy"])
    assert min(gaps) > 0
    assert max(energies) < 1.05 * start  # the trapezoidal rule keeps it on average only
    assert body.motion.v.reshape(-1, 2)[:, 1].mean() > 0.2  # it went up again


def test_an_obstacle_pushes_a_body_out_of_its_way():
    ball = Rigid(Sphere([1.0, 0.9], 0.3), motion=RigidMotion([0, 1], [[0, 0], [0, -0.25]], dimension=2))
    body = block(
        MPI.COMM_SELF,
        lambda t: (0, 0),
        obstacles=[ball],
        prescribed=[Prescribed(boundary=("bottom",))],
    )
    for _ in range(8):
        body.advance(0.125)
        assert body.diagnostics()["smallest_gap"] > 0
    x = body.space.positions + body.motion.u.reshape(-1, 2)
    below = x[np.abs(x[:, 0] - 1) < 0.05][:, 1].max()
    assert below == pytest.approx(0.9 - 0.25 - 0.3, abs=REACH)


def test_an_obstacle_that_is_too_fast_asks_for_a_shorter_step():
    ball = Rigid(Sphere([1.0, 0.9], 0.3), motion=RigidMotion([0, 1], [[0, 0], [0, -2.0]], dimension=2))
    body = block(MPI.COMM_SELF, lambda t: (0, 0), obstacles=[ball], prescribed=[Prescribed(boundary=("bottom",))])
    with pytest.raises(StepFailure, match="an obstacle comes too far into the body in one step"):
        body.advance(1.0)
    assert not body.motion.u.any()


# ------------------------------------------------------------------------------------------ the start


@pytest.mark.mpi
def test_a_start_inside_of_an_obstacle_is_refused_by_node_and_place():
    words = r"^\[\[collider\]\] #1: surface node \d+ at \(\S+, 0\) m is not outside, by 0.01 m; leave a gap"
    with pytest.raises(LawError, match=words):
        block(MPI.COMM_WORLD, lambda t: (0, 0), obstacles=[Rigid(HalfSpace([0, GAP], [0, 1]))])


def test_contact_may_wait_until_the_body_is_untangled():
    body = problem(
        on(MPI.COMM_SELF, "box", size=1.0, cell_size=0.25, dimension=2),
        prescribed=[Prescribed(boundary=("left",))],
        tractions=[(("top",), lambda x, t: np.tile([0.0, -0.1 * max(0.0, t - 1)], (len(x), 1)))],
        obstacles=[Rigid(HalfSpace([0, -GAP], [0, 1]))],
        contact={"after": "untangled"},
    )
    body.start("scatter", amplitude=1.5, seed=1)
    assert body.diagnostics()["smallest_gap"] < 0
    body.advance(1.0)
    assert not body.contact.active and body.diagnostics()["contact_force"] == 0
    body.advance(1.0)
    found = body.diagnostics()
    assert body.contact.active and found["smallest_gap"] > 0 and found["contact_force"] > 0


def test_a_restart_goes_on_with_contact():
    def begun():
        return block(MPI.COMM_SELF, lambda t: (0.002 * t, -0.02 * t), friction=0.5)

    whole, first, second = begun(), begun(), begun()
    for body in (whole, first):
        body.advance(0.5)
    second.restore(first.state())
    second.time = first.time
    for body in (whole, second):
        body.advance(0.5)
    np.testing.assert_allclose(second.motion.u, whole.motion.u, atol=1e-12)
