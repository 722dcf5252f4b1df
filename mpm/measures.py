"""What is measured of the particles: conserved quantities, energies, and fields to look at."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

from .gradients import symmetric
from .kernel import Kernel
from .law import Law
from .particles import Particles

SAME_MASS = 1e-9  # relative; sums over other numbers of ranks differ by rounding only


class LostParticles(ArithmeticError):
    """There are fewer particles, or there is less mass, than at the start; the state is worth nothing."""


def conserved(comm: MPI.Comm, p: Particles) -> dict[str, float]:
    """Number of particles, mass [kg], momentum [kg m/s], angular momentum about the origin [kg m²/s] (collective)."""
    d = p.dimension
    x, v = (np.pad(a, ((0, 0), (0, 3 - d))) for a in (p.position, p.velocity))
    momentum = (p.mass[:, None] * p.velocity).sum(axis=0)
    angular = (p.mass[:, None] * np.cross(x, v)).sum(axis=0)
    total = _sum(comm, np.concatenate([[p.mass.sum()], momentum, angular]))
    figures = {"particles": float(comm.allreduce(len(p))), "mass": float(total[0])}
    figures |= {f"momentum_{axis}": float(m) for axis, m in zip("xyz", total[1 : d + 1], strict=False)}
    return figures | {f"angular_momentum_{axis}": float(m) for axis, m in zip("xyz", total[d + 1 :], strict=True)}


def energies(
    comm: MPI.Comm, p: Particles, kernel: Kernel, laws: NDArray, gravity: NDArray | None
) -> dict[str, float]:
    """Kinetic, elastic (7.1) and gravitational energy [J] (collective).

    Parameters
    ----------
    laws : NDArray
        `law.table`.
    gravity : (d,) or None
        [m/s²]
    """
    elastic = np.zeros(len(p))
    if comm.allreduce(bool(p.volume.all()), op=MPI.LAND):
        kernel.call("energy", len(p), p.stretch, p.plastic, p.volume, p.stiffness, p.body, laws, elastic)
    kinetic = 0.5 * (p.mass[:, None] * p.velocity**2).sum()
    weight = 0.0 if gravity is None else -(p.mass * (p.position @ gravity[: p.dimension])).sum()
    total = _sum(comm, np.array([kinetic, elastic.sum(), weight]))
    names = ("kinetic_energy", "elastic_energy", "gravitational_energy")
    return {name: float(value) for name, value in zip(names, total, strict=True)}


def shown(whole: dict[str, NDArray], laws: Sequence[Law]) -> dict[str, NDArray]:
    """Fields to look at, of the arrays of `Particles` by name: (n,), vectors (n, 3) and matrices by rows (n, 9)."""
    d = whole["position"].shape[1]
    ends = np.linalg.eigvalsh(symmetric(whole["stretch"], d))
    nominal = np.array([law.density for law in laws])[whole["body"]]  # until volumes are measured
    rest = np.where(whole["volume"] > 0, whole["volume"], whole["mass"] / nominal)
    fields = {
        "points": np.pad(whole["position"], ((0, 0), (0, 3 - d))),
        "velocity": np.pad(whole["velocity"], ((0, 0), (0, 3 - d))),
        "J_P": whole["plastic"],
        "stretch": ends[:, -1],
        "density": whole["mass"] / (rest * ends.prod(axis=1) * whole["plastic"]),
        "mass": whole["mass"],
        "body": whole["body"].astype(float),
        "stiffness": whole["stiffness"],
    }
    for name in ("elastic_gradient", "plastic_gradient"):
        if name in whole:
            matrix = np.tile(np.eye(3), (len(ends), 1, 1))  # nothing happens across the plane
            matrix[:, :d, :d] = whole[name].reshape(-1, d, d)
            fields[name] = matrix.reshape(-1, 9)
    return fields


def _sum(comm: MPI.Comm, values: NDArray) -> NDArray:
    total = values.astype(float)
    comm.Allreduce(MPI.IN_PLACE, total)
    return total
