"""`summary.png`: what happened and whether to trust it. Drawn from the files of a results folder alone."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any
from xml.etree import ElementTree

import matplotlib

matplotlib.use("Agg")

import numpy as np
from matplotlib import colors, ticker
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d.art3d import Poly3DCollection

from .results import HISTORY, ITERATIONS, RECORD, SERIES, SUMMARY, Series, atomic, read_table

if TYPE_CHECKING:
    from numpy.typing import NDArray

INVERTED = "#d62728"
GOOD, DOUBTFUL, BAD = "#2e7d32", "#b26a00", "#b71c1c"
# viridis has no red, so an inverted element cannot be taken for a stretched one
STRETCH = matplotlib.colormaps["viridis"]
LIGHT = np.array([0.36, -0.48, 0.8])
# Beyond so many facets their edges would hide the colours.
EDGES_UP_TO = 6000
# Up to so many steps the solver's iterations tell more than the steps do.
FEW_STEPS = 3
FACES = np.array([[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]])


@dataclass(frozen=True)
class Shape:
    """What is seen of a frame: deformed facets (f, corners, 3) [m], value and inversion of their cells."""

    facets: NDArray[Any]
    values: NDArray[Any]
    inverted: NDArray[Any]
    quantity: str
    planar: bool

    @property
    def corners(self) -> NDArray[Any]:
        """Smallest and largest coordinates, shape (2, 3)."""
        points = self.facets.reshape(-1, 3)
        return np.array([points.min(axis=0), points.max(axis=0)])


def draw(folder: Path) -> Path:
    """Draw the summary of a results folder and return its path.

    Raises
    ------
    OutputError
        If the picture cannot be written.
    """
    record = json.loads((folder / RECORD).read_text(encoding="utf-8"))
    history = columns(folder / HISTORY)
    iterations = columns(folder / ITERATIONS)
    shapes = _shapes(folder, history)

    figure = Figure(figsize=(13.5, 6.4), dpi=110, facecolor="white")
    figure.text(0.02, 0.955, record["title"] or record["part"], fontsize=15, weight="bold", va="center")
    write_verdict(figure, record)
    left = 0.66 if shapes else 0.08
    if shapes:
        _draw_shapes(figure, shapes)
    top = figure.add_axes((left, 0.55, 0.95 - left, 0.31))
    bottom = figure.add_axes((left, 0.13, 0.95 - left, 0.31))
    few_steps = record["steps"] <= FEW_STEPS and len(iterations.get("total", ())) > 1
    if few_steps:
        _draw_histories(top, bottom, iterations, "total", "solver iteration", history)
    else:
        _draw_histories(top, bottom, history, "time", "time [s]", history)
    path = folder / SUMMARY
    with atomic(path) as partial:
        figure.savefig(partial, format="png")
    return path


def columns(path: Path) -> dict[str, NDArray[Any]]:
    """Return the columns of a table, empty entries as not-a-number; none where there is no file."""
    if not path.exists():
        return {}
    names, rows = read_table(path)
    return {name: np.array([row.get(name, math.nan) for row in rows]) for name in names}


# ---------------------------------------------------------------------- shapes


def _shapes(folder: Path, history: Mapping[str, NDArray[Any]]) -> list[tuple[str, Shape]]:
    """Return the titles and shapes of the first and the last frame that exist.

    Where elements were inverted in between only, the frame nearest to the worst step comes between them.
    """
    count = sum(1 for _ in (folder / Series.name(0)).parent.glob("frame_*.vtu"))
    wanted = {0: "before", count - 1: "after"} if count > 1 else {0: "start"}
    inverted = history.get("inverted", np.zeros(0))
    if count > 2 and len(inverted) and inverted[0] == inverted[-1] == 0 < inverted.max():
        times = [float(entry.get("timestep", 0)) for entry in ElementTree.parse(folder / SERIES).iter("DataSet")]
        worst = np.argmin(history.get("smallest_J", -inverted))
        middle = int(np.argmin(np.abs(np.array(times) - history["time"][worst])))
        if 0 < middle < count - 1:
            wanted = {0: "before", middle: f"time {times[middle]:.3g}", count - 1: "after"}
    paths = {title: folder / Series.name(index) for index, title in wanted.items()}
    return [(title, _read_shape(path)) for title, path in paths.items() if path.exists()]


def _read_shape(path: Path) -> Shape:
    import meshio

    mesh = meshio.vtu.read(str(path))
    block = mesh.cells[0]
    data = {name: values[0] for name, values in mesh.cell_data.items()}
    deformed = mesh.points + mesh.point_data.get("displacement", np.zeros_like(mesh.points))
    cells = np.asarray(block.data)
    planar = block.type.startswith("triangle")
    if block.type.startswith("tetra"):
        nodes, owner = boundary_facets(cells[:, :4])
    elif planar:
        nodes, owner = cells[:, :3], np.arange(len(cells))
    else:  # particles and the like: a point is its own facet
        nodes, owner = cells[:, :1], np.arange(len(cells))
    quantity = next((name for name in ("smallest_stretch", "J") if name in data), "")
    values = data[quantity][owner] if quantity else np.ones(len(owner))
    inverted = data["inverted"][owner] > 0 if "inverted" in data else values < 0
    return Shape(deformed[nodes], values, inverted, quantity.replace("_", " "), planar)


def boundary_facets(cells: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return the facets (f, 3) that belong to one tetrahedron only, and that tetrahedron of each (f,)."""
    facets = cells[:, FACES].reshape(-1, 3)
    _, first, count = np.unique(np.sort(facets, axis=1), axis=0, return_index=True, return_counts=True)
    outside = np.sort(first[count == 1])
    return facets[outside], outside // 4


