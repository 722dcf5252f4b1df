"""Where a picture is seen from."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from extremal.obstacles.colliders import Collider

ELEVATION = 16.0  # of the eye [degrees]
AZIMUTHS = (-62.0, -118.0, -28.0, -152.0, 62.0, 118.0)  # where the eye may be, the first the best [degrees]
MARGIN = 0.93  # part of the picture that is filled
OPENING = 0.45  # half the picture's height over the distance from the eye


@dataclass(frozen=True)
class View:
    """Where the eye is, and its axes: right, away from it, up (rows of `axes`)."""

    eye: NDArray[Any]
    axes: NDArray[Any]
    middle: NDArray[Any]
    reach: float  # radius of what is looked at [m]


def choose_view(
    bounds: NDArray[Any],
    colliders: Sequence[Collider],
    times: Sequence[float],
    up: NDArray[Any],
    aspect: float,
    direction: tuple[float, float] | None = None,
) -> View:
    """Return a view of all between `bounds` (2, 3) [m] with the eye outside of every obstacle and nothing between.

    Parameters
    ----------
    times : sequence of float
        At which nothing shall be between [s].
    aspect : float
        Width of the picture over its height.
    direction : (float, float), optional
        Azimuth and elevation [degrees], where they are not to be chosen.
    """
    if direction is not None:
        return view_from(*direction, bounds, up, aspect)
    views = [view_from(azimuth, ELEVATION, bounds, up, aspect) for azimuth in AZIMUTHS]
    for view in views:
        line = view.eye + np.linspace(0.0, 0.75, 60)[:, None] * (view.middle - view.eye)
        if all(np.all(collider.distance(line, time) > 0) for collider in colliders for time in times):
            return view
    return views[0]


def view_from(azimuth: float, elevation: float, bounds: NDArray[Any], up: NDArray[Any], aspect: float) -> View:
    """Return the view from a direction of all between `bounds` (2, 3) [m].

    Parameters
    ----------
    azimuth, elevation : float
        Of the eye, around `up` from the x axis, and above the horizon [degrees].
    up : (3,)
        Of unit length.
    aspect : float
        Width of the picture over its height.
    """
    a, e = np.deg2rad(azimuth), np.deg2rad(elevation)
    first = np.array([1.0, 0.0, 0.0]) if abs(up[0]) < 0.7 else np.array([0.0, 1.0, 0.0])
    x = first - (first @ up) * up
    x /= np.linalg.norm(x)
    back = np.cos(e) * (np.cos(a) * x + np.sin(a) * np.cross(up, x)) + np.sin(e) * up
    right = np.cross(up, back)
    right /= np.linalg.norm(right)
    axes = np.array([right, -back, np.cross(back, right)])

    middle = bounds.mean(axis=0)
    reach = max(0.5 * float(np.linalg.norm(bounds[1] - bounds[0])), 1e-9)
    corners = (np.array(list(product(*bounds.T))) - middle) @ axes.T
    half = MARGIN * OPENING * np.array([aspect, 1.0])
    shift, distance = np.zeros(2), 2.0 * reach
    for _ in range(20):  # the corners' picture is centred, and as large as fits
        depth = distance + corners[:, 1]
        seen = (corners[:, [0, 2]] - shift) / depth[:, None]
        shift += 0.5 * (seen.max(axis=0) + seen.min(axis=0)) * distance
        nearest = np.abs(corners[:, [0, 2]] - shift) / half - corners[:, 1:2]
        distance = max(float(nearest.max()), 0.3 * reach - float(corners[:, 1].min()))
    eye = middle + shift @ axes[[0, 2]] + distance * back
    return View(eye, axes, middle, reach)
