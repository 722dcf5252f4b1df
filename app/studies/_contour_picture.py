"""Pictures of stretch space: contours with downhill arrows, energy surfaces with their kinks."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import matplotlib

matplotlib.use("Agg")

import numpy as np
from matplotlib import colors, patheffects, ticker
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

if TYPE_CHECKING:
    from extremal.forms.contour import Plane

    from .contour import Subject

GOLD, ARROW, INVALID, INVERTED = "#f2b705", "#c8662b", "#bdbdbd", "#f8d7d5"
VIEW = -22  # degrees: nearly along the kink, from the valid side
SURFACE = matplotlib.colormaps["viridis"]


def contours(planes: Sequence[tuple[Subject, Plane]]) -> Figure:
    """Draw one panel for each plane: primary contour, downhill direction, the region that cannot occur (figure 6.1)."""
    figure = Figure(figsize=(1.2 + 4.4 * len(planes), 5.3), dpi=110, facecolor="white")
    axes = figure.subplots(1, len(planes), squeeze=False)[0]
    for ax, (one, part) in zip(axes, planes, strict=True):
        _panel(ax, part)
        place = "" if part.fixed is None else f", σ₁ = {part.fixed:g}"
        ax.set_title(f"{one.title}{place}", fontsize=12)
    handles = [
        matplotlib.lines.Line2D([], [], color=GOLD, lw=3, label="primary contour"),
        matplotlib.lines.Line2D([], [], color=GOLD, lw=1.3, label="v·g = 0, not connected to rest"),
        matplotlib.lines.Line2D([], [], color=ARROW, marker=r"$\rightarrow$", ms=13, ls="", label="downhill"),
        matplotlib.patches.Patch(color=INVALID, label="cannot occur (sign convention)"),
        matplotlib.patches.Patch(color=INVERTED, label="inverted"),
    ]
    if len(planes) == 1:
        handles[1].set_label("other v·g = 0")
    figure.legend(
        handles=handles, loc="lower center", ncols=len(handles) if len(planes) > 1 else 2, fontsize=9.5, frameon=False
    )
    ν = planes[0][0].poisson_ratio
    figure.suptitle(f"Primary contours, ν = {ν:g}", x=0.02, ha="left", fontsize=14, weight="bold")
    figure.tight_layout(rect=(0, 0.16 if len(planes) == 1 else 0.115, 1, 0.99))
    return figure


def _panel(ax: Any, part: Plane) -> None:
    x, y = part.first, part.second
    a, b = np.meshgrid(x, y, indexing="ij")
    smallest = np.minimum(a, b)
    inverted = part.valid & (smallest < 0)
    fill = np.where(part.valid, np.where(inverted, 1.0, np.nan), 2.0)
    shades = colors.ListedColormap([INVERTED, INVALID])
    ax.imshow(fill.T, origin="lower", extent=(x[0], x[-1], y[0], y[-1]), cmap=shades, vmin=0.5, vmax=2.5, zorder=0)
    energy = np.where(part.valid, part.energy, np.nan)
    levels = np.nanquantile(energy, np.linspace(0.02, 0.9, 12))
    ax.contour(a, b, energy, levels=np.unique(levels), colors="#9aa7b5", linewidths=0.5, zorder=1)

    step = max(1, len(x) // 22)
    pick = (slice(step // 2, None, step), slice(step // 2, None, step))
    g = np.where((part.valid & np.isfinite(part.energy))[..., None], part.gradient, np.nan)[pick]
    size = np.linalg.norm(g, axis=-1, keepdims=True)
    with np.errstate(invalid="ignore", divide="ignore"):
        # lengths grow as the logarithm: near the contour the arrows must still be seen
        arrow = -g / size * (0.35 + 0.65 * np.log1p(size) / np.nanmax(np.log1p(size)))
    ax.quiver(
        a[pick], b[pick], arrow[..., 0], arrow[..., 1],
        color=ARROW, angles="xy", scale_units="xy", scale=1 / (0.9 * step * (x[1] - x[0])), width=0.0032, zorder=2,
    )  # fmt: skip
    outline = [patheffects.Stroke(linewidth=5.0, foreground="#6b5200"), patheffects.Normal()]
    middle = part.segments.mean(axis=1)
    shown = _valid(middle, part.fixed)
    for primary, style in ((False, {"linewidths": 1.3}), (True, {"linewidths": 3.4})):
        chosen = part.segments[shown & (part.primary == primary)]
        lines = LineCollection(list(chosen), colors=GOLD, capstyle="round", zorder=4, **style)
        if primary:
            lines.set_path_effects(outline)
        ax.add_collection(lines)
    ax.axhline(0, color="#444", lw=0.8, zorder=3)
    ax.axvline(0, color="#444", lw=0.8, zorder=3)
    if part.fixed is None or part.fixed == 1:
        ax.plot(1, 1, "o", color="white", mec="black", ms=7, zorder=5)
        ax.annotate("rest", (1, 1), xytext=(8, 8), textcoords="offset points", fontsize=10, zorder=6)
    if part.fixed is not None and not shown.any():
        ax.text(0.97, 0.04, "the contour is not in this slice", transform=ax.transAxes, ha="right", fontsize=10)
    names = ("σ₁", "σ₂") if part.fixed is None else ("σ₂", "σ₃")
    ax.set(xlabel=names[0], ylabel=names[1], xlim=(x[0], x[-1]), ylim=(y[0], y[-1]), aspect="equal")


def _valid(points: Any, fixed: float | None) -> Any:
    from extremal.forms.contour import is_valid

    if fixed is not None:
        points = np.column_stack([np.full(len(points), fixed), points])
    return is_valid(points)


def surfaces(planes: Sequence[tuple[Subject, Plane]]) -> Figure:
    """Draw the energy over each plane."""
    figure = Figure(figsize=(5.6 * len(planes), 5.2), dpi=110, facecolor="white")
    for k, (one, part) in enumerate(planes):
        ax = figure.add_subplot(1, len(planes), k + 1, projection="3d")
        place = "" if part.fixed is None else f", σ₁ = {part.fixed:g}"
        _surface(ax, part, f"{one.title}{place}")
    figure.subplots_adjust(left=0.02, right=0.95, bottom=0.04, top=0.95, wspace=0.1)
    return figure


def kinks(corotated: Subject, extended: Subject) -> Figure:
    """Draw the corotated energy for σ1 = 1 and 5 (figure 6.4) and a C1 extended energy in 2D (figure 6.9)."""
    from extremal.forms.contour import evaluate, plane

    figure = Figure(figsize=(14.5, 7.6), dpi=110, facecolor="white")
    grid = figure.add_gridspec(2, 3, height_ratios=(1, 2.3), hspace=0.1, wspace=0.16)
    reach = {0: (1.0, 2.2), 1: (5.0, 3.0)}
    for column, (c, width) in reach.items():
        t = np.linspace(-width, width, 401)
        line = np.column_stack([np.full_like(t, c), t, t])
        Ψ, _, _ = evaluate(corotated.kernel, corotated.parameters, line)
        smooth, _, _ = evaluate(corotated.kernel, corotated.parameters, line, mirror=False)
        ax = figure.add_subplot(grid[0, column])
        ax.axvspan(-width, 0, color=INVALID, lw=0)
        ax.plot(t, Ψ, color="#1f4e79", lw=2)
        ax.plot(t[t <= 0], smooth[t <= 0], color="#1f4e79", lw=1.2, ls="--", label="formula continued")
        low = smooth.argmin()
        ax.plot(t[low], smooth[low], "o", color="#2166ac", ms=8, mec="white", label="minimum without the kink")
        ax.set(xlim=(-width, width), xlabel="σ₂ = σ₃", ylim=(Ψ.min() - 0.5 * np.ptp(Ψ), Ψ.max()))
        ax.set_title(f"{corotated.title}, σ₁ = {c:g}", fontsize=12)
        ax.xaxis.set_label_coords(0.93, 0.13)
        ax.set_ylabel("Ψ / E")
        if column == 0:
            ax.legend(fontsize=8.5, loc="lower left", frameon=False)
        s = np.linspace(-width, width, 121)
        part = plane(corotated.kernel, corotated.parameters, s, s, c)
        _surface(figure.add_subplot(grid[1, column], projection="3d"), part, "")
    s = np.linspace(-0.8, 1.6, 145)
    part = plane(extended.kernel, extended.parameters, s, s)
    ax = figure.add_subplot(grid[:, 2], projection="3d")
    ε = extended.parameters[-2]
    _surface(ax, part, f"{extended.title}, 2D\nthe law itself where σ₁, σ₂ ≥ {ε:g}")
    ν = corotated.poisson_ratio
    figure.suptitle(
        f"Energy over stretches, ν = {ν:g}: the kink where two stretches add up to zero",
        x=0.02, ha="left", fontsize=14, weight="bold",
    )  # fmt: skip
    figure.subplots_adjust(left=0.05, right=0.97, bottom=0.03, top=0.88)
    return figure


def _surface(ax: Any, part: Plane, title: str) -> None:
    a, b = np.meshgrid(part.first, part.second, indexing="ij")
    energy = part.energy
    finite = np.isfinite(energy)
    scale = colors.PowerNorm(0.5, np.nanmin(energy[finite]), np.nanmax(energy[finite]))
    shade = SURFACE(scale(np.where(finite, energy, 0.0)))
    shade[~part.valid] = colors.to_rgba("#b5b5b5")
    light = colors.LightSource(azdeg=225, altdeg=55)
    lit = light.shade_rgb(shade[..., :3], np.where(finite, energy, 0.0), blend_mode="soft", vert_exag=0.4)
    step = max(1, len(part.first) // 120)
    ax.plot_surface(
        a, b, energy, facecolors=np.dstack([lit, np.ones(lit.shape[:2])]), rstride=step, cstride=step,
        linewidth=0, antialiased=False, shade=False,
    )  # fmt: skip
    names = ("σ₁", "σ₂") if part.fixed is None else ("σ₂", "σ₃")
    ax.set(xlabel=names[0], ylabel=names[1], zlabel="Ψ / E")
    ax.view_init(elev=30, azim=VIEW)
    for axis in (ax.xaxis, ax.yaxis, ax.zaxis):
        axis.set_major_locator(ticker.MaxNLocator(5))
    if title:
        ax.set_title(title, fontsize=12)
