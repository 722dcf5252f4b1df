"""Elastic bodies as shaded surfaces, coloured by a field, among their obstacles: PyVista, without a screen."""

from __future__ import annotations

import os
from collections.abc import Sequence
from ctypes.util import find_library
from typing import TYPE_CHECKING, Any

import numpy as np

from .errors import InputError
from .frames import Shape
from .view import OPENING, View

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from .scenery import Surface

# VTK's variable that names what it draws to, and what that may be, by the library which each needs
WINDOW = "VTK_DEFAULT_OPENGL_WINDOW"
WINDOWS = {"EGL": "vtkEGLRenderWindow", "OSMesa": "vtkOSOpenGLRenderWindow"}
COLOURS, INVERTED, OBSTACLE = "viridis", "#d62728", "#9aa3ad"
EDGES_UP_TO = 20000  # facets, beyond which lines between them would hide the colours
AMBIENT = 0.22  # light from everywhere
GLASS = 0.28  # opacity of obstacles that the body is behind of


def pyvista() -> Any:
    """Return PyVista, set to draw without a screen.

    Raises
    ------
    InputError
        Naming what provides the library, or the one that it draws with.
    """
    if WINDOW not in os.environ:  # else VTK looks for an X server first, and complains
        found = next((window for name, window in WINDOWS.items() if find_library(name)), None)
        if found is None:
            raise InputError("render: VTK needs EGL or OSMesa to draw without a screen; apt install libegl1")
        os.environ[WINDOW] = found
    try:
        import pyvista as pv
    except ImportError:
        raise InputError(
            "render: shaded surfaces need pyvista; ./setup.sh view installs it, or pip install 'extremal[view]'"
        ) from None
    return pv


def draw(
    shape: Shape,
    colour_range: tuple[float, float],
    surfaces: Sequence[Surface],
    see_through: bool,
    view: View,
    size: tuple[int, int],
    title: str,
) -> NDArray[Any]:
    """Return colours (height, width, 3), from 0 to 1, of a body among obstacles.

    Parameters
    ----------
    colour_range : (float, float)
        Values of the ends of the colour bar.
    see_through : bool
        Obstacles hide the body; they become glass, all but planes.
    view : View
        Of a plane body the eye's distance says how much of it is seen, straight from above.
    title : str
        Words in a corner.
    """
    pv = pyvista()
    plotter = pv.Plotter(off_screen=True, window_size=list(size), lighting="none")
    try:
        plotter.set_background("white")
        if not shape.planar:
            _light(pv, plotter, view)
        _add_body(pv, plotter, shape, colour_range, size)
        for surface in surfaces:
            mesh = pv.PolyData(surface.points, np.insert(surface.triangles, 0, 3, axis=1).ravel())
            glass = GLASS if see_through and not surface.endless else 1.0
            plotter.add_mesh(mesh, color=OBSTACLE, opacity=glass, smooth_shading=True, split_sharp_edges=True,
                             lighting=not shape.planar, ambient=AMBIENT, specular=0.1)  # fmt: skip
        if see_through:
            plotter.enable_depth_peeling(6)
        plotter.add_text(title, position="upper_left", font_size=max(6, round(size[1] / 60)), color="black")
        _look(plotter, view, shape.planar)
        plotter.enable_anti_aliasing("ssaa")
        return np.asarray(plotter.screenshot(return_img=True), dtype=float)[..., :3] / 255
    finally:
        plotter.close()


def _add_body(
    pv: Any, plotter: Any, shape: Shape, colour_range: tuple[float, float], size: tuple[int, int]
) -> None:
    corners = shape.facets.shape[1]
    points, first = np.unique(shape.facets.reshape(-1, 3), axis=0, return_inverse=True)
    facets = first.reshape(-1, corners)
    faces = np.insert(facets, 0, corners, axis=1).ravel()
    body = pv.PolyData(points, faces) if corners == 3 else pv.PolyData(points)
    values = np.array(shape.values, dtype=float)
    values[shape.inverted] = np.nan
    body.cell_data["values"] = values
    plotter.add_mesh(
        body,
        scalars="values",
        clim=colour_range,
        cmap=COLOURS,
        nan_color=INVERTED,
        show_edges=len(facets) <= EDGES_UP_TO,
        edge_color="#20252b",
        line_width=max(0.6, size[1] / 900),
        lighting=not shape.planar,
        ambient=AMBIENT,
        specular=0.1,
        show_scalar_bar=False,
    )
    if shape.quantity:
        plotter.add_scalar_bar(
            title="",
            color="black",
            n_labels=6,
            fmt="%.3g",
            label_font_size=max(9, size[1] // 50),
            width=0.4,
            height=0.07,
            position_x=0.3,
            position_y=0.015,
        )
        words = shape.quantity + (" (red: inverted)" if shape.inverted.any() else "")
        plotter.add_text(words, position=(0.3, 0.078), viewport=True, font_size=max(6, size[1] // 90), color="black")


def _light(pv: Any, plotter: Any, view: View) -> None:
    right, away, up = view.axes
    for direction, strength in (
        (-0.5 * right - 0.6 * away + 0.8 * up, 0.62),
        (0.9 * right - 0.4 * away + 0.3 * up, 0.38),
        (-away, 0.2),
    ):
        plotter.add_light(pv.Light(position=direction, light_type="scene light", intensity=strength))


def _look(plotter: Any, view: View, planar: bool) -> None:
    camera = plotter.camera
    camera.position = view.eye
    camera.focal_point = view.middle if planar else view.eye + view.axes[1] * view.reach
    camera.up = view.axes[2]
    camera.view_angle = float(2 * np.degrees(np.arctan(OPENING)))
    if planar:
        camera.enable_parallel_projection()
        camera.parallel_scale = float(OPENING * np.linalg.norm(view.eye - view.middle))
    plotter.renderer.reset_camera_clipping_range()