def _draw_shapes(figure: Figure, shapes: list[tuple[str, Shape]]) -> None:
    # rest is 1; scattered elements beyond the end of the scale are no news
    scale = colors.Normalize(0.0, max(1.25, float(np.nanpercentile(shapes[-1][1].values, 98))))
    extents = [np.ptp(shape.corners, axis=0).max() for _, shape in shapes]
    all_corners = np.array([shape.corners for _, shape in shapes])
    together = np.array([all_corners[:, 0].min(axis=0), all_corners[:, 1].max(axis=0)])
    # one scale for both, unless one would become a speck
    shared = max(extents) <= 2.5 * min(extents) and np.ptp(together, axis=0).max() <= 2.5 * min(extents)
    number = len(shapes)
    wide, high = np.ptp(together, axis=0)[:2]
    stacked = shapes[0][1].planar and wide > 1.3 * high
    for i, (title, shape) in enumerate(shapes):
        bounds = together if shared else shape.corners
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
        (_draw_plane if shape.planar else _draw_solid)(axes, shape, bounds, scale)
        if stacked and i < number - 1:
            axes.set_xlabel("")  # the one below says it
        count = int(shape.inverted.sum())
        shown = "elements" if shape.planar else "boundary facets"
        words = f"{title}: {count} of {len(shape.values)} {shown} inverted" if count else title
        figure.text(
            x + width / 2, top, words, ha="center", fontsize=11, color=INVERTED if count else "black"
        )
    if shapes[0][1].quantity:
        bar = figure.add_axes((0.13, 0.145, 0.28, 0.018))
        mappable = matplotlib.cm.ScalarMappable(scale, STRETCH)
        figure.colorbar(mappable, cax=bar, orientation="horizontal", extend="max")
        bar.set_xlabel(shapes[0][1].quantity, fontsize=9)
        bar.tick_params(labelsize=8)
        figure.text(0.43, 0.154, "■", color=INVERTED, va="center", fontsize=13)
        figure.text(0.447, 0.154, "inverted", va="center", fontsize=9)


def _face_colors(shape: Shape, scale: colors.Normalize) -> NDArray[Any]:
    rgba = STRETCH(scale(shape.values))
    rgba[shape.inverted] = colors.to_rgba(INVERTED)
    return rgba


def _draw_plane(axes: Any, shape: Shape, bounds: NDArray[Any], scale: colors.Normalize) -> None:
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
    axes.set_xlim(bounds[0, 0] - margin, bounds[1, 0] + margin)
    axes.set_ylim(bounds[0, 1] - margin, bounds[1, 1] + margin)
    axes.set_aspect("equal")
    axes.tick_params(labelsize=8)
    axes.set_xlabel("x [m]", fontsize=8)


