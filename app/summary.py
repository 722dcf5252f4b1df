"""`summary.png`: what happened and whether to trust it. Drawn from the files of a results folder alone."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import matplotlib
import numpy as np
from matplotlib import colors, ticker
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d.art3d import Poly3DCollection

from .frames import Shape, frame_list, read_shape
from .results import HISTORY, ITERATIONS, SUMMARY
from .summary_page import columns, page, say_nothing, worth

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from extremal.obstacles.colliders import Collider

INVERTED = "#d62728"
# viridis has no red, so an inverted element cannot be taken for a stretched one
STRETCH = matplotlib.colormaps["viridis"]
OBSTACLE = "#9aa3ad"
AROUND = 0.25  # of the body's size, how much is seen around it where there are obstacles
OBSTACLE_CELLS = 26  # facets that are drawn one by one must be few
# A smallest stretch in between that is less than this part of those at start and end deserves a picture.
SQUEEZED = 0.8
LIGHT = np.array([0.36, -0.48, 0.8])
# Beyond so many facets their edges would hide the colours.
EDGES_UP_TO = 6000
# Up to so many steps the solver's iterations tell more than the steps do.
FEW_STEPS = 3


def draw(folder: Path) -> Path:
    """Draw the summary of a results folder and return its path.

    Raises
    ------
    OutputError
        If the picture cannot be written.
    """
    history = columns(folder / HISTORY)
    iterations = columns(folder / ITERATIONS)
    shapes = _shapes(folder, history)
    with page(folder) as (figure, record):
        left = 0.66 if shapes else 0.08
        if shapes:
            _draw_shapes(figure, shapes, _obstacles(record, folder, 2 if shapes[0][2].planar else 3))
        top = figure.add_axes((left, 0.55, 0.95 - left, 0.31))
        bottom = figure.add_axes((left, 0.13, 0.95 - left, 0.31))
        few_steps = record["steps"] <= FEW_STEPS and len(iterations.get("total", ())) > 1
        if few_steps:
            _draw_histories(top, bottom, iterations, "total", "solver iteration", history)
        else:
            _draw_histories(top, bottom, history, "time", "time [s]", history)
    return folder / SUMMARY


# ---------------------------------------------------------------------- shapes


def _shapes(folder: Path, history: Mapping[str, NDArray[Any]]) -> list[tuple[str, float, Shape]]:
    """Return the titles, times and shapes of the first and the last frame that exist.

    Where elements were inverted in between only, or much more squeezed than at both ends, the frame nearest to the
    worst step comes between them.
    """
    frames = [(time, folder / file) for time, file in frame_list(folder) if (folder / file).exists()]
    count = len(frames)
    wanted = {0: "before", count - 1: "after"} if count > 1 else {0: "start"} if count else {}
    worst = _worst_step(history) if count > 2 else None
    if worst is not None:
        times = np.array([time for time, _ in frames])
        middle = int(np.argmin(np.abs(times - history["time"][worst])))
        if 0 < middle < count - 1:
            wanted = {0: "before", middle: f"time {times[middle]:.3g}", count - 1: "after"}
    return [(title, frames[index][0], read_shape(frames[index][1])) for index, title in wanted.items()]


def _worst_step(history: Mapping[str, NDArray[Any]]) -> int | None:
    """Row of the step that neither the start nor the end gives an idea of."""
    inverted, stretch = (history.get(name, np.zeros(0)) for name in ("inverted", "smallest_stretch"))
    if len(inverted) and inverted[0] == inverted[-1] == 0 < inverted.max():
        return int(np.argmin(history.get("smallest_J", -inverted)))
    if len(stretch) and np.nanmin(stretch) < SQUEEZED * min(stretch[0], stretch[-1]):
        return int(np.nanargmin(stretch))
    return None


def _draw_shapes(figure: Figure, shapes: list[tuple[str, float, Shape]], obstacles: Sequence[Collider]) -> None:
    # rest is 1; scattered elements beyond the end of the scale are no news
    scale = colors.Normalize(0.0, max(1.25, float(np.nanpercentile(shapes[-1][2].values, 98))))
    extents = [np.ptp(shape.corners, axis=0).max() for *_, shape in shapes]
    all_corners = np.array([shape.corners for *_, shape in shapes])
    if obstacles:  # what is around the body belongs to the picture
        all_corners += (AROUND * np.array(extents))[:, None, None] * np.array([[-1.0], [1.0]])
    together = np.array([all_corners[:, 0].min(axis=0), all_corners[:, 1].max(axis=0)])
    # one scale for both, unless one would become a speck
    shared = max(extents) <= 2.5 * min(extents) and np.ptp(together, axis=0).max() <= 2.5 * min(extents)
    number = len(shapes)
    wide, high = np.ptp(together, axis=0)[:2]
    stacked = shapes[0][2].planar and wide > 1.3 * high
    for i, (title, time, shape) in enumerate(shapes):
        bounds = together if shared else all_corners[i]
        if stacked:
            height = 0.69 / number
            x, y, width = 0.04, 0.19 + (number - 1 - i) * height, 0.56
            top = y + height - 0.01
            axes = figure.add_axes((x, y + 0.05, width, height - 0.07))
        else:
            width = 0.60 / number
            x, top = 0.005 + i * width, 0.885
            place = (x + 0.03, 0.21, width - 0.04, 0.63) if shape.planar else (x, 0.17, width, 0.71)
            axes = figure.add_axes(place, projection=None if shape.planar else "3d")
        (_draw_plane if shape.planar else _draw_solid)(axes, shape, bounds, scale, obstacles, time)
        if stacked and i < number - 1:
            axes.set_xlabel("")  # the one below says it
        count = int(shape.inverted.sum())
        shown = "elements" if shape.planar else "boundary facets"
        words = f"{title}: {count} of {len(shape.values)} {shown} inverted" if count else title
        figure.text(
            x + width / 2, top, words, ha="center", fontsize=11, color=INVERTED if count else "black"
        )
    if shapes[0][2].quantity:
        bar = figure.add_axes((0.13, 0.145, 0.28, 0.018))
        mappable = matplotlib.cm.ScalarMappable(scale, STRETCH)
        figure.colorbar(mappable, cax=bar, orientation="horizontal", extend="max")
        bar.set_xlabel(shapes[0][2].quantity, fontsize=9)
        bar.tick_params(labelsize=8)
        figure.text(0.43, 0.154, "■", color=INVERTED, va="center", fontsize=13)
        figure.text(0.447, 0.154, "inverted", va="center", fontsize=9)


def _face_colors(shape: Shape, scale: colors.Normalize) -> NDArray[Any]:
    rgba = STRETCH(scale(shape.values))
    rgba[shape.inverted] = colors.to_rgba(INVERTED)
    return rgba


def _draw_plane(
    axes: Any,
    shape: Shape,
    bounds: NDArray[Any],
    scale: colors.Normalize,
    obstacles: Sequence[Collider],
    time: float,
) -> None:
    from matplotlib.collections import PolyCollection

    edges = 0.3 if len(shape.facets) <= EDGES_UP_TO else 0.0
    # inverted elements last, so that none hides under a good one
    order = np.argsort(shape.inverted, kind="stable")
    polygons = PolyCollection(
        shape.facets[order, :, :2],
        facecolors=_face_colors(shape, scale)[order],
        edgecolors="0.15",
        linewidths=edges,
    )
    axes.add_collection(polygons)
    margin = 0.03 * np.ptp(bounds, axis=0).max()
    low, high = bounds[0] - margin, bounds[1] + margin
    axes.set_xlim(low[0], high[0])
    axes.set_ylim(low[1], high[1])
    x, y = (np.linspace(low[k], high[k], 240) for k in range(2))
    nodes = np.stack(np.meshgrid(x, y), axis=-1)
    for obstacle in obstacles:
        phi = obstacle.distance(nodes.reshape(-1, 2), time).reshape(nodes.shape[:2])
        axes.contourf(x, y, phi, levels=[-np.inf, 0.0], colors=[OBSTACLE])
    axes.set_aspect("equal")
    axes.tick_params(labelsize=8)
    axes.set_xlabel("x [m]", fontsize=8)


def _draw_solid(
    axes: Any,
    shape: Shape,
    bounds: NDArray[Any],
    scale: colors.Normalize,
    obstacles: Sequence[Collider],
    time: float,
) -> None:
    rgba = _face_colors(shape, scale)
    if shape.facets.shape[1] < 3:
        axes.scatter(*shape.facets[:, 0].T, c=rgba, s=2)
    else:
        rgba[:, :3] *= _light(shape.facets)[:, None]
        edges = np.full((len(rgba), 4), (0.1, 0.1, 0.1, 0.6 if len(rgba) <= EDGES_UP_TO else 0.0))
        around = _obstacle_facets(obstacles, time, bounds)
        glass = np.tile(colors.to_rgba(OBSTACLE, 0.3), (len(around), 1))
        glass[:, :3] *= _light(around)[:, None]
        # one collection: its facets are drawn from the farthest to the nearest
        axes.add_collection3d(
            Poly3DCollection(
                np.concatenate([shape.facets, around]),
                facecolors=np.concatenate([rgba, glass]),
                edgecolors=np.concatenate([edges, np.zeros((len(glass), 4))]),
                linewidths=0.25,
            )
        )
    # a flat body (collapsed, say) still needs a box of some depth
    size = np.ptp(bounds, axis=0)
    half = np.maximum(size, 0.05 * max(size.max(), 1e-12)) / 2
    middle = bounds.mean(axis=0)
    axes.set_xlim(middle[0] - half[0], middle[0] + half[0])
    axes.set_ylim(middle[1] - half[1], middle[1] + half[1])
    axes.set_zlim(middle[2] - half[2], middle[2] + half[2])
    axes.set_box_aspect(half)
    axes.patch.set_visible(False)  # else it covers the labels of the picture beside it
    axes.view_init(elev=22, azim=-58)
    for axis, name in ((axes.xaxis, "x [m]"), (axes.yaxis, "y [m]"), (axes.zaxis, "z [m]")):
        axis.set_major_locator(ticker.MaxNLocator(3))
        axis.set_label_text(name, fontsize=8)
        axis.labelpad = -5
    axes.tick_params(labelsize=7, pad=-2)


def _light(facets: NDArray[Any]) -> NDArray[Any]:
    """How bright facets (f, 3, 3) are, (f,)."""
    normals = np.cross(facets[:, 1] - facets[:, 0], facets[:, 2] - facets[:, 0])
    return 0.62 + 0.38 * np.abs(normals @ LIGHT) / np.maximum(np.linalg.norm(normals, axis=1), np.finfo(float).tiny)


def _obstacles(record: Mapping[str, Any], folder: Path, dimension: int) -> Sequence[Collider]:
    if not record["scene"].get("collider"):
        return ()
    from .scenery import recorded_colliders  # brings what makes obstacles

    return recorded_colliders(record, folder, dimension)


def _obstacle_facets(obstacles: Sequence[Collider], time: float, window: NDArray[Any]) -> NDArray[Any]:
    """Facets (f, 3, 3) [m] of what is seen of obstacles in a window (2, 3)."""
    if not obstacles:
        return np.zeros((0, 3, 3))
    from .scenery import Scenery

    surfaces = Scenery(obstacles, window, OBSTACLE_CELLS).at(time)
    facets = np.concatenate([np.zeros((0, 3, 3)), *(surface.points[surface.triangles] for surface in surfaces)])
    middle = facets.mean(axis=1)
    return facets[((middle >= window[0]) & (middle <= window[1])).all(axis=1)]


# ---------------------------------------------------------------------- histories


def _draw_histories(
    top: Any,
    bottom: Any,
    table: Mapping[str, NDArray[Any]],
    along: str,
    label: str,
    history: Mapping[str, NDArray[Any]],
) -> None:
    x = table.get(along, np.zeros(0))
    energies = [n for n in ("energy", "elastic_energy", "kinetic_energy") if worth(table, n)]
    # a part that is the whole would hide it
    energies = [n for n in energies if n == "energy" or not np.array_equal(table[n], table.get("energy", ()))]
    for name in energies:
        top.plot(x, table[name], label=name.replace("_", " "), lw=1.4 if name == "energy" else 1.0)
    if energies:
        _logarithmic_if_wide(top, np.concatenate([table[name] for name in energies]), 1e-9)
        top.set_title("energy [J]", fontsize=10, loc="left")
        if len(energies) > 1:
            top.legend(fontsize=8, frameon=False)
    else:
        say_nothing(top, "no energy recorded")

    drawn = False
    if worth(table, "residual"):
        bottom.plot(x, table["residual"], color="#1f77b4", lw=1.4)
        _logarithmic_if_wide(bottom, table["residual"])
        bottom.set_title("residual", fontsize=10, loc="left", color="#1f77b4")
        drawn = True
    if worth(table, "inverted", zero=True):
        counts = table["inverted"]
        axes = bottom.twinx() if drawn else bottom
        axes.step(x, counts, where="post", color=INVERTED, lw=1.2)
        axes.set_ylim(0, max(1.0, 1.05 * float(np.nanmax(counts))))
        axes.spines["top"].set_visible(False)
        axes.yaxis.set_major_locator(ticker.MaxNLocator(4, integer=True))
        axes.tick_params(axis="y", labelsize=8, colors=INVERTED)
        axes.set_title("inverted elements", fontsize=10, loc="right" if drawn else "left", color=INVERTED)
        drawn = True
    elif worth(history, "inverted", zero=True):  # counted after each step only
        first, last = history["inverted"][[0, -1]]
        bottom.set_title(
            f"inverted elements {first:.0f} → {last:.0f}", fontsize=10, loc="right", color=INVERTED
        )
    if not drawn:
        say_nothing(bottom, "no residual recorded")
    bottom.set_xlabel(label, fontsize=9)
    for axes in (top, bottom):
        axes.grid(alpha=0.25)
        axes.tick_params(labelsize=8)
        axes.spines[["top", "right"]].set_visible(False)
        if along == "total":
            axes.xaxis.set_major_locator(ticker.MaxNLocator(integer=True))
        if len(x) > 1:
            axes.set_xlim(x[0], x[-1])


def _logarithmic_if_wide(axes: Any, values: NDArray[Any], least: float = 1e-16) -> None:
    finite = values[np.isfinite(values)]
    positive = finite[finite > 0]
    if len(positive) and finite.min() >= 0 and positive.max() > 100 * positive.min():
        # an energy of 1e-20 is a rest state, not a scale to draw to
        axes.set_yscale("log")
        axes.set_ylim(bottom=max(positive.min(), least * positive.max()) / 2)
        axes.yaxis.set_major_locator(ticker.LogLocator(numticks=6))
