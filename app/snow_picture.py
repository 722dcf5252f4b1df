"""A picture of snow: particles as small balls in the light of a low sun, and what they collide with.

Light is attenuated along straight lines through the particles' density, so that snow shades itself and throws
shadows; what the sky sends is kept from where snow is thick around. Obstacles are found by following rays through
their level sets. NumPy alone: a picture of 300,000 particles takes a few seconds.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy import ndimage

from .view import OPENING, View

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from extremal.obstacles.colliders import Collider

SKY_LOW, SKY_HIGH = np.array([0.17, 0.27, 0.43]), np.array([0.015, 0.03, 0.08])
SUN, AMBIENT = np.array([1.0, 0.96, 0.88]), np.array([0.30, 0.38, 0.52])
STONE = np.array([0.27, 0.31, 0.37])
# towards the sun, relative to right, away from the eye and up
LIGHT = np.array([-0.55, -0.25, 0.80])
SOLIDITY = 0.55  # optical depth of a cell of the light's grid full of snow
FINER = 2  # pixels computed for each one shown, in each direction
RAY_STEPS = 70
LARGEST_BALL = 16.0  # radius of a particle in pixels


def draw_space(
    points: NDArray[Any],
    spacing: float,
    colliders: Sequence[Collider],
    time: float,
    view: View,
    size: tuple[int, int],
) -> NDArray[Any]:
    """Draw particles in space.

    Parameters
    ----------
    points : (n, 3) [m]
    spacing : float
        Mean distance of particles at rest [m].
    colliders : sequence of Collider
        As they are at `time` [s].
    size : (int, int)
        Width and height in pixels.

    Returns
    -------
    (height, width, 3) colours from 0 to 1
    """
    width, height = FINER * size[0], FINER * size[1]
    focal = 0.5 * height / OPENING
    sun = LIGHT @ view.axes
    sun /= np.linalg.norm(sun)
    shade = _Shade(points, spacing, sun)
    image, depth = _obstacles(colliders, time, view, size, shade)
    image, depth = (np.repeat(np.repeat(a, FINER, axis=0), FINER, axis=1) for a in (image, depth))

    local = (points - view.eye) @ view.axes.T
    seen = local[:, 1] > 0.05 * view.reach
    local, colours = local[seen], shade.snow(points)[seen]
    x = focal * local[:, 0] / local[:, 1] + width / 2
    y = height / 2 - focal * local[:, 2] / local[:, 1]
    radius = 0.62 * spacing * focal / float(np.median(local[:, 1])) if len(local) else 1.0
    _splat(image.reshape(-1, 3), depth.reshape(-1), (width, height), x, y, local[:, 1], colours, radius, spacing)
    shown = image.reshape(size[1], FINER, size[0], FINER, 3).mean(axis=(1, 3))
    return np.clip(shown, 0.0, 1.0) ** (1 / 1.6)


def _splat(
    image: NDArray[Any],
    depth: NDArray[Any],
    size: tuple[int, int],
    x: NDArray[Any],
    y: NDArray[Any],
    z: NDArray[Any],
    colours: NDArray[Any],
    radius: float,
    spacing: float,
) -> None:
    """Draw balls of `radius` pixels, the nearest in each pixel, into the flat `image` and `depth`."""
    width, height = size
    radius = float(np.clip(radius, 0.9, LARGEST_BALL))
    reach = int(np.ceil(radius))
    i, j = np.floor(x).astype(np.int64), np.floor(y).astype(np.int64)
    steps = [
        (a, b, 1 - (a * a + b * b) / radius**2)
        for a in range(-reach, reach + 1)
        for b in range(-reach, reach + 1)
        if a * a + b * b < radius**2 or a == b == 0
    ]
    # nearer parts are written later: of repeated indices NumPy keeps the last
    order = np.argsort(-z)
    last = np.full(len(depth), -1)
    owner = np.full(len(depth), -1)
    for a, b, bulge in steps:
        column, row = i[order] + a, j[order] + b
        inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
        which, pixel = order[inside], (row * width + column)[inside]
        last[pixel] = which
        first = last[pixel] == which
        which, pixel = which[first], pixel[first]
        front = z[which] - 0.6 * spacing * np.sqrt(max(bulge, 0.0))
        better = front < depth[pixel]
        depth[pixel[better]], owner[pixel[better]] = front[better], which[better]
    drawn = np.flatnonzero(owner >= 0)
    image[drawn] = colours[owner[drawn]]


class _Shade:
    """How bright snow, and what lies in its shadow, is."""

    def __init__(self, points: NDArray[Any], spacing: float, sun: NDArray[Any]) -> None:
        self.sun = sun
        first = np.eye(3)[np.argmin(np.abs(sun))]
        u = np.cross(sun, first)
        u /= np.linalg.norm(u)
        self.axes = np.array([u, np.cross(sun, u), -sun])  # the last along the light
        self.cell = 1.6 * spacing
        full = (self.cell / spacing) ** 3
        place = points @ self.axes.T / self.cell
        self.low = np.floor(place.min(axis=0)) - 2
        density = _counts(place - self.low) / full
        # what is in front of the middle of each cell
        self.depth = ndimage.gaussian_filter(np.cumsum(density, axis=2) - 0.5 * density, (0.7, 0.7, 0))
        world = points / self.cell
        self.world_low = np.floor(world.min(axis=0)) - 4
        smooth = ndimage.gaussian_filter(np.pad(_counts(world - self.world_low) / full, 2), 1.0)
        self.around = ndimage.gaussian_filter(smooth, 3.0)
        self.slope = np.stack(np.gradient(ndimage.gaussian_filter(smooth, 0.8)))

    def light(self, x: NDArray[Any], snow: bool) -> NDArray[Any]:
        """Share of the sun's light that reaches points x (n, 3)."""
        place = x @ self.axes.T / self.cell - self.low - 0.5
        if snow:
            place[:, 2] -= 0.8  # a particle does not stand in its own shadow
        beyond = place[:, 2] > self.depth.shape[2] - 1
        place[beyond, 2] = self.depth.shape[2] - 1
        tau = ndimage.map_coordinates(self.depth, place.T, order=1, mode="constant", cval=0.0)
        return np.exp(-SOLIDITY * np.where(tau > 0, tau, 0.0))

    def snow(self, x: NDArray[Any]) -> NDArray[Any]:
        """Colours (n, 3) of snow."""
        place = (x / self.cell - self.world_low - 0.5 + 2).T
        normal = -np.stack([ndimage.map_coordinates(part, place, order=1, mode="nearest") for part in self.slope])
        steepness = np.linalg.norm(normal, axis=0)
        normal /= np.maximum(steepness, 1e-12)
        facing = np.where(steepness > 0.01, np.clip(self.sun @ normal, -1, 1), 0.5)
        crowd = ndimage.map_coordinates(self.around, place + 2.0 * normal, order=1, mode="nearest")
        open_ = 1 - 0.75 * np.clip(crowd, 0, 1)
        grain = 1 + 0.05 * np.sin(12.9898 * np.arange(len(x)) ** 1.3)
        direct = self.light(x, snow=True) * (0.4 + 0.6 * np.clip(facing, 0, 1))
        return (direct[:, None] * SUN * 0.72 + open_[:, None] * AMBIENT) * grain[:, None]