def _draw_solid(axes: Any, shape: Shape, bounds: NDArray[Any], scale: colors.Normalize) -> None:
    rgba = _face_colors(shape, scale)
    if shape.facets.shape[1] < 3:
        axes.scatter(*shape.facets[:, 0].T, c=rgba, s=2)
    else:
        normals = np.cross(shape.facets[:, 1] - shape.facets[:, 0], shape.facets[:, 2] - shape.facets[:, 0])
        lengths = np.maximum(np.linalg.norm(normals, axis=1), np.finfo(float).tiny)
        light = 0.62 + 0.38 * np.abs(normals @ LIGHT) / lengths
        rgba[:, :3] *= light[:, None]
        edges = 0.25 if len(shape.facets) <= EDGES_UP_TO else 0.0
        axes.add_collection3d(
            Poly3DCollection(shape.facets, facecolors=rgba, edgecolors=(0.1, 0.1, 0.1, 0.6), linewidths=edges)
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
        _logarithmic_if_wide(top, np.concatenate([table[name] for name in energies]))
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


def worth(table: Mapping[str, NDArray[Any]], name: str, zero: bool = False) -> bool:
    """Tell whether a column has anything to show: a number, and (unless `zero`) not only zeros."""
    values = table.get(name, np.zeros(0))
    finite = values[np.isfinite(values)]
    return len(finite) > 0 and (zero or bool(np.any(finite != 0)))


def _logarithmic_if_wide(axes: Any, values: NDArray[Any]) -> None:
    finite = values[np.isfinite(values)]
    positive = finite[finite > 0]
    if len(positive) and finite.min() >= 0 and positive.max() > 100 * positive.min():
        # an energy of 1e-20 is a rest state, not a scale to draw to
        axes.set_yscale("log")
        axes.set_ylim(bottom=max(positive.min(), 1e-16 * positive.max()) / 2)
        axes.yaxis.set_major_locator(ticker.LogLocator(numticks=6))


def say_nothing(axes: Any, words: str) -> None:
    """Write `words` where there is nothing to plot."""
    axes.text(0.5, 0.5, words, transform=axes.transAxes, ha="center", va="center", color="0.5", fontsize=9)


# ---------------------------------------------------------------------- verdict


def verdict(record: Mapping[str, Any]) -> tuple[str, str, str]:
    """Return a headline, what stands below it, and their colour."""
    found = record["diagnostics"]
    inverted = found.get("inverted")
    missed = [entry for entry in record.get("expect", ()) if not entry["met"]]
    words = [record["status"].upper()]
    if inverted is not None:
        words.append("no inverted element" if inverted == 0 else f"{inverted:,.0f} INVERTED")
    if "particles" in found:
        words.append(_count(found["particles"], "particle"))
    if "smallest_stretch" in found:
        words.append(f"smallest stretch {float(found['smallest_stretch']):.3g}")
    words.append(_count(record["solver_iterations"]["total"], "solver iteration"))
    words.append(_count(record["steps"], "step"))
    words.append(f"{record['wall_seconds']:.3g} s")
    words.append(_count(record["ranks"], "rank"))
    second = record["reason"]
    if record.get("expect"):
        kept = len(record["expect"]) - len(missed)
        text = f"{kept} of {_count(len(record['expect']), 'expectation')} met"
        named = "; ".join(f"{e['name']} {e['wanted']}, found {_short(e['found'])}" for e in missed[:3])
        second = "; ".join(part for part in (second, text + (f". Missed: {named}" if named else "")) if part)
    if record["status"] != "finished":
        color = BAD
    else:
        color = DOUBTFUL if missed or inverted else GOOD
    return "  ·  ".join(words), second, color


def _count(number: float, noun: str) -> str:
    return f"{number:,.0f} {noun}" + ("" if number == 1 else "s")


def _short(found: Any) -> str:
    return f"{found:.4g}" if isinstance(found, float) else str(found)


def write_verdict(figure: Figure, record: Mapping[str, Any]) -> None:
    """Write the verdict at the bottom of the figure."""
    headline, second, color = verdict(record)
    figure.text(0.02, 0.055, headline, fontsize=11.5, weight="bold", color=color, va="center")
    if second:
        figure.text(0.02, 0.02, second[:190], fontsize=9, color=color, va="center")
