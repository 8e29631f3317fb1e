"""Draws the panel's printed face from its layout, with edges accurate to a small part of a texel.

Coverage is computed from distances: the rounding of a drawing library to whole pixels would move the artwork.
Texel (row, column) covers ``column / s <= x < (column + 1) / s`` and the same from the top in y, ``s`` texels per mm.
"""

from __future__ import annotations

import itertools

import numpy as np
import numpy.typing as npt

from icu_common.core.geometry.geometry import Array
from icu_common.core.panel.panel_layout import (
    ArtworkCircle,
    ArtworkLine,
    ArtworkRectangle,
    ArtworkText,
    Control,
    PanelLayout,
    rgb,
)
from icu_common.core.panel.stroke_font import text_strokes

Picture = npt.NDArray[np.uint8]


def bgr(colour: str) -> Array:
    """Return (3,) blue, green, red of a colour such as ``#ff8800``."""
    return np.array(rgb(colour)[::-1], dtype=np.float64)


class Canvas:
    """An image of a rectangle in millimetres, y up, origin at its lower left corner.

    Parameters
    ----------
    size_mm
        Width and height.
    per_mm
        Texels per millimetre.
    colour
        Background colour, ``#rrggbb``.
    """

    def __init__(self, size_mm: tuple[float, float], per_mm: float, colour: str) -> None:
        self.per_mm = per_mm
        self.height_mm = size_mm[1]
        shape = (round(size_mm[1] * per_mm), round(size_mm[0] * per_mm), 3)
        self.picture: Picture = np.empty(shape, np.uint8)
        self.picture[:] = bgr(colour)

    def rectangle(self, x: float, y: float, width: float, height: float, colour: str) -> None:
        """Fill a rectangle from its lower left corner; a texel at the edge gets the covered share."""
        rows, columns, xs, ys = self._window(x, y, x + width, y + height)
        half = 0.5 / self.per_mm
        share_x = np.clip(np.minimum(xs + half, x + width) - np.maximum(xs - half, x), 0, None)
        share_y = np.clip(np.minimum(ys + half, y + height) - np.maximum(ys - half, y), 0, None)
        self._blend(rows, columns, np.outer(share_y, share_x) * self.per_mm**2, colour)

    def frame(self, x: float, y: float, width: float, height: float, line_mm: float, colour: str) -> None:
        """Draw an outline with the middle of the line on the edge."""
        half = line_mm / 2
        self.rectangle(x - half, y - half, width + line_mm, line_mm, colour)
        self.rectangle(x - half, y + height - half, width + line_mm, line_mm, colour)
        self.rectangle(x - half, y + half, line_mm, height - line_mm, colour)
        self.rectangle(x + width - half, y + half, line_mm, height - line_mm, colour)

    def ring(self, x: float, y: float, inner: float, outer: float, colour: str) -> None:
        """Fill the ring between two radii; ``inner`` below 0 fills the whole disc."""
        rows, columns, xs, ys = self._window(x - outer, y - outer, x + outer, y + outer)
        radius = np.hypot(xs[None, :] - x, ys[:, None] - y)
        share = self._share(outer - radius) - (self._share(inner - radius) if inner > 0 else 0)
        self._blend(rows, columns, share, colour)

    def polyline(self, points: Array, line_mm: float, colour: str) -> None:
        """Draw (N, 2) points with round ends and corners."""
        half = line_mm / 2
        low, high = points.min(axis=0) - half, points.max(axis=0) + half
        rows, columns, xs, ys = self._window(low[0], low[1], high[0], high[1])
        distance = np.full((len(ys), len(xs)), np.inf)
        for start, end in itertools.pairwise(points):
            along = end - start
            length2 = float(along @ along)
            dx, dy = xs[None, :] - start[0], ys[:, None] - start[1]
            t = np.clip((dx * along[0] + dy * along[1]) / length2, 0, 1) if length2 > 0 else np.zeros_like(dx + dy)
            np.minimum(distance, np.hypot(dx - t * along[0], dy - t * along[1]), out=distance)
        self._blend(rows, columns, self._share(half - distance), colour)

    def text(self, text: str, at: tuple[float, float], height_mm: float, line_mm: float, colour: str) -> None:
        """Print capitals centred at ``at``."""
        for stroke in text_strokes(text, at, height_mm):
            self.polyline(stroke, line_mm, colour)

    def _share(self, inside_mm: Array) -> Array:
        return np.clip(inside_mm * self.per_mm + 0.5, 0, 1)

    def _window(self, x0: float, y0: float, x1: float, y1: float) -> tuple[slice, slice, Array, Array]:
        rows, columns = self.picture.shape[:2]
        s = self.per_mm
        c0, c1 = (int(np.clip(v, 0, columns)) for v in (np.floor(x0 * s) - 1, np.ceil(x1 * s) + 1))
        top, bottom = (self.height_mm - y1) * s, (self.height_mm - y0) * s
        r0, r1 = (int(np.clip(v, 0, rows)) for v in (np.floor(top) - 1, np.ceil(bottom) + 1))
        xs = (np.arange(c0, c1, dtype=np.float64) + 0.5) / s
        ys = self.height_mm - (np.arange(r0, r1, dtype=np.float64) + 0.5) / s
        return slice(r0, r1), slice(c0, c1), xs, ys

    def _blend(self, rows: slice, columns: slice, share: Array, colour: str) -> None:
        ground = self.picture[rows, columns]
        mixed = ground + (bgr(colour) - ground) * share[..., None]
        self.picture[rows, columns] = np.rint(mixed).astype(np.uint8)


def draw_face(layout: PanelLayout, per_mm: float) -> Picture:
    """Return the printed face, (height * per_mm, width * per_mm, 3) BGR, without protruding parts."""
    canvas = Canvas(layout.size_mm, per_mm, layout.colour)
    for item in layout.artwork:
        if isinstance(item, ArtworkRectangle):
            x, y, width, height = item.rectangle_mm
            if item.fill:
                canvas.rectangle(x, y, width, height, item.fill)
            if item.outline:
                canvas.frame(x, y, width, height, item.line_mm, item.outline)
        elif isinstance(item, ArtworkCircle):
            x, y, radius = item.circle_mm
            if item.fill:
                canvas.ring(x, y, -1.0, radius, item.fill)
            if item.outline:
                canvas.ring(x, y, radius - item.line_mm / 2, radius + item.line_mm / 2, item.outline)
        elif isinstance(item, ArtworkLine):
            x0, y0, x1, y1 = item.line_from_to_mm
            canvas.polyline(np.array([[x0, y0], [x1, y1]]), item.line_mm, item.colour)
        elif isinstance(item, ArtworkText):
            canvas.text(item.text, item.at_mm, item.height_mm, item.line_mm, item.colour)
    for control in layout.controls:
        if control.height_mm == 0:
            _flat(canvas, control)
    return canvas.picture


def _flat(canvas: Canvas, control: Control) -> None:
    (x, y), (width, height) = control.position_mm, control.size_mm
    if control.shape == "circle":
        canvas.ring(x, y, -1.0, width / 2, control.colour)
    else:
        canvas.rectangle(x - width / 2, y - height / 2, width, height, control.colour)
