"""What snow and a body give each other in a collision: momentum of the one for that of the other, and no energy."""

import numpy as np
import pytest
from mpi4py import MPI
from numpy.typing import NDArray

from extremal.mpm.exchange import Exchange
from extremal.obstacles.colliders import Contact, Rigid
from extremal.obstacles.facets import Facets
from extremal.obstacles.shapes import HalfSpace

# a square plate, two triangles on either side, that faces along z
CORNERS = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0.5, 0.5, -0.2]], dtype=float)
PLATE = np.array([[0, 1, 2], [0, 2, 3], [0, 4, 1], [1, 4, 2], [2, 4, 3], [3, 4, 0]])


def stiff(masses: NDArray, stiffness: float) -> NDArray:
    """Mobility of masses joined by springs of which a step [1] has taken the load: (m + K)⁻¹."""
    count = len(masses)
    return np.linalg.inv(np.diag(masses) + stiffness * (count * np.eye(count) - np.ones((count, count))))


def snow(count: int = 40, below: float = 0.05) -> tuple[NDArray, NDArray, NDArray]:
    """Points just inside of the plate, their velocities towards it, and masses that differ a hundredfold."""
    random = np.random.default_rng(3)
    x = np.column_stack([random.uniform(0.35, 0.65, (count, 2)), random.uniform(-below, 0, count)])
    v = random.normal(0, 1, (count, 3)) - [0, 0, 5]
    return x, v, 10 ** random.uniform(-2, 0, count)


def collide(
    contact: Contact, masses: NDArray, stiffness: float, rigid: tuple[Rigid, ...] = ()
) -> tuple[Exchange, NDArray, NDArray, NDArray, NDArray]:
    """The exchange, masses of the snow, its velocities before and after, and those of the body after."""
    x, v, m = snow()
    mobility = stiff(masses, stiffness)
    exchange = Exchange(MPI.COMM_SELF, contact)
    exchange.place(Facets(CORNERS, PLATE), np.zeros((5, 3)), masses, lambda impulse: mobility @ impulse)
    after, *_ = exchange.collide(rigid, x, v, m, 0.0)
    return exchange, m, v, after, mobility @ exchange.impulse


@pytest.mark.parametrize("contact", [Contact(), Contact(friction=0.4), Contact(sticky=True)], ids=str)
@pytest.mark.parametrize("stiffness", [0.0, 1e3])
@pytest.mark.parametrize("mass", [1e-3, 1.0, 1e3])
def test_momentum_passes_over_whole_and_energy_is_lost(contact: Contact, stiffness: float, mass: float) -> None:
    masses = np.full(5, mass)
    exchange, m, before, after, body = collide(contact, masses, stiffness)
    assert m @ (before - after) == pytest.approx(exchange.impulse.sum(axis=0), abs=1e-12)
    kinetic = 0.5 * m @ (before**2 - after**2).sum(axis=1)
    # what a stiff body does not move by has gone into its springs: half its impulse times its velocity
    gained = 0.5 * float((exchange.impulse * body).sum())
    assert 0 < gained < kinetic


@pytest.mark.parametrize("mass", [1e-3, 1.0, 1e3])
def test_snow_that_sticks_goes_on_with_the_body_as_one_mass(mass: float) -> None:
    """As in an inelastic collision, however stiff the body; it must not turn, so it stays so to the sweeps' 1e-3."""
    masses = np.full(5, mass)
    x, v, m = snow()
    x[:, :2] = 0.5
    v[:] = [0, 0, -5]
    rigid = np.ones((5, 5)) / masses.sum()
    exchange = Exchange(MPI.COMM_SELF, Contact(sticky=True))
    exchange.place(Facets(CORNERS, PLATE), np.zeros((5, 3)), masses, lambda impulse: rigid @ impulse)
    after, *_ = exchange.collide((), x, v, m, 0.0)
    common = m @ v / (m.sum() + masses.sum())
    assert after == pytest.approx(np.tile(common, (len(m), 1)), abs=5e-3 * 5)


def test_a_body_that_is_held_acts_as_a_rigid_collider() -> None:
    x, v, m = snow()
    exchange = Exchange(MPI.COMM_SELF, Contact(friction=0.3))
    nothing = np.zeros((5, 3))
    exchange.place(Facets(CORNERS, PLATE), nothing, np.full(5, np.inf), lambda impulse: nothing)
    after, free, attached = exchange.collide((), x, v, m, 0.0)
    rigid = Exchange(MPI.COMM_SELF, Contact())
    rigid.place(Facets(CORNERS + 10, PLATE), nothing, np.full(5, np.inf), lambda impulse: nothing)
    wall = Rigid(HalfSpace((0, 0, 0), (0, 0, 1)), Contact(friction=0.3))
    expected, *_ = rigid.collide((wall,), x, v, m, 0.0)
    assert after == pytest.approx(expected, abs=1e-12)
    assert not free.any() and not attached.any()


def test_what_leaves_the_body_is_let_go() -> None:
    x, v, m = snow()
    exchange = Exchange(MPI.COMM_SELF, Contact(friction=0.3))
    exchange.place(Facets(CORNERS, PLATE), np.zeros((5, 3)), np.ones(5), lambda impulse: impulse)
    after, free, attached = exchange.collide((), x, np.abs(v), m, 0.0)
    assert np.array_equal(after, np.abs(v)) and free.all() and not attached.any() and not exchange.impulse.any()


def test_rigid_colliders_have_the_last_word_and_their_impulse_is_counted() -> None:
    wall = Rigid(HalfSpace((0, 0, -0.02), (0, 0, 1)), Contact(sticky=True))
    exchange, m, before, after, _ = collide(Contact(), np.ones(5), 0.0, (wall,))
    x, *_ = snow()
    assert not after[x[:, 2] < -0.02].any()
    assert m @ (after - before) == pytest.approx(exchange.outside - exchange.impulse.sum(axis=0), abs=1e-12)
