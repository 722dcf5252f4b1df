"""Rigid motion by keyframes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from .conditions_scene import Keyframe


def rigid_motion(frames: Sequence[Keyframe], dimension: int) -> Callable[[NDArray, float], NDArray]:
    """Displacement of points carried by a rigid body whose placements are given at some times.

    Between keyframes the rotation vector, the translation and the centre are interpolated linearly, so that a
    rotation vector of many turns is many turns; before the first and after the last the body rests.

    Returns
    -------
    callable
        (positions (n, d) [m], time [s]) -> displacement (n, d) [m].
    """
    from scipy.spatial.transform import Rotation

    times = np.array([frame.time for frame in frames])
    turns = np.array([_rotation_vector(frame) for frame in frames])
    shifts = np.array([_vector(frame.translation) for frame in frames])
    centers = np.array([_vector(frame.center) for frame in frames])

    def at(table: NDArray, time: float) -> NDArray:
        return np.array([np.interp(time, times, column) for column in table.T])

    def displacement(x: NDArray, time: float) -> NDArray:
        arm = np.zeros((len(x), 3))
        arm[:, :dimension] = x
        arm -= at(centers, time)
        moved = Rotation.from_rotvec(at(turns, time)).apply(arm) if len(x) else arm
        return (moved - arm + at(shifts, time))[:, :dimension]

    return displacement


def _vector(value: Sequence[float] | None) -> NDArray:
    out = np.zeros(3)
    if value is not None:
        out[: len(value)] = value
    return out


def _rotation_vector(frame: Keyframe) -> NDArray:
    if frame.rotation is None:
        return np.zeros(3)
    if isinstance(frame.rotation, float):
        return np.array([0.0, 0.0, frame.rotation])
    return _vector(frame.rotation)
