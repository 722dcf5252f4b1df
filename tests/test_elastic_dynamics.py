"""Time integration against exact laws and against a reference that knows nothing of our schemes."""

from collections.abc import Callable

import numpy as np
import pytest
from elastic_bodies import DIRECT, material, on, petsc_options, problem, slope
from mpi4py import MPI
from petsc4py import PETSc
from scipy.integrate import solve_ivp
from scipy.linalg import eigh

from extremal.forms import Prescribed, StepFailure

END = 1.0  # s
# |F| far below what the energy, a number of 16 digits, can tell: Newton without line search
FULL_STEPS = {**DIRECT, "snes_linesearch_type": "basic"}
COUNTS = {1: (64, 128, 256), 2: (32, 64, 128)}  # steps for schemes of that order
ORDERS = {"backward_euler": 1, "bdf2": 2, "midpoint": 2, "newmark": 2}


@pytest.fixture(autouse=True)
def full_steps():
    with petsc_options(**FULL_STEPS):
        yield


def pulled(comm, integrator, **how):
    """A square metre, held at the left, pulled and pushed at the right; it starts moving."""
    domain = on(comm, "box", cell_size=0.5, dimension=2, structured=True)
    how = {"tolerance": 1e-10, "exact_tangent": True} | how
    body = problem(
        domain,
        material(2, 0.3),
        integrator=integrator,
        prescribed=[Prescribed(boundary=("left",))],
        tractions=[
            (("right",), lambda x, t: np.column_stack([0.3 * np.cos(3 * t) + 0 * x[:, 0], 0.2 * x[:, 1]]))
        ],
        gravity=(0.0, -0.3),
        **how,
    )
    body.start(velocity=lambda x: np.column_stack([0.2 * x[:, 1] * x[:, 0], -0.3 * x[:, 0]]))
    return body


def dense(matrix):
    made = matrix.convert("dense", out=PETSc.Mat())
    return made.getDenseArray().copy()  # a view would not keep the matrix alive


def dense_mass(body):
    return dense(body.equations.mass)


def reference(body, damping=(0.0, 0.0)):
    """Displacement at `END` from an explicit method of order 8 on the same mesh (serial)."""
    mass, free = dense_mass(body), np.setdiff1d(np.arange(body.equations.owned), body.constraints.dofs)
    inverse = np.linalg.inv(mass[np.ix_(free, free)])
    x, out = body.equations.vector.duplicate(), body.equations.vector.duplicate()

    def rate(t, y):
        u, v = y[: len(free)], y[len(free) :]
        body.equations.set_time(t)
        x.array[:] = 0
        x.array[free] = u
        body.equations.residual(x, out)
        return np.concatenate([v, -inverse @ out.array[free] - damping[0] * v])

    start = np.concatenate([body.motion.u[free], body.motion.v[free]])
    solution = solve_ivp(rate, (0, END), start, method="DOP853", rtol=1e-10, atol=1e-12)
    u = np.zeros(body.equations.owned)
    u[free] = solution.y[: len(free), -1]
    return u


def run(body, steps):
    for dt in steps:
        body.advance(dt)
    assert body.time == pytest.approx(END)
    return body.motion.u


def even(n):
    return np.full(n, END / n)


