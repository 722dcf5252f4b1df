"""How far a run is from its reference."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..results import FRAMES, HISTORY, read_table
from .model import ErrorMeasure

if TYPE_CHECKING:
    from numpy.typing import NDArray


def error_of(measure: ErrorMeasure, run: Path, reference: Path | float) -> float:
    """Relative error of a run.

    Parameters
    ----------
    run : pathlib.Path
        Results folder.
    reference : pathlib.Path or float
        Results folder of the reference, or the exact value of the diagnostic.

    Raises
    ------
    ValueError
        If the results do not hold what is to be compared.
    """
    if measure.diagnostic is not None:
        there = reference if isinstance(reference, float) else _column(reference, measure.diagnostic)[-1]
        return abs(_column(run, measure.diagnostic)[-1] - there) / abs(there)
    assert isinstance(reference, Path)
    if measure.history is not None:
        return of_histories(_history(run, measure.history), _history(reference, measure.history))
    if measure.field is not None:
        return of_fields(_field(run, measure.field), _field(reference, measure.field))
    assert measure.density is not None
    return of_densities(_particles(run), _particles(reference), measure.density)


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


def of_fields(run: tuple[NDArray, NDArray], reference: tuple[NDArray, NDArray]) -> float:
    """Root mean square over the run's points of u - u_ref, relative to that of u_ref; each is (points, values).

    The reference is interpolated linearly between its points, unless they are the same points.
    """
    points, values = run
    there = _at(points, *reference)
    return float(np.sqrt(((values - there) ** 2).sum() / (there**2).sum()))


def _at(points: NDArray, known: NDArray, values: NDArray) -> NDArray:
    if known.shape == points.shape and np.allclose(known, points, rtol=0, atol=1e-12 * np.ptp(known, axis=0).max()):
        return values
    from scipy.interpolate import LinearNDInterpolator, NearestNDInterpolator

    is_used = np.ptp(known, axis=0) > 0  # a plane body has z = 0
    known, points = known[:, is_used], points[:, is_used]
    found: NDArray = LinearNDInterpolator(known, values)(points)
    outside = np.isnan(found).any(axis=1)
    if outside.any():
        found[outside] = NearestNDInterpolator(known, values)(points[outside])
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
