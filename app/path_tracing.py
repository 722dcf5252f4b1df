"""Snow as a cloud of ice, by volume path tracing (7.8) with Mitsuba: the light of sun and sky, scattered many times."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import product
from typing import TYPE_CHECKING, Any

import numpy as np

from .errors import InputError
from .view import OPENING, View

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from .scenery import Surface

# optics of 7.8: extinction of snow at its first density [1/m], scattering albedo of red, green and blue, mean cosine
EXTINCTION = 724.0
ALBEDO = (0.9, 0.95, 1.0)
MEAN_COSINE = 0.5
# Free paths of light in a cell beyond which a longer row of them looks the same and costs time alone.
OPAQUE = 2.0
# irradiance of the sun, radiance of the sky at the zenith and at the horizon, for a camera that is balanced for snow
SUN = np.array([5.2, 3.6, 2.1])
ZENITH, HORIZON = np.array([0.22, 0.30, 0.42]), np.array([0.62, 0.66, 0.70])
# towards the sun, relative to right, away from the eye and up
LIGHT = np.array([-0.62, -0.30, 0.72])
Colour = tuple[float, float, float]
STONE: Colour = (0.095, 0.125, 0.17)
DEEPEST = 64  # scatterings of a path; what would be scattered more often is a little of the blue
BLOCK = 16  # cells along an edge of a box of snow
# What is looked at has this radius, around the origin, in Mitsuba's units. Its rays begin 1e-4 (1 + |x|) off what they
# were scattered by, so boxes stand that far apart: a ray that leaves one has to see that it enters the next.
REACH = 20.0
GAP = 2e-4 * REACH
SAMPLES_AT_ONCE = 8  # of a pixel, between two reports of progress


@dataclass(frozen=True)
class Optics:
    """How snow scatters light; `extinction` [1/m] is that at the density `reference` [kg/m3]."""

    reference: float
    extinction: float = EXTINCTION
    albedo: tuple[float, float, float] = ALBEDO
    mean_cosine: float = MEAN_COSINE


@dataclass(frozen=True)
class Cloud:
    """Density at the nodes (i, j, k) h of a grid, [0, 0, 0] of it at node `first`."""

    density: NDArray[Any]  # (n1, n2, n3) [kg/m3]
    first: NDArray[Any]  # (3,)
    h: float  # [m]


@dataclass(frozen=True)
class Scale:
    """Mitsuba's place of points [m]: what is looked at is around its origin, and not too small for it."""

    middle: NDArray[Any]  # (3,) [m]
    unit: float  # [m]

    def of(self, x: NDArray[Any]) -> NDArray[Any]:
        """Points (..., 3) in Mitsuba's units."""
        return (x - self.middle) / self.unit


def mitsuba() -> Any:
    """Return Mitsuba, set to compute in plain C++ (its LLVM mode ends the process where it does not like the LLVM).

    Raises
    ------
    InputError
        Naming the extra that provides it.
    """
    try:
        import mitsuba as mi
    except ImportError:
        raise InputError(
            "render: path tracing needs mitsuba; ./setup.sh render installs it, or pip install 'extremal[render]'; "
            "--preview does without"
        ) from None
    if mi.variant() != "scalar_rgb":
        mi.set_variant("scalar_rgb")
        mi.set_log_level(mi.LogLevel.Error)
    return mi


def trace(
    cloud: Cloud,
    optics: Optics,
    surfaces: Sequence[Surface],
    view: View,
    size: tuple[int, int],
    samples: int,
    tell: Callable[[float], None] = lambda part: None,
) -> NDArray[Any]:
    """Return colours (height, width, 3), from 0 to 1, of snow before obstacles.

    Parameters
    ----------
    size : (int, int)
        Width and height in pixels.
    samples : int
        Paths of light for each pixel.
    tell : callable
        Called with the part of the work that is done.
    """
    mi = mitsuba()
    scene = mi.load_dict(describe(mi, cloud, optics, surfaces, view, size))
    total = np.zeros((size[1], size[0], 3))
    done = 0
    while done < samples:
        count = min(SAMPLES_AT_ONCE, samples - done)
        total += count * np.array(mi.render(scene, spp=count, seed=done), dtype=float)
        done += count
        tell(done / samples)
    return developed(total / samples)


def developed(radiance: NDArray[Any]) -> NDArray[Any]:
    """Return what a screen shows: bright light bent towards 1, then the curve of sRGB."""
    bent = 1 - np.exp(-1.25 * np.maximum(radiance, 0.0))
    return np.where(bent <= 0.0031308, 12.92 * bent, 1.055 * bent ** (1 / 2.4) - 0.055)


def describe(
    mi: Any, cloud: Cloud, optics: Optics, surfaces: Sequence[Surface], view: View, size: tuple[int, int]
) -> dict[str, Any]:
    """Return the scene in Mitsuba's words."""
    _, away, up = view.axes
    scale = Scale(view.middle, view.reach / REACH)
    eye = scale.of(view.eye)
    camera = mi.ScalarTransform4f().look_at(origin=list(eye), target=list(eye + away), up=list(up))
    to_sun = LIGHT @ view.axes
    scene: dict[str, Any] = {
        "type": "scene",
        "integrator": {"type": "volpath", "max_depth": DEEPEST, "rr_depth": DEEPEST},
        "sensor": {
            "type": "perspective",
            "to_world": camera,
            "fov_axis": "y",
            "fov": float(2 * np.degrees(np.arctan(OPENING))),
            "near_clip": 1e-3 * REACH,
            "far_clip": 1e4 * REACH,
            "film": {
                "type": "hdrfilm",
                "width": size[0],
                "height": size[1],
                "pixel_format": "rgb",
                "component_format": "float32",
                "rfilter": {"type": "gaussian"},
            },
            "sampler": {"type": "independent"},
        },
        "sun": {
            "type": "directional",
            "direction": list(-to_sun),
            "irradiance": {"type": "rgb", "value": list(SUN)},
        },
        "sky": {"type": "envmap", "bitmap": _sky(mi), "to_world": _upright(mi, up, away)},
    }
    for number, surface in enumerate(surfaces):
        scene[f"obstacle_{number}"] = _obstacle(mi, surface, scale)
    if cloud.density.any():
        scene |= blocks_of(mi, cloud, optics, scale)
    return scene