def uneven(n):
    """n steps whose lengths alternate as 2 : 1."""
    steps = np.tile([2.0, 1.0], n // 2)
    return END * steps / steps.sum()


@pytest.mark.parametrize("steps_of", [even, uneven], ids=["even", "uneven"])
@pytest.mark.parametrize("integrator", ORDERS)
def test_displacement_converges_in_time_with_the_order_of_the_scheme(integrator, steps_of: Callable):
    exact = reference(pulled(MPI.COMM_SELF, integrator))
    counts = COUNTS[ORDERS[integrator]]
    errors = [np.abs(run(pulled(MPI.COMM_SELF, integrator), steps_of(n)) - exact).max() for n in counts]
    assert slope([1 / n for n in counts], errors) > ORDERS[integrator] - 0.1
    assert errors[-1] < (1e-2 if ORDERS[integrator] == 1 else 1e-3)


@pytest.mark.parametrize("integrator", ORDERS)
def test_mass_damping_converges_in_time_too(integrator):
    exact = reference(pulled(MPI.COMM_SELF, integrator), damping=(1.5, 0.0))
    counts = COUNTS[ORDERS[integrator]]
    made = [pulled(MPI.COMM_SELF, integrator, damping=(1.5, 0.0)) for _ in counts]
    errors = [np.abs(run(body, even(n)) - exact).max() for body, n in zip(made, counts)]
    assert slope([1 / n for n in counts], errors) > ORDERS[integrator] - 0.1


def free_body(integrator, **how):
    """A cube that flies, turns and swings."""
    domain = on(MPI.COMM_SELF, "box", cell_size=0.5, structured=True)
    body = problem(
        domain, material(3, 0.3), integrator=integrator, tolerance=1e-11, exact_tangent=True, **how
    )

    def velocity(x):
        turning = np.cross([0.3, -0.2, 0.5], x - 0.5)
        return (
            [0.1, 0.2, -0.3] + turning + 0.3 * np.column_stack([x[:, 0] * x[:, 1], -(x[:, 2] ** 2), x[:, 1]])
        )

    body.start(velocity=velocity)
    return body


def momenta(body):
    """Linear [kg m/s] and angular [kg m²/s] momentum."""
    momentum = (dense_mass(body) @ body.motion.v).reshape(-1, 3)
    positions = body.space.positions + body.motion.u.reshape(-1, 3)
    return np.concatenate([momentum.sum(axis=0), np.cross(positions, momentum).sum(axis=0)])


def test_midpoint_keeps_linear_and_angular_momentum_of_a_free_body():
    body = free_body("midpoint")
    before = momenta(body)
    for _ in range(20):
        body.advance(0.2)
    assert np.abs(body.motion.u).max() > 1  # it has flown and turned
    assert momenta(body) == pytest.approx(before, abs=1e-10)


def test_newmark_keeps_linear_momentum():
    body = free_body("newmark")
    before = momenta(body)
    for _ in range(20):
        body.advance(0.2)
    assert momenta(body)[:3] == pytest.approx(before[:3], abs=1e-10)


@pytest.mark.parametrize(
    "integrator, drift",
    [
        ("backward_euler", (-0.9, -0.2)),
        ("bdf2", (-0.3, -0.01)),
        ("midpoint", (-0.02, 0.02)),
        ("newmark", (-0.02, 0.02)),
    ],
)
def test_energy_of_a_free_body_drifts_no_more_than_stated(integrator, drift):
    """Part of the energy of swinging, 100 steps of about a thirtieth of the slowest period."""
    body = free_body(integrator)
    energy = [body.diagnostics()["energy"]]
    for _ in range(100):
        body.advance(0.1)
        energy.append(body.diagnostics()["energy"])
    change = (np.array(energy) - energy[0]) / energy[0]

    assert drift[0] < change.min() and change.max() < max(drift[1], 1e-9)
    if integrator == "backward_euler":
        assert np.all(np.diff(energy) < 0)


def slowest_mode(body):
    """Angular frequency [1/s] and shape of the slowest mode about rest, of unit mass."""
    x = body.equations.vector.duplicate()
    body.equations.tangent(x, body.equations.matrix, False)
    stiffness = dense(body.equations.matrix) - dense_mass(
        body
    )  # before the first step inertia has the factor 1
    free = np.setdiff1d(np.arange(body.equations.owned), body.constraints.dofs)
    squares, shapes = eigh(stiffness[np.ix_(free, free)], dense_mass(body)[np.ix_(free, free)])
    shape = np.zeros(body.equations.owned)
    shape[free] = shapes[:, 0]
    return np.sqrt(squares[0]), shape


@pytest.mark.parametrize("share", [1.0, 0.0, 0.5], ids=["mass", "stiffness", "both"])
@pytest.mark.parametrize("integrator", ["bdf2", "midpoint", "newmark"])
def test_rayleigh_damping_slows_a_small_swing_at_the_exact_rate(integrator, share):
    """q(t) = sin(ω' t)/ω' exp(-δ t) with 2δ = a + b ω² and ω'² = ω² - δ², for the amplitude q of a mode."""

    def bar(**how):
        domain = on(MPI.COMM_SELF, "bar", size=[2.0, 0.5], cell_size=0.25, dimension=2, structured=True)
        held = [Prescribed(boundary=("left",))]
        return problem(
            domain, integrator=integrator, prescribed=held, tolerance=1e-14, exact_tangent=True, **how
        )

    frequency, shape = slowest_mode(bar())
    rate = 0.1 * frequency
    body = bar(damping=(2 * share * rate, 2 * (1 - share) * rate / frequency**2))
    body.start(velocity=lambda x: 1e-6 * shape.reshape(-1, 2))
    damped = np.sqrt(frequency**2 - rate**2)
    n, end = 300, 2.25 * np.pi / damped
    for _ in range(n):
        body.advance(end / n)
    exact = np.sin(damped * end) / damped * np.exp(-rate * end)
    amplitude = shape @ dense_mass(body) @ body.motion.u / 1e-6
    assert amplitude == pytest.approx(exact, rel=2e-3)
    assert amplitude != pytest.approx(np.sin(frequency * end) / frequency, rel=0.3)


@pytest.mark.parametrize("integrator", ORDERS)
def test_a_step_whose_local_error_is_too_large_is_refused(integrator):
    body = pulled(MPI.COMM_SELF, integrator, error_tolerance=1e-3)
    before = body.motion
    with pytest.raises(
        StepFailure, match=r"^local error \S+ m is above error_tolerance = 0.001 m$"
    ) as failure:
        body.advance(0.5)
    assert body.motion is before and body.time == 0
    assert 0 < failure.value.wanted_step < 0.5
    assert body.advance(0.01)["wanted_step"] > 0.01


def one_node(integrator, motion):
    """A triangle whose corners all follow `motion`: what a scheme makes of the boundary."""
    body = problem(
        on(MPI.COMM_SELF, "triangle"),
        integrator=integrator,
        prescribed=[Prescribed(boundary=("surface",), motion=motion)],
    )
    for _ in range(20):
        body.advance(0.05)
    return body


@pytest.mark.parametrize("integrator", ORDERS)
def test_a_boundary_that_starts_at_speed_keeps_it(integrator):
    body = one_node(integrator, lambda x, t: np.full_like(x, 0.3 * t))
    assert body.motion.v == pytest.approx(np.full(6, 0.3), rel=1e-6)


@pytest.mark.parametrize("integrator", ["bdf2", "midpoint", "newmark"])
def test_an_accelerated_boundary_has_the_velocity_of_its_motion(integrator):
    body = one_node(integrator, lambda x, t: np.full_like(x, np.sin(3 * t)))
    assert body.motion.v == pytest.approx(np.full(6, 3 * np.cos(3.0)), rel=1e-2)