def _counts(place: NDArray[Any]) -> NDArray[Any]:
    """Number of points in each unit cell of a grid that begins at 0, with room at its end."""
    cells = np.floor(place).astype(np.int64)
    shape = cells.max(axis=0) + 5
    flat = np.ravel_multi_index(tuple(cells.T), shape)
    return np.bincount(flat, minlength=int(np.prod(shape))).reshape(shape).astype(float)


def _sky(size: tuple[int, int]) -> NDArray[Any]:
    rise = np.linspace(1.0, 0.0, size[1])[:, None, None] ** 1.3
    return np.broadcast_to(SKY_LOW + rise * (SKY_HIGH - SKY_LOW), (size[1], size[0], 3)).copy()


def _obstacles(
    colliders: Sequence[Collider], time: float, view: View, size: tuple[int, int], shade: _Shade
) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return colours (h, w, 3) and depths (h, w) of the obstacles before the sky."""
    width, height = size
    image, depth = _sky(size), np.full(width * height, np.inf)
    focal = 0.5 * height / OPENING
    across = (np.arange(width) + 0.5 - width / 2) / focal
    down = (height / 2 - np.arange(height) - 0.5) / focal
    rays = np.stack(np.broadcast_arrays(across[None, :], 1.0, down[:, None]), axis=2).reshape(-1, 3) @ view.axes
    stretch = np.linalg.norm(rays, axis=1)
    rays /= stretch[:, None]
    flat, far = image.reshape(-1, 3), 30 * view.reach
    start = max(float(np.linalg.norm(view.eye - view.middle)) - 3.0 * view.reach, 0.0)
    for collider in colliders:
        if collider.distance(view.eye[None], time)[0] <= 0:
            continue  # the eye is in it: see through
        along = _follow(collider, time, view.eye, rays, start, far, 1e-3 * view.reach)
        hit = np.flatnonzero(along < far)
        hit = hit[along[hit] / stretch[hit] < depth[hit]]
        x = view.eye + along[hit, None] * rays[hit]
        normal = collider.normal(x, time)
        facing = np.clip(normal @ shade.sun, 0.0, 1.0) * shade.light(x, snow=False)
        colour = getattr(collider, "color", STONE) * (facing[:, None] * SUN * 1.1 + AMBIENT * 0.9)
        colour *= _lines(x, normal, view.reach)[:, None]
        apart = np.linalg.norm(x - view.middle, axis=1) / view.reach
        fog = np.clip((apart - 1.6) / 5.0, 0.0, 1.0)[:, None] ** 0.7
        flat[hit] = (1 - fog) * colour + fog * flat[hit]
        depth[hit] = along[hit] / stretch[hit]
    return image, depth.reshape(height, width)


def _follow(
    collider: Collider, time: float, eye: NDArray[Any], rays: NDArray[Any], start: float, far: float, close: float
) -> NDArray[Any]:
    """Length (n,) [m] of each ray up to the obstacle, infinite where it misses: steps as long as φ is large."""
    along = np.full(len(rays), start)
    going = np.arange(len(rays))
    result = np.full(len(rays), np.inf)
    for _ in range(RAY_STEPS):
        phi = collider.distance(eye + along[going, None] * rays[going], time)
        arrived = phi < close
        result[going[arrived]] = along[going[arrived]]
        along[going] += np.maximum(0.9 * phi, 0.3 * close)
        going = going[~arrived & (along[going] < far)]
        if not len(going):
            break
    return result


def _lines(x: NDArray[Any], normal: NDArray[Any], reach: float) -> NDArray[Any]:
    """A faint grid on obstacles, of round lengths, to judge sizes and slopes by."""
    raw = 0.35 * reach
    unit = 10.0 ** np.floor(np.log10(raw))
    unit *= max(factor for factor in (1, 2, 5) if factor * unit <= raw)
    near = np.abs(x / unit - np.round(x / unit)) < 0.012
    # a plane across an axis is no line
    near &= np.abs(normal) < 0.9
    return np.where(near.any(axis=1), 0.8, 1.0)


def draw_plane(
    points: NDArray[Any],
    spacing: float,
    colliders: Sequence[Collider],
    time: float,
    bounds: NDArray[Any],
    size: tuple[int, int],
) -> NDArray[Any]:
    """Draw particles of the plane, shape (n, 2) [m], between `bounds` (2, 2) [m]; colours (height, width, 3)."""
    width, height = FINER * size[0], FINER * size[1]
    scale = 0.94 * min(width / np.ptp(bounds[:, 0]), height / np.ptp(bounds[:, 1]))
    middle = bounds.mean(axis=0)
    x = (np.arange(width) + 0.5 - width / 2) / scale + middle[0]
    y = middle[1] - (np.arange(height) + 0.5 - height / 2) / scale
    image = _sky((width, height))
    grid = np.stack(np.broadcast_arrays(x[None, :], y[:, None]), axis=2).reshape(-1, 2)
    for collider in colliders:
        phi = collider.distance(grid, time).reshape(height, width)
        deep = np.exp(np.maximum(phi[phi <= 0], -1e9) * scale / 40)[:, None]
        image[phi <= 0] = getattr(collider, "color", STONE) * (AMBIENT + 0.55 * deep * SUN)
    cells = np.floor((points - points.min(axis=0)) / (1.6 * spacing)).astype(np.int64)
    filled = np.zeros(cells.max(axis=0) + 1)
    np.add.at(filled, tuple(cells.T), 1.0 / 1.6**2)
    filled = ndimage.gaussian_filter(filled, 0.8)[tuple(cells.T)]
    bright = 0.45 + 0.5 * np.clip(filled, 0, 1)
    colours = bright[:, None] * (0.75 * SUN + 0.8 * AMBIENT)
    px, py = (points[:, 0] - middle[0]) * scale + width / 2, height / 2 - (points[:, 1] - middle[1]) * scale
    flat, depth = image.reshape(-1, 3), np.full(width * height, np.inf)
    _splat(flat, depth, (width, height), px, py, 1 - bright, colours, 0.7 * spacing * scale, spacing)
    shown = flat.reshape(size[1], FINER, size[0], FINER, 3).mean(axis=(1, 3))
    return np.clip(shown, 0.0, 1.0) ** (1 / 1.6)
