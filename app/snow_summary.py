"""`summary.png` of a run of snow: the first and the last frame, energies, the solver's work, the verdict."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib import ticker
from matplotlib.figure import Figure

from .frames import frame_list, read_nodes, read_points
from .results import HISTORY, SOLID, SUMMARY
from .scenery import recorded_colliders
from .snow_picture import draw_plane, draw_space
from .summary_page import columns, page, say_nothing, worth
from .view import View, choose_view

if TYPE_CHECKING:
    from numpy.typing import NDArray

SIZE = (460, 520)  # of a picture [pixels]
WIDE = (940, 250)  # of one where what happens is wide and low
WIDE_FROM = 2.2  # width over height
ENERGIES = {
    "kinetic_energy": "#1f77b4",
    "elastic_energy": "#2ca02c",
    "gravitational_energy": "#8c564b",
    "plastic_dissipation": "#ff7f0e",
    "solid_energy": "#d62728",
}


def draw(folder: Path) -> Path:
    """Draw the summary of a results folder and return its path.

    Raises
    ------
    OutputError
        If the picture cannot be written.
    """
    history = columns(folder / HISTORY)
    frames = first_and_last(folder)
    with page(folder) as (figure, record):
        if frames:
            _draw_pictures(figure, stage(record, folder), frames)
        left = 0.70
        _draw_energies(figure.add_axes((left, 0.55, 0.96 - left, 0.31)), history)
        _draw_work(figure.add_axes((left, 0.13, 0.96 - left, 0.31)), history)
    return folder / SUMMARY


@dataclass(frozen=True)
class Frame:
    """Particles at a time."""

    title: str
    time: float
    points: NDArray[Any]  # (n, 3) [m]
    solid: NDArray[Any] = field(default_factory=lambda: np.zeros((0, 3)))  # nodes (m, 3) [m] of an elastic body

    @property
    def bounds(self) -> NDArray[Any]:
        """Corners (2, 3) [m] of the body and nearly all particles: a few far ones shall not make the rest a speck."""
        low, high = np.percentile(self.points, (0.5, 99.5), axis=0)
        whole = np.vstack([low, high, self.solid])
        low, high = whole.min(axis=0), whole.max(axis=0)
        margin = 0.06 * max(float((high - low).max()), 1e-9)
        return np.array([low - margin, high + margin])


def read_frame(folder: Path, entry: tuple[float, str]) -> Frame:
    """Read a frame that `frame_list` names."""
    time, file = entry
    body = folder / SOLID / file
    words, points = f"t = {time:.3g} s", read_points(folder / file)
    return Frame(words, time, points, read_nodes(body)) if body.exists() else Frame(words, time, points)


def first_and_last(folder: Path) -> list[Frame]:
    """Return the first and the last frame that exist."""
    entries = frame_list(folder)
    return [read_frame(folder, entry) for entry in (entries[:1] + entries[1:][-1:])]


def overall_bounds(folder: Path) -> NDArray[Any]:
    """Return corners (2, 3) [m] of what holds nearly all particles from the beginning to the end."""
    entries = frame_list(folder)
    chosen = sorted({0, len(entries) // 3, 2 * len(entries) // 3, len(entries) - 1})
    extents = np.array([read_frame(folder, entries[index]).bounds for index in chosen])
    return np.array([extents[:, 0].min(axis=0), extents[:, 1].max(axis=0)])


@dataclass(frozen=True)
class Stage:
    """What a picture needs to know of the scene: spacing of particles [m], obstacles, dimension, where up is."""

    spacing: float
    colliders: list[Any]
    dimension: int
    up: NDArray[Any]


def stage(record: Mapping[str, Any], folder: Path) -> Stage:
    """Return what the pictures of a run show besides particles, from its record and its scene file."""
    plain = record["scene"]
    d, h = plain["grid"]["dimension"], plain["grid"]["cell_size"] / plain["scale"]
    acceleration = np.zeros(3)
    acceleration[:d] = (plain["gravity"] or {"acceleration": [0.0] * d})["acceleration"]
    weight = float(np.linalg.norm(acceleration))
    up = -acceleration / weight if weight else np.eye(3)[d - 1]
    spacing = h / max(body["per_cell"] for body in plain["body"]) ** (1 / d)
    return Stage(spacing, recorded_colliders(record, folder, d), d, up)


def _draw_pictures(figure: Figure, seen: Stage, frames: list[Frame]) -> None:
    extents = [frame.bounds for frame in frames]
    whole = np.array([np.min(extents, axis=0)[0], np.max(extents, axis=0)[1]])
    sizes = [np.ptp(extent, axis=0).max() for extent in extents]
    # one scale for both, unless what there is to see would become a speck
    shared = np.ptp(whole, axis=0).max() <= 3.0 * min(sizes)
    wide = len(frames) > 1 and shared and _is_wide(whole, seen)
    size = WIDE if wide else SIZE
    for i, frame in enumerate(frames):
        place = (0.02, 0.51 - 0.40 * i, 0.63, 0.36) if wide else (0.02 + 0.325 * i, 0.11, 0.315, 0.76)
        image = picture(frame, seen, whole if shared else extents[i], size)
        axes = figure.add_axes(place)
        axes.imshow(image, interpolation="none", aspect="equal")
        axes.set_axis_off()
        axes.set_title(frame.title, fontsize=11, pad=4)


def picture(
    frame: Frame, seen: Stage, bounds: NDArray[Any], size: tuple[int, int], view: View | None = None
) -> NDArray[Any]:
    """Draw a frame, by default from where most is seen of it; colours (height, width, 3)."""
    if seen.dimension == 2:
        return draw_plane(frame.points[:, :2], seen.spacing, seen.colliders, frame.time, bounds[:, :2], size)
    if view is None:
        view = choose_view(bounds, seen.colliders, [frame.time], seen.up, size[0] / size[1])
    return draw_space(frame.points, seen.spacing, seen.colliders, frame.time, view, size)


def _is_wide(bounds: NDArray[Any], seen: Stage) -> bool:
    """Tell whether what is seen is much wider than high."""
    if seen.dimension == 2:
        across, rise = np.ptp(bounds, axis=0)[:2]
    else:
        view = choose_view(bounds, seen.colliders, [0.0], seen.up, 1.0)
        across, _, rise = np.ptp(np.array(list(product(*bounds.T))) @ view.axes.T, axis=0)
    return bool(across > WIDE_FROM * rise)


def _draw_energies(axes: Any, history: Mapping[str, NDArray[Any]]) -> None:
    time = history.get("time", np.zeros(0))
    shown = [name for name in ENERGIES if worth(history, name)]
    for name in shown:
        values = history[name]
        words = name.replace("_energy", "").replace("_", " ")
        if name == "gravitational_energy":
            values, words = values - np.nanmin(values), "gravitational, from its least"
        axes.plot(time, values, color=ENERGIES[name], lw=1.2, label=words)
    if not shown:
        say_nothing(axes, "no energy")
        return
    if len(shown) > 4:  # the legend takes the title's place
        axes.set_ylabel("energy [J]", fontsize=9)
    else:
        axes.set_title("energy [J]", fontsize=10, loc="left")
    # above the curves: there is no empty corner that all runs leave
    axes.legend(fontsize=8, frameon=False, ncols=2, loc="lower right", bbox_to_anchor=(1.03, 0.98), borderpad=0.1)
    _finish(axes, time)


def _draw_work(axes: Any, history: Mapping[str, NDArray[Any]]) -> None:
    time = history.get("time", np.zeros(0))
    axes.set_xlabel("time [s]", fontsize=9)
    _finish(axes, time)
    if worth(history, "krylov_iterations"):
        axes.plot(time[1:], history["krylov_iterations"][1:], color="#1f77b4", lw=1.0)
        axes.set_title("Krylov iterations of a step", fontsize=10, loc="left", color="#1f77b4")
        axes.set_ylim(bottom=0)
        axes.yaxis.set_major_locator(ticker.MaxNLocator(5, integer=True))
        axes = axes.twinx()
        axes.spines["top"].set_visible(False)
    if worth(history, "dt"):
        steps = 1e3 * history["dt"][1:]
        axes.plot(time[1:], steps, color="#9467bd", lw=1.0)
        axes.set_title("step [ms]", fontsize=10, loc="right", color="#9467bd")
        axes.set_ylim(0, 1.1 * np.nanmax(steps))  # steps are often all the same
        axes.tick_params(axis="y", labelsize=8, colors="#9467bd")


def _finish(axes: Any, time: NDArray[Any]) -> None:
    axes.grid(alpha=0.25)
    axes.tick_params(labelsize=8)
    axes.spines[["top", "right"]].set_visible(False)
    if len(time) > 1:
        axes.set_xlim(time[0], time[-1])
