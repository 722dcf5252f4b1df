"""Fields for pictures: what an element is like, in the order of the mesh as it was given."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from dolfinx import fem
from numpy.typing import NDArray

if TYPE_CHECKING:
    from .problem import ElasticProblem

_LEAST_J = 1e-3  # Cauchy stress grows without bound where an element is flat


def von_mises(stress: NDArray, gradient: NDArray, J: NDArray) -> NDArray:
    """Von Mises equivalent of the Cauchy stress P Fᵀ/J [Pa], with |J| at least 1e-3; in 2D of its in-plane part.

    Parameters
    ----------
    stress, gradient : (n, d, d)
        P [Pa] and F.
    J : (n,)
    """
    d = stress.shape[1]
    cauchy = stress @ gradient.transpose(0, 2, 1) / np.maximum(np.abs(J), _LEAST_J)[:, None, None]
    if d == 2:
        a, b, c = cauchy[:, 0, 0], cauchy[:, 1, 1], cauchy[:, 0, 1]
        return np.sqrt(np.maximum(a * a - a * b + b * b + 3 * c * c, 0))
    deviator = cauchy - np.trace(cauchy, axis1=1, axis2=2)[:, None, None] / 3 * np.eye(3)
    return np.sqrt(1.5 * np.einsum("nij,nij->n", deviator, deviator))


def fields(problem: ElasticProblem, names: Sequence[str] | None) -> tuple[dict, dict] | None:
    """Point data and cell data of `problem` on rank 0; None elsewhere.

    The displacement is that of the solver's present iterate, so that a recovery can be watched.
    """
    space, laws = problem.space, problem.laws
    d, root = space.dimension, problem.comm.rank == 0

    def wanted(name: str) -> bool:
        return names is None or name in names

    def padded(function: fem.Function) -> NDArray | None:
        values = space.gather_nodes(function)
        return None if values is None else np.pad(values, ((0, 0), (0, 3 - d)))

    points = {"displacement": padded(space.u)}
    if problem.is_dynamic and wanted("velocity"):
        velocity = fem.Function(space.vectors)
        velocity.x.array[:] = problem.motion.v
        points["velocity"] = padded(velocity)

    laws.update(energy=True, stress=wanted("von_mises"))
    stretches = laws.stretches()
    J = stretches.prod(axis=1)
    per_cell = space.point_of  # (cells, points per cell)
    regions = np.empty(space.cells)
    regions[space.domain.regions.indices] = space.domain.regions.values
    cells: dict[str, NDArray] = {
        "J": J[per_cell].min(axis=1),
        "smallest_stretch": stretches[:, -1][per_cell].min(axis=1),
        "inverted": (J[per_cell].min(axis=1) < 0).astype(float),
        "energy_density": laws.energy.x.array[per_cell].mean(axis=1),
        "region": regions,
    }
    if wanted("von_mises"):
        F = laws.gradient.reshape(-1, d, d) + np.eye(d)
        stress = laws.stress.x.array.reshape(-1, d, d)
        cells["von_mises"] = von_mises(stress, F, J)[per_cell].max(axis=1)
    gathered = {name: space.gather_cells(values) for name, values in cells.items() if wanted(name)}
    return (points, gathered) if root else None
