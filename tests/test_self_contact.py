"""Elastic bodies meet themselves and each other: derivatives, laws of motion, what never crosses, ranks."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from elastic_bodies import material, on, problem
from mpi4py import MPI

from extremal import meshes
from extremal.forms import LawError, Prescribed, StepFailure
from extremal.forms.space import Space
from extremal.forms.surface import Surface
from extremal.meshes import Copies

pytest.importorskip("ipctk")
REACH = 0.03


def bodies(comm, d, *placed, cell_size=0.5, size=1.0):
    """Boxes, as `placed` says."""
    data = None
    if comm.rank == 0:
        box = meshes.generate("box", size=size, cell_size=cell_size, dimension=d, structured=True)
        data = meshes.copies(box, placed)
    return meshes.distribute(comm, data)


def towards(x, speed=1.0):
    """Velocities (n, d) [m/s] of two bodies with x < 1.01 and beyond that fly at each other."""
    return np.column_stack([np.where(x[:, 0] < 1.01, speed, -speed), *np.zeros((x.shape[1] - 1, len(x)))])


def colliding(comm, d, degree=1, friction=0.0, **how):
    """Two boxes about to meet off-centre, one turned a little so that edges meet too."""
    other = Copies((1.08,) + (0.21,) * (d - 1), (0.1, 0.05, 0.1))
    contact = {"self": True, "friction": friction, "distance": REACH}
    made = problem(
        bodies(comm, d, Copies(), other),
        material(d, young_modulus=20.0),
        degree=degree,
        contact=contact,
        **{"integrator": "backward_euler", "tolerance": 1e-10, **how},
    )
    made.start(velocity=towards)
    return made


def momentum(made):
    """Σ M v [N s], and that about the origin [N m s] (scalar, or three components)."""
    owned, d = made.equations.owned, made.space.dimension
    v, out = made.equations.vector.duplicate(), made.equations.vector.duplicate()
    v.array[:] = made.motion.v[:owned]
    made.equations.mass.mult(v, out)
    each = out.array.reshape(-1, d)
    x = (made.space.positions + made.motion.u.reshape(-1, d))[: len(each)]
    return made.comm.allreduce(each.sum(axis=0)), made.comm.allreduce(np.cross(x, each).sum(axis=0))


@pytest.mark.mpi
@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("degree", [1, 2])
def test_every_rank_has_the_whole_surface(d, degree):
    box = on(MPI.COMM_WORLD, "box", size=[2.0, 1.0, 0.5][:d], cell_size=0.3, dimension=d)
    surface = Surface(Space(box, degree), np.zeros(0, dtype=np.int32))
    x = surface.rest[surface.facets]
    sides = x[:, 1:] - x[:, :1]
    sizes = np.sqrt(np.linalg.det(sides @ sides.transpose(0, 2, 1))) / (d - 1)
    assert sizes.sum() == pytest.approx({2: 6.0, 3: 7.0}[d])
    corners = np.sort(surface.facets, axis=1)
    edges = corners if d == 2 else np.vstack([corners[:, [0, 1]], corners[:, [0, 2]], corners[:, [1, 2]]])
    shared = np.unique(edges if d == 3 else edges.reshape(-1, 1), axis=0, return_counts=True)[1]
    assert (shared == 2).all()  # closed


# ------------------------------------------------------------------------------------------ derivatives


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("friction", [0.0, 0.5])
def test_force_and_tangent_are_the_derivatives_of_energy(d, friction):
    body = colliding(MPI.COMM_SELF, d, friction=friction)
    while body.diagnostics()["contact_force"] == 0:
        body.advance(0.02)
    rng, equations = np.random.default_rng(0), body.equations
    equations.begin(body.scheme.terms(body.motion, 1.0), body.motion.u)
    x, force, product = (equations.vector.duplicate() for _ in range(3))
    way = rng.uniform(-1, 1, x.getSize())
    here = body.motion.u + 1e-5 * rng.uniform(-1, 1, len(way))
    body.contact.search_from(here)
    x.array[:] = here
    equations.residual(x, force)
    equations.tangent(x, equations.matrix, projected=False)
    product.array[:] = way
    curved = (equations.matrix * product).array.copy()
    h, energies, forces = 1e-7, [], []
    for s in (h, -h):
        x.array[:] = here + s * way
        energies.append(equations.energy(x))
        equations.residual(x, product)
        forces.append(product.array.copy())
    slope, change = (energies[0] - energies[1]) / (2 * h), (forces[0] - forces[1]) / (2 * h)
    # the energy is about 1 J: its difference has some eight digits; friction's third derivative is large
    assert slope == pytest.approx(float(force.array @ way), rel=1e-5, abs=1e-7)
    np.testing.assert_allclose(change, curved, atol=1e-5 * np.abs(curved).max())


@pytest.mark.parametrize("d", [2, 3])
def test_the_projected_tangent_is_positive_in_contact(d):
    body = colliding(MPI.COMM_SELF, d, friction=0.5)
    while body.diagnostics()["contact_force"] == 0:
        body.advance(0.02)
    x = body.unknown
    x.array[:] = body.motion.u
    body.equations.tangent(x, body.equations.matrix, projected=True)
    values = np.linalg.eigvalsh(body.equations.matrix.convert("dense").getDenseArray())
    assert values.min() > -1e-12 * values.max()


# ------------------------------------------------------------------------------------------ laws of motion


@pytest.mark.mpi
@pytest.mark.parametrize(("d", "degree", "friction"), [(2, 1, 0.0), (2, 2, 0.3), (3, 1, 0.3)])
def test_a_collision_keeps_momentum_and_gains_no_energy(d, degree, friction):
    body = colliding(MPI.COMM_WORLD, d, degree, friction)
    before, found = momentum(body)[0], []
    for _ in range(15):
        body.advance(0.04)
        found.append(body.diagnostics())
    after = momentum(body)[0]
    assert max(f["contact_force"] for f in found) > 0.1
    # the residual of 1e-10 E A in each step, times its length
    np.testing.assert_allclose(after, before, atol=1e-9)
    assert all(f["intersections"] == 0 and 0 < f["smallest_gap"] <= REACH for f in found)
    energies = [f["energy"] for f in found]
    assert max(energies) <= energies[0] * (1 + 1e-9)  # backward Euler; energy before the touch is kinetic


def test_the_midpoint_rule_keeps_angular_momentum_in_a_collision():
    body = colliding(MPI.COMM_SELF, 2, integrator="midpoint")
    before = momentum(body)
    forces = []
    for _ in range(40):
        body.advance(0.0025)
        forces.append(body.diagnostics()["contact_force"])
    assert max(forces) > 0.1
    for old, new in zip(before, momentum(body)):
        np.testing.assert_allclose(new, old, atol=1e-8)


@pytest.mark.mpi
def test_a_collision_is_the_same_on_any_number_of_ranks():
    def state(comm):
        body = colliding(comm, 3, friction=0.3)
        for _ in range(5):
            body.advance(0.04)
        return body.diagnostics(), body.state()

    (together, spread), (alone, own) = state(MPI.COMM_WORLD), state(MPI.COMM_SELF)
    assert together["contact_force"] == pytest.approx(alone["contact_force"], rel=1e-6) != 0
    if MPI.COMM_WORLD.rank == 0:
        np.testing.assert_allclose(spread["u"], own["u"], atol=1e-9)  # residual 1e-10 E A over a stiffness of E


def test_bodies_do_not_pass_through_each_other_in_one_long_step():
    body = problem(
        bodies(MPI.COMM_SELF, 2, Copies(), Copies((1.5, 0.2))),
        material(2, young_modulus=1e4),
        prescribed=[Prescribed(where=lambda x: x[:, 0] > -1, components=(1,))],  # they cannot go round each other
        integrator="backward_euler",
        contact={"self": True},
    )
    body.start(velocity=lambda x: towards(x, 10.0))
    body.advance(0.3)  # each would fly 3 m
    x, left = (body.space.positions + body.motion.u.reshape(-1, 2))[:, 0], body.space.positions[:, 0] < 1.01
    assert x[left].mean() < x[~left].mean() and x[left].min() < x[~left].min() and x[left].max() < x[~left].max()
    assert body.diagnostics()["intersections"] == 0


def test_a_restart_goes_on_with_contact_of_the_body_with_itself():
    whole, first, second = (colliding(MPI.COMM_SELF, 2, friction=0.3) for _ in range(3))
    for body in (whole, first):
        for _ in range(3):
            body.advance(0.04)
    second.restore(first.state())
    second.time = first.time
    for body in (whole, second):
        body.advance(0.04)
    assert whole.diagnostics()["contact_force"] > 0
    np.testing.assert_allclose(second.motion.u, whole.motion.u, atol=1e-12)


# ------------------------------------------------------------------------------------------ statics


def stack(comm, push, friction=0.0, prescribed=(), **how):
    """A plate of 2 m x 0.5 m, E = 1 Pa, on one that is held at its foot, and `push` (time -> [Pa]) on its top."""
    above = Copies((0.0, 0.5 + REACH / 2), name="upper")
    made = problem(
        bodies(comm, 2, Copies(name="lower"), above, cell_size=0.25, size=[2, 0.5]),
        material(2),
        prescribed=[Prescribed(boundary=("lower_bottom",)), *prescribed],
        tractions=[(("upper_top",), lambda x, t: np.tile(np.array(push(t), dtype=float), (len(x), 1)))],
        contact={"self": True, "friction": friction, "distance": REACH},
        **how,
    )
    for _ in range(2):
        made.advance(0.5)
    return made


@pytest.mark.mpi
@pytest.mark.parametrize("degree", [1, 2])
def test_the_lower_plate_carries_the_upper_one(degree):
    middle = Prescribed(where=lambda x: (np.abs(x[:, 0] - 1) < 1e-9) & (x[:, 1] > 0.51), components=(0,))
    body = stack(MPI.COMM_WORLD, lambda t: (0, -0.01 * t), degree=degree, prescribed=[middle])
    force, owned = body.equations.vector.duplicate(), body.equations.owned // 2
    body.contact.add_force(force)
    upper = body.space.positions[:owned, 1] > 0.51
    total = body.comm.allreduce(force.array.reshape(-1, 2)[upper].sum(axis=0))
    np.testing.assert_allclose(total, [0, -0.02], atol=2e-7)  # exact in equilibrium; tolerance of the residual 1e-8
    found = body.diagnostics()
    assert found["contact_force"] == pytest.approx(0.02, rel=1e-3)  # corners push a little sideways too
    assert 0.5 * REACH < found["smallest_gap"] < REACH


def test_the_upper_plate_holds_until_the_push_is_friction():
    def pushed(part, μ=0.4):
        return stack(MPI.COMM_SELF, lambda t: (part * μ * 0.01 * min(1, 2 * t), -0.01), μ, iterations=60)

    held = pushed(0.95)
    assert held.diagnostics()["max_displacement"] < 0.1
    with pytest.raises(StepFailure):
        pushed(1.05)


def test_a_floor_and_bodies_on_each_other_at_once():
    from extremal.obstacles.colliders import Rigid
    from extremal.obstacles.shapes import HalfSpace

    placed = Copies((0.0, REACH)), Copies((0.0, 1.0 + 2 * REACH))
    body = problem(
        bodies(MPI.COMM_SELF, 2, *placed),
        material(2),
        prescribed=[Prescribed(where=lambda x: np.abs(x[:, 0] - 0.5) < 1e-9, components=(0,))],
        gravity=[0.0, -0.01],
        obstacles=[Rigid(HalfSpace([0, 0], [0, 1]))],
        contact={"self": True, "distance": REACH},
    )
    body.advance(1.0)
    found = body.diagnostics()
    assert found["contact_force"] == pytest.approx(0.02 + 0.01, rel=1e-4)  # on the floor, between the bodies
    assert found["intersections"] == 0


# ------------------------------------------------------------------------------------------ one body


def slit(width):
    """A square of side 1 with a slit of a `width` from the middle of its top to a third of its height."""
    data = meshes.generate("box", size=1.0, cell_size=1 / 9, dimension=2, structured=True)
    x = data.points[data.corners].mean(axis=1)
    kept = ~((np.abs(x[:, 0] - 0.5) < 0.06) & (x[:, 1] > 0.34))
    used, cells = np.unique(data.cells[kept], return_inverse=True)
    points = data.points[used].copy()
    edge = np.abs(np.abs(points[:, 0] - 0.5) - 1 / 18) < 0.01
    points[edge, 0] = 0.5 + width / 2 * np.sign(points[edge, 0] - 0.5)
    facets = np.isin(data.facets, used).all(axis=1)
    return replace(
        data,
        points=points,
        cells=cells.reshape(-1, 3),
        regions=data.regions[kept],
        facets=np.searchsorted(used, data.facets[facets]),
        facet_tags=data.facet_tags[facets],
    )


def test_what_is_closer_in_one_body_at_rest_is_not_pushed_apart():
    made = problem(meshes.distribute(MPI.COMM_SELF, slit(0.004)), contact={"self": True})
    assert made.contact.surface.reach == pytest.approx(0.002)
    assert made.diagnostics()["contact_force"] == 0


@pytest.mark.mpi
def test_a_slit_that_is_pressed_together_closes_and_stays():
    def pressed(**contact):
        data = slit(0.05) if MPI.COMM_WORLD.rank == 0 else None
        shut = lambda x, t: np.column_stack([0.08 * t * np.sign(0.5 - x[:, 0]), 0 * x[:, 1]])  # noqa: E731
        sides = [
            Prescribed(where=lambda x: (np.abs(x[:, 0] - 0.5) > 0.49) & (x[:, 1] > 0.6), components=(0,), motion=shut),
            Prescribed(boundary=("bottom",)),
        ]
        made = problem(meshes.distribute(MPI.COMM_WORLD, data), prescribed=sides, contact=contact or None)
        for _ in range(5):
            made.advance(0.2)
        x = made.space.positions + made.motion.u.reshape(-1, 2)
        left, top = made.space.positions[:, 0] < 0.5, made.space.positions[:, 1] > 0.99
        right_most, left_most = x[left & top, 0].max(initial=0), x[~left & top, 0].min(initial=1)
        return made, made.comm.allreduce(left_most, op=MPI.MIN) - made.comm.allreduce(right_most, op=MPI.MAX)

    assert pressed()[1] < -0.05  # without contact each half goes through the other
    body, gap = pressed(**{"self": True})
    found = body.diagnostics()
    assert 0 < found["smallest_gap"] <= gap < 0.05
    assert found["contact_force"] > 0.01 and found["intersections"] == 0


# ------------------------------------------------------------------------------------------ the start


@pytest.mark.mpi
@pytest.mark.parametrize(("d", "other"), [(2, "edge"), (3, "triangle")])
def test_a_start_that_intersects_is_refused_by_nodes_and_place(d, other):
    overlapping = bodies(MPI.COMM_WORLD, d, Copies(), Copies((0.7,) + (0.3,) * (d - 1)))
    nodes = {"edge": r"\d+-\d+", "triangle": r"\d+-\d+-\d+"}[other]
    place = r"\(" + ", ".join([r"\S+"] * d) + r"\) m"
    words = rf"^\[contact\] self: edge \d+-\d+ at {place} cuts {other} {nodes} at {place}; move them apart, or let"
    with pytest.raises(LawError, match=words):
        problem(overlapping, contact={"self": True})


def test_a_start_that_is_inverted_inside_is_no_obstacle_to_contact():
    box = on(MPI.COMM_SELF, "box", size=1.0, cell_size=0.2, dimension=2)
    made = problem(box, prescribed=[Prescribed(boundary=("left",))], contact={"self": True})
    x, rng = made.space.positions, np.random.default_rng(1)
    inside = (np.abs(x - 0.5) < 0.49).all(axis=1)
    u = np.where(inside[:, None], rng.uniform(0.1, 0.9, x.shape) - x, 0.0)
    made.motion = replace(made.motion, u=u.ravel())
    made.contact.check(made.motion.u)
    assert made.diagnostics()["inverted"] > 0
    made.advance(1.0)
    found = made.diagnostics()
    assert found["inverted"] == 0 and found["max_displacement"] < 1e-4 and found["intersections"] == 0


def test_contact_may_wait_until_the_surface_is_untangled():
    made = problem(
        on(MPI.COMM_SELF, "box", size=1.0, cell_size=0.25, dimension=2),
        prescribed=[Prescribed(boundary=("left",))],
        contact={"self": True, "after": "untangled"},
    )
    made.start("scatter", amplitude=1.5, seed=1)
    assert made.diagnostics()["intersections"] == 1
    made.advance(1.0)
    assert not made.contact.active and made.diagnostics()["intersections"] == 0
    made.advance(1.0)
    assert made.contact.active


def test_without_the_library_one_line_says_how_to_get_it(tmp_path):
    scene = tmp_path / "scene.toml"
    scene.write_text(
        '[mesh]\nshape = "box"\ncell_size = 0.5\n[material]\nyoung_modulus = 1e5\npoisson_ratio = 0.3\n'
        "[contact]\nself = true\n"
    )
    code = "import sys; sys.modules['ipctk'] = None; from extremal.app import cli; sys.exit(cli.main(sys.argv[1:]))"
    command = [sys.executable, "-c", code, "elastic", str(scene), "-o", str(tmp_path / "out")]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 2
    assert done.stderr == (
        f"extremal: {scene}: [contact] self = true needs ipctk; install it by ./setup.sh contact, or pip install "
        "'extremal[contact]'\n"
    )
