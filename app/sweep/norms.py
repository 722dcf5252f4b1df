"""How far a run is from its reference."""

from __future__ import annotations

import csv
import math
from collections.abc import Callable, Mapping
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..results import FRAMES, HISTORY, PREDICTIONS, read_table
from .model import ErrorMeasure

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Shares = Mapping[tuple[Any, Any, Any], float]  # of event, first, second

FRONT = 0.99  # of the mass


def comparison(measure: ErrorMeasure, reference: Path | float) -> Callable[[Path], float]:
    """Return the function that tells the relative error of the run in a results folder.

    Parameters
    ----------
    reference : pathlib.Path or float
        Results folder of the reference, or the exact value of the diagnostic.

    Raises
    ------
    ValueError
        If the results, those of the reference or later those of a run, do not hold what is to be compared.
    """
    if measure.diagnostic is not None:
        name = measure.diagnostic
        there = reference if isinstance(reference, float) else float(_column(reference, name)[-1])
        return lambda run: abs(float(_column(run, name)[-1]) - there) / abs(there)
    assert isinstance(reference, Path)
    if measure.history is not None:
        column, known = measure.history, _history(reference, measure.history)
        return lambda run: of_histories(_history(run, column), known)
    if measure.field is not None:
        field, at = measure.field, Interpolated(*_field(reference, measure.field))
        return lambda run: of_fields(*_field(run, field), at)
    if measure.front is not None:
        axis = "xyz".index(measure.front)
        there = front(*_particles(reference), axis)
        return lambda run: abs(front(*_particles(run), axis) - there) / abs(there)
    if measure.predictions is not None:
        column, shares = measure.predictions, _predictions(reference, measure.predictions)
        return lambda run: of_shares(_predictions(run, column), shares)
    assert measure.density is not None
    cell, particles = measure.density, _particles(reference)
    return lambda run: of_densities(_particles(run), particles, cell)


def of_histories(run: tuple[NDArray, NDArray], reference: tuple[NDArray, NDArray]) -> float:
    """sqrt(∫ (q - q_ref)² dt / ∫ q_ref² dt) by the trapezium rule; each is (times, values).

    Both are joined by straight lines, at the times of either.
    """
    times = np.union1d(run[0], reference[0])
    times = times[times <= min(run[0][-1], reference[0][-1]) * (1 + 1e-12)]
    there = np.interp(times, *reference)
    return math.sqrt(_integral((np.interp(times, *run) - there) ** 2, times) / _integral(there**2, times))


def _integral(values: NDArray, times: NDArray) -> float:
    return float(((values[1:] + values[:-1]) / 2 * np.diff(times)).sum())


def of_fields(points: NDArray, values: NDArray, reference: Interpolated) -> float:
    """Root mean square over the points (n, 3) of u - u_ref, relative to that of u_ref."""
    there = reference(points)
    return float(np.sqrt(((values - there) ** 2).sum() / (there**2).sum()))


class Interpolated:
    """A field known at points, linear between them; at the very same points it is not touched.

    Parameters
    ----------
    points : NDArray, shape (n, 3) [m]
    values : NDArray, shape (n, k)
    """

    def __init__(self, points: NDArray, values: NDArray) -> None:
        self.points, self.values = points, values
        extent = np.ptp(points, axis=0)
        self._same = 1e-12 * extent.max()
        self._used = extent > 0  # a plane body has z = 0

    @cached_property
    def _inside(self) -> Any:
        from scipy.interpolate import LinearNDInterpolator

        return LinearNDInterpolator(self.points[:, self._used], self.values)

    def __call__(self, points: NDArray) -> NDArray:
        """Values at points (m, 3); outside of the hull those of the nearest known point."""
        if points.shape == self.points.shape and np.allclose(points, self.points, rtol=0, atol=self._same):
            return self.values
        wanted = points[:, self._used]
        found: NDArray = self._inside(wanted)
        outside = np.isnan(found).any(axis=1)
        if outside.any():
            from scipy.interpolate import NearestNDInterpolator

            found[outside] = NearestNDInterpolator(self.points[:, self._used], self.values)(wanted[outside])
        return found


def of_densities(run: tuple[NDArray, NDArray], reference: tuple[NDArray, NDArray], cell: float) -> float:
    """Sum over cells of |m - m_ref| over the mass; each is (positions, masses)."""
    low = np.floor(np.minimum(run[0].min(axis=0), reference[0].min(axis=0)) / cell)
    index = [np.floor(x / cell - low).astype(np.int64) for x, _ in (run, reference)]
    shape = tuple(np.maximum(index[0].max(axis=0), index[1].max(axis=0)) + 1)
    size = int(np.prod(shape))
    here, there = (
        np.bincount(np.ravel_multi_index(tuple(i.T), shape), m, minlength=size)
        for i, (_, m) in zip(index, (run, reference))
    )
    return float(np.abs(here - there).sum() / there.sum())


def front(positions: NDArray, masses: NDArray, axis: int) -> float:
    """Coordinate [m] below which FRONT of the mass lies."""
    order = np.argsort(positions[:, axis])
    below = np.cumsum(masses[order])
    return float(positions[order[np.searchsorted(below, FRONT * below[-1])], axis])


def of_shares(run: Shares, reference: Shares) -> float:
    """Total variation ½ Σ |p - p_ref| between the shares of an event's pairs, mean over the events."""
    missed = sum(abs(run.get(key, 0.0) - reference.get(key, 0.0)) for key in run.keys() | reference.keys())
    return 0.5 * missed / len({event for event, _, _ in reference})


def _predictions(folder: Path, column: str) -> Shares:
    with open(folder / PREDICTIONS, newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    if not rows or column not in rows[0]:
        raise ValueError(f"{PREDICTIONS} has no column {column}")
    return {(row["event"], row["first"], row["second"]): float(row[column]) for row in rows}


def _history(folder: Path, name: str) -> tuple[NDArray, NDArray]:
    return _column(folder, "time"), _column(folder, name)


def _column(folder: Path, name: str) -> NDArray:
    columns, rows = read_table(folder / HISTORY)
    if name not in columns:
        raise ValueError(f"{HISTORY} has no column {name}")
    return np.array([row[name] for row in rows])


def _field(folder: Path, name: str) -> tuple[NDArray, NDArray]:
    import meshio

    frames = sorted((folder / FRAMES).glob("frame_*.vtu"))
    if not frames:
        raise ValueError("there are no fields")
    mesh = meshio.read(frames[-1])
    if name not in mesh.point_data:
        raise ValueError(f"{frames[-1].name} has no field {name}")
    return mesh.points, mesh.point_data[name]


def _particles(folder: Path) -> tuple[NDArray, NDArray]:
    from .. import checkpoint

    state = checkpoint.newest(folder)[0].state
    return state["position"], state["mass"]
