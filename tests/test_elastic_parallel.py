"""The same answer on any number of ranks, and after a restart on any other.

Each test solves on all ranks of the run and again on one rank alone, and compares in the canonical order of nodes.
"""

import numpy as np
import pytest
from elastic_bodies import material, on, problem
from mpi4py import MPI

from extremal.forms import Prescribed, Stage

pytestmark = pytest.mark.mpi

HELD = [Prescribed(boundary=("left",))]
LOADS = [(("right",), lambda x, t: np.column_stack([0.02 * t + 0 * x[:, 0], 0.03 * t * x[:, 1], 0.0 * x[:, 0]]))]
RELEASED = {"tolerance": 1e-11}


def scattered(comm):
    body = problem(
        on(comm, "box", cell_size=0.25),
        material(3, 0.4),
        prescribed=HELD,
        tractions=LOADS,
        stages=[Stage(poisson_ratio=0.0)],
        **RELEASED,
    )
    body.start("scatter", seed=3)
    body.advance(1.0)
    return body


def loaded_bar(comm):
    body = problem(on(comm, "bar", cell_size=0.5), prescribed=HELD, tractions=LOADS, gravity=[0, 0, -0.005], **RELEASED)
    for _ in range(2):
        body.advance(0.5)
    return body


def second_order_bar(comm):
    twisted = Prescribed(
        boundary=("right",),
        motion=lambda x, t: t * np.column_stack([0.2 + 0 * x[:, 0], -0.5 * x[:, 2], 0.5 * x[:, 1]]),
    )
    domain = on(comm, "bar", size=[2.0, 1.0, 1.0], cell_size=0.5)
    body = problem(domain, degree=2, prescribed=[*HELD, twisted], **RELEASED)
    body.advance(1.0)
    return body


def pressed_ring(comm):
    domain = on(comm, "tube", dimension=2, cell_size=0.08, order=2)
    body = problem(
        domain,
        degree=2,
        prescribed=[Prescribed(boundary=("outer",))],
        pressures=[(("inner",), lambda x, t: 0.3 * t * (1 + x[:, 0]))],
        **RELEASED,
    )
    body.advance(1.0)
    return body


def thrown(comm, integrator):
    domain = on(comm, "bar", size=[2.0, 1.0, 1.0], cell_size=0.5)
    body = problem(
        domain,
        prescribed=HELD,
        tractions=LOADS,
        gravity=[0, 0, -0.3],
        integrator=integrator,
        damping=(0.1, 0.05),
        **RELEASED,
    )
    body.start(velocity=lambda x: 0.2 * np.column_stack([x[:, 1], 0 * x[:, 0], x[:, 0]]))
    return body


def ten_steps(comm, integrator):
    body = thrown(comm, integrator)
    for _ in range(10):
        body.advance(0.05)
    return body


CASES = {
    "scattered": scattered,
    "loaded_bar": loaded_bar,
    "second_order_bar": second_order_bar,
    "pressed_ring": pressed_ring,
    "bdf2": lambda comm: ten_steps(comm, "bdf2"),
    "newmark": lambda comm: ten_steps(comm, "newmark"),
}


def answer(body):
    """What all ranks of the run should agree on, known on every one of them."""
    state = MPI.COMM_WORLD.bcast(body.state() or None)
    return state, body.diagnostics()


@pytest.mark.parametrize("case", CASES)
def test_the_displacement_does_not_depend_on_the_number_of_ranks(comm, case):
    together, alone = answer(CASES[case](comm)), answer(CASES[case](MPI.COMM_SELF))
    assert set(together[0]) == set(alone[0])
    for name, values in alone[0].items():
        size = max(1.0, np.abs(values).max())
        assert np.abs(together[0][name] - values).max() <= 1e-8 * size, name
    for name in (
        "energy",
        "smallest_J",
        "smallest_stretch",
        "max_displacement",
        "kinetic_energy",
        "inverted",
    ):
        assert together[1][name] == pytest.approx(alone[1][name], abs=1e-8), name


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("d", [2, 3])
def test_a_single_element_is_solved_on_more_ranks_than_it_has_elements(comm, d, order):
    """Some ranks own nothing, or only nodes."""
    body = problem(on(comm, "simplex", dimension=d), degree=order, prescribed=[], tolerance=1e-10)
    body.start("scatter", seed=1)
    body.advance(1.0)
    figures = body.diagnostics()
    assert figures["inverted"] == 0
    assert figures["elastic_energy"] == pytest.approx(0, abs=1e-12)
    points, _, fields = (*(body.geometry() or (None,) * 3)[:2], body.fields())
    if comm.rank == 0:
        assert len(points) == len(fields[0]["displacement"])


@pytest.mark.parametrize("integrator", ["backward_euler", "bdf2", "midpoint", "newmark"])
def test_a_restart_on_another_number_of_ranks_goes_on_to_the_same_answer(comm, integrator):
    """Four steps on all ranks and four on one, or the other way round, against eight on one."""
    whole = thrown(MPI.COMM_SELF, integrator)
    for _ in range(8):
        whole.advance(0.05)
    for first, second in ((comm, MPI.COMM_SELF), (MPI.COMM_SELF, comm)):
        body = thrown(first, integrator)
        for _ in range(4):
            body.advance(0.05)
        state = comm.bcast(body.state())  # a checkpoint is read by all that need it
        resumed = thrown(second, integrator)
        resumed.restore(state if second.rank == 0 else {})
        resumed.time = body.time
        for _ in range(4):
            resumed.advance(0.05)
        u, v = (comm.bcast(resumed.state() or None)[name] for name in "uv")
        exact = comm.bcast(whole.state())
        assert np.abs(u - exact["u"]).max() < 1e-8
        assert np.abs(v - exact["v"]).max() < 1e-7
        assert resumed.diagnostics()["energy"] == pytest.approx(whole.diagnostics()["energy"], abs=1e-8)


def test_a_restart_on_the_same_ranks_repeats_the_run(comm):
    """50 + 50 = 100 steps. What is restored is the same to the last bit, and so is all that follows on up to two ranks.

    From three ranks on, sums over shared nodes are taken in the order in which messages arrive: two runs never
    stopped differ by up to 6e-10 m here, so no more can be asked of a restarted one.
    """

    def made():
        return problem(
            on(comm, "box", cell_size=0.5, dimension=2),
            prescribed=HELD,
            gravity=[0, -0.3],
            integrator="bdf2",
            tolerance=1e-10,
        )

    whole, second = made(), made()
    for _ in range(50):
        whole.advance(0.05)
    second.restore(whole.state())
    second.time = whole.time
    for name in ("u", "v", "u_old", "v_old", "dt_old"):
        assert np.array_equal(getattr(second.motion, name), getattr(whole.motion, name)), name
    for body in (whole, second):
        for _ in range(50):
            body.advance(0.05)
    accuracy = 0.0 if comm.size <= 2 else 1e-8
    assert np.abs(second.motion.u - whole.motion.u).max(initial=0) <= accuracy
    assert np.abs(second.motion.v - whole.motion.v).max(initial=0) <= 10 * accuracy