def blocks_of(mi: Any, cloud: Cloud, optics: Optics, scale: Scale) -> dict[str, Any]:
    """Return the snow in Mitsuba's words: boxes of `BLOCK` cells, those without snow left out.

    Light that looks for its next scattering takes steps for the densest snow of the box it is in: in one large box
    most of them would be lost in empty space. Density is limited to where a cell is `OPAQUE`.
    """
    share = np.minimum(cloud.density / optics.reference, OPAQUE / (optics.extinction * cloud.h))
    counts = np.array(share.shape)
    # values beyond the grid are zero; each box has those around it too, to interpolate with
    counts = -(-counts // BLOCK) * BLOCK
    padded = np.zeros(counts + 2, dtype=np.float32)
    padded[tuple(slice(1, n + 1) for n in share.shape)] = share
    blocks = {}
    for corner in product(*(range(0, n, BLOCK) for n in counts)):
        values = padded[tuple(slice(c, c + BLOCK + 2) for c in corner)]
        if values.any():
            low = scale.of((cloud.first + np.array(corner) - 0.5) * cloud.h)
            name = "snow_" + "_".join(str(c) for c in corner)
            h, extinction = cloud.h / scale.unit, optics.extinction * scale.unit
            blocks[name] = _block(mi, values, low, h, extinction, optics)
    return blocks


def _block(
    mi: Any, values: NDArray[Any], low: NDArray[Any], h: float, extinction: float, optics: Optics
) -> dict[str, Any]:
    extent = BLOCK * h
    place = mi.ScalarTransform4f
    # of the texture's unit cube, whose values stand in the middles of its cells
    volume = {
        "type": "gridvolume",
        "grid": mi.VolumeGrid(np.ascontiguousarray(values.transpose(2, 1, 0)[..., None])),
        "to_world": place().translate(list(low - h)).scale(extent + 2 * h),
        "filter_type": "trilinear",
        "raw": True,
    }
    return {
        "type": "cube",
        "to_world": place().translate(list(low + extent / 2)).scale(0.5 * extent - GAP),
        "bsdf": {"type": "null"},
        "interior": {
            "type": "heterogeneous",
            "sigma_t": volume,
            "scale": float(extinction),
            "albedo": {"type": "rgb", "value": list(optics.albedo)},
            "phase": {"type": "hg", "g": float(optics.mean_cosine)},
        },
    }


def _sky(mi: Any) -> Any:
    """A map of the sky, the zenith in its first row; below the horizon it is as at the horizon."""
    height = np.clip(np.cos(np.linspace(0.0, np.pi, 64)), 0.0, 1.0)[:, None]
    row = HORIZON + height**0.6 * (ZENITH - HORIZON)
    return mi.Bitmap(np.ascontiguousarray(np.repeat(row[:, None, :], 128, axis=1), dtype=np.float32))


def _upright(mi: Any, up: NDArray[Any], away: NDArray[Any]) -> Any:
    """The turn that takes the map's up, y, to `up`."""
    side = np.cross(up, away)
    turn = np.eye(4)
    turn[:3, :3] = np.stack([side, up, np.cross(side, up)], axis=1)
    return mi.ScalarTransform4f(turn)


def _obstacle(mi: Any, surface: Surface, scale: Scale) -> Any:
    if not surface.endless:
        return _mesh(mi, scale.of(surface.points), surface.triangles, surface.colour or STONE)
    # a plane as far as the eye sees
    a, b, c = scale.of(surface.points[surface.triangles[0]])
    normal = np.cross(b - a, c - a)
    normal /= np.linalg.norm(normal)
    foot = (a @ normal) * normal  # below the middle of what is looked at
    frame = mi.ScalarTransform4f().look_at(
        origin=list(foot), target=list(foot + normal), up=list(np.eye(3)[np.argmin(np.abs(normal))])
    )
    return {"type": "rectangle", "to_world": frame.scale(100 * REACH), "bsdf": _matt(STONE)}


def _mesh(mi: Any, points: NDArray[Any], triangles: NDArray[Any], colour: Colour) -> Any:
    properties = mi.Properties()
    properties["bsdf"] = mi.load_dict(_matt(colour))
    mesh = mi.Mesh("mesh", len(points), triangles.size // 3, props=properties)
    values = mi.traverse(mesh)
    values["vertex_positions"] = np.ascontiguousarray(points.ravel(), dtype=np.float32)
    values["faces"] = np.ascontiguousarray(triangles.ravel(), dtype=np.uint32)
    values.update()
    return mesh


def _matt(colour: Colour) -> dict[str, Any]:
    reflectance = {"type": "rgb", "value": list(colour)}
    return {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": reflectance}}
