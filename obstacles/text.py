"""Words as solid shapes (figures 7.2, 7.10)."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .geometry import BodyError, central_gradient, intersection, intersection_gradient, positive, unit, vector
from .samples import Samples

PIXELS = 256  # that a line of text is high: letters are true to half a per cent of their height


class Text:
    """Letters cut out of a plate; in 2D their outlines filled.

    Parameters
    ----------
    text : str
        May have several lines, separated by a newline.
    height : float [m]
        From the lowest to the highest point of the letters, all lines together.
    thickness : float [m]
        Of the plate; 3D only.
    center : (D,) [m]
        Centre of the box that just holds the letters.
    right, up : (D,)
        Directions of reading and of the letters' tops; default the first and the last axis.
    font : str
        A TrueType font: a file, or a file's name in the system's font folders.

    Raises
    ------
    BodyError
        If nothing would be drawn, or the font is not found.
    """

    def __init__(
        self,
        text: str,
        height: float,
        thickness: float | None = None,
        center: ArrayLike = (0, 0, 0),
        right: ArrayLike | None = None,
        up: ArrayLike | None = None,
        font: str = "DejaVuSans-Bold.ttf",
    ) -> None:
        self.center = vector("text", "center", center)
        dim = len(self.center)
        axes = np.eye(dim)
        across = unit("text", "right", axes[0] if right is None else vector("text", "right", right, dim))
        upward = axes[-1] if up is None else vector("text", "up", up, dim)
        frame = [across, unit("text", "up", upward - (upward @ across) * across)]
        if dim == 3:
            if thickness is None:
                raise BodyError("text: thickness is missing; in 3D letters need a positive thickness [m]")
            frame.append(np.cross(frame[0], frame[1]))
            self._depth = positive("text", "thickness", thickness)
        self._frame = np.array(frame)
        mask = _drawn(text, font)
        pixel = positive("text", "height", height) / mask.shape[1]
        self.size = pixel * np.array(mask.shape)  # width and height [m]
        self._flat = _level_set(mask, pixel)

    def bounds(self) -> tuple[NDArray, NDArray]:
        """Corners (D,) [m] of a box that encloses the letters."""
        half = np.append(self.size, self._depth if len(self.center) == 3 else [])[: len(self.center)] / 2
        reach = half @ np.abs(self._frame)
        return self.center - reach, self.center + reach

    def inside(self, x: NDArray) -> NDArray:
        return self.distance(x) <= 0

    def distance(self, x: NDArray) -> NDArray:
        return intersection(self._parts((x - self.center) @ self._frame.T))

    def normal(self, x: NDArray) -> NDArray:
        """∇φ (n, D) at points (n, D) [m]."""
        local = (x - self.center) @ self._frame.T
        gradients = np.zeros((len(x), x.shape[1] - 1, x.shape[1]))
        gradients[:, 0, :2] = central_gradient(self._flat.distance, local[:, :2], float(self._flat.spacing))
        if x.shape[1] == 3:
            gradients[:, 1, 2] = np.where(local[:, 2] < 0, -1.0, 1.0)
        return intersection_gradient(self._parts(local), gradients) @ self._frame

    def _parts(self, local: NDArray) -> NDArray:
        flat = self._flat.distance(local[:, :2])[:, None]
        return flat if local.shape[1] == 2 else np.hstack([flat, np.abs(local[:, 2:]) - self._depth / 2])


def _drawn(text: str, font: str) -> NDArray:
    """Which pixels are ink (width, height) bool, x to the right, y upwards, without margin."""
    # Pillow and the font come with Debian's matplotlib, yet load in a tenth of its time. A bitmap leaves kerning,
    # curves and holes to FreeType, and asking it where a point is costs the same for any text, unlike outlines.
    from PIL import Image, ImageDraw, ImageFont

    try:
        face = ImageFont.truetype(font, PIXELS)
    except OSError:
        raise BodyError(f'text: font "{font}" is not found; give a TrueType file') from None
    left, top, right, bottom = ImageDraw.Draw(Image.new("L", (1, 1))).textbbox((0, 0), text, font=face)
    ink = np.zeros((0, 0), dtype=bool)
    if right > left and bottom > top:
        image = Image.new("L", (int(right - left) + 2, int(bottom - top) + 2))
        ImageDraw.Draw(image).text((1 - left, 1 - top), text, fill=255, font=face)
        ink = np.asarray(image)[::-1].T >= 128
    if not ink.any():
        raise BodyError(f'text: nothing to draw in "{text}"; give letters which the font has')
    columns, rows = np.flatnonzero(ink.any(axis=1)), np.flatnonzero(ink.any(axis=0))
    return ink[columns[0] : columns[-1] + 1, rows[0] : rows[-1] + 1]


def _level_set(ink: NDArray, pixel: float) -> Samples:
    """Signed distance at the pixels' centres, with the ink's centre at the origin."""
    from scipy.ndimage import distance_transform_edt

    padded = np.pad(ink, 2)
    # between an ink pixel and its neighbour the edge is half a pixel from either
    phi = distance_transform_edt(~padded) - distance_transform_edt(padded)
    phi -= 0.5 * np.sign(phi)
    return Samples(pixel * phi, -pixel * (np.array(padded.shape) - 1) / 2, pixel)
