"""Draws a panel's face from its layout alone: the image that recognition searches."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from icu_common.core.geometry.geometry import Array
from icu_common.core.panel.panel_layout import (
    Artwork,
    ArtworkCircle,
    ArtworkLine,
    ArtworkRectangle,
    ArtworkText,
    Control,
    PanelLayout,
    rgb,
)
from icu_common.core.panel.stroke_font import text_strokes
from icu_common.core.reasons.message import Message

_SHIFT = 4  # OpenCV draws to 1/16 px


@dataclass(frozen=True, slots=True, eq=False)
class PanelTemplate:
    """The face seen straight on.

    Attributes
    ----------
    gray
        (H, W) uint8.
    steady
        (H, W) bool: printed on the face itself, not on a raised control, a screen, or a lamp, which changes.
    exact
        (H, W) bool: steady, and accurate to the tenth of a millimetre in the layout. Drawn text is not: a maker's
        typeface has other shapes and widths than ours.
    px_per_mm
        Scale; the panel's lower left corner is that of the image.
    px_from_mm
        (3, 3) homography from the panel's mm (y up) to pixels (y down, the centre of the first is (0, 0)). An image of
        the face is reduced to whole pixels, which changes its scale slightly, and separately along each axis.
    """

    gray: npt.NDArray[np.uint8]
    steady: npt.NDArray[np.bool_]
    exact: npt.NDArray[np.bool_]
    px_per_mm: float
    px_from_mm: Array


def px_from_mm(height_px: int, px_per_mm: float | tuple[float, float]) -> Array:
    """Return the (3, 3) homography from mm (y up) to pixels (y down) of an image ``height_px`` high.

    The scale is one number, or one for x and one for y.
    """
    x, y = px_per_mm if isinstance(px_per_mm, tuple) else (px_per_mm, px_per_mm)
    return np.array([[x, 0.0, -0.5], [0.0, -y, height_px - 0.5], [0.0, 0.0, 1.0]])


def edge_to_edge(size_px: tuple[int, int], size_mm: tuple[float, float]) -> Array:
    """Return the (3, 3) homography from mm to pixels of an image (width, height) that shows a face up to its edges."""
    return px_from_mm(size_px[1], (size_px[0] / size_mm[0], size_px[1] / size_mm[1]))


def draw_panel(layout: PanelLayout, px_per_mm: float) -> npt.NDArray[np.uint8]:
    """Draw the face, (H, W, 3) uint8 BGR: artwork in order, then the controls as flat shapes.

    Raises
    ------
    ValueError
        If the image would have less than 16 or more than 8192 pixels on a side, or the font lacks a character.
    """
    width, height = (round(side * px_per_mm) for side in layout.size_mm)
    if not (min(width, height) >= 16 and max(width, height) <= 8192):
        raise ValueError(Message("template.sides_16_8192_needed", width=width, height_px=height, px_per_mm=px_per_mm))
    canvas = _Canvas(width, height, px_per_mm, layout.colour)
    for item in layout.artwork:
        canvas.artwork(item)
    for control in layout.controls:
        canvas.control(control)
    return canvas.picture()


def panel_template(
    layout: PanelLayout, px_per_mm: float, picture: npt.NDArray[Any] | None = None, picture_px_per_mm: float = 0.0
) -> PanelTemplate:
    """Make the template at ``px_per_mm`` from the layout's drawing, or from an image of the face.

    Parameters
    ----------
    layout
        Size, controls and (without an image) artwork.
    px_per_mm
        Scale of the template.
    picture
        (H, W) or (H, W, 3) BGR uint8: the face seen straight on, from edge to edge.
    picture_px_per_mm
        Scale of ``picture``.

    Raises
    ------
    ValueError
        If the image's size does not fit the layout's (1 % or 2 px).
    """
    if picture is None:
        bgr: npt.NDArray[Any] = draw_panel(layout, px_per_mm)
        from_mm = px_from_mm(bgr.shape[0], px_per_mm)
    else:
        wanted = np.array(layout.size_mm) * picture_px_per_mm
        found = np.array(picture.shape[1::-1])
        if (np.abs(wanted - found) > np.maximum(2.0, 0.01 * wanted)).any():
            raise ValueError(
                Message(
                    "template.template_picture_layout",
                    found=found[0],
                    found_px=found[1],
                    size_mm=layout.size_mm[0],
                    size_2_mm=layout.size_mm[1],
                    picture_px_per_mm=picture_px_per_mm,
                    wanted=wanted[0],
                    wanted_px=wanted[1],
                )
            )
        size = round(layout.size_mm[0] * px_per_mm), round(layout.size_mm[1] * px_per_mm)
        smaller = px_per_mm < picture_px_per_mm
        bgr = cv2.resize(picture, size, interpolation=cv2.INTER_AREA if smaller else cv2.INTER_LINEAR)
        from_mm = edge_to_edge(size, layout.size_mm)
    gray = bgr if bgr.ndim == 2 else cv2.cvtColor(bgr, cv2.COLOR_BGR2GRAY)
    steady = np.ones(gray.shape, np.uint8)
    for control in layout.controls:
        if control.height_mm > 0 or control.kind == "touch_area" or control.lit_colour:
            cv2.fillPoly(steady, [_polygon_px(outline_mm(control), gray.shape[0], px_per_mm)], 0, cv2.LINE_8, _SHIFT)
    exact = steady.copy()
    for item in layout.artwork if picture is None else ():
        if isinstance(item, ArtworkText):
            cv2.fillPoly(exact, [_polygon_px(_text_box_mm(item), gray.shape[0], px_per_mm)], 0, cv2.LINE_8, _SHIFT)
    return PanelTemplate(
        gray=np.ascontiguousarray(gray, dtype=np.uint8),
        steady=steady.astype(bool),
        exact=exact.astype(bool),
        px_per_mm=px_per_mm,
        px_from_mm=from_mm,
    )


def _text_box_mm(item: ArtworkText) -> Array:
    """Return the corners of a box that contains the text in any usual typeface."""
    lines = text_strokes(item.text, (0.0, 0.0), item.height_mm)
    half_width = max((float(np.abs(line[:, 0]).max()) for line in lines), default=0.0) * 1.25 + item.line_mm
    half_height = 0.65 * item.height_mm + item.line_mm
    corners = np.array([(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)])
    return np.asarray(corners * (half_width, half_height) + item.at_mm)


def outline_mm(control: Control) -> Array:
    """Return the control's outline on the face as a polygon, (N, 2) mm."""
    half = np.array(control.size_mm) / 2
    if control.shape == "circle":
        angle = np.arange(24) * (2 * np.pi / 24)
        corners = np.column_stack([np.cos(angle), np.sin(angle)])
    else:
        corners = np.array([(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)])
    return np.asarray(np.array(control.position_mm) + corners * half)


def hidden_by_controls(layout: PanelLayout, viewpoint_mm: Array, shape: tuple[int, int], px_per_mm: float) -> Any:
    """Return where raised controls hide the face from a camera at ``viewpoint_mm``: a (H, W) bool image.

    A point at height h above the face at p hides the face at ``p + (p - c) h / (c_z - h)`` from a camera at c. The
    control and its sides hide the convex hull of its footprint and of the area hidden by its top.

    Parameters
    ----------
    viewpoint_mm
        (3,) the camera's centre in the panel's axes, z towards the viewer.
    shape
        (H, W) of the result.
    px_per_mm
        Scale of the result.
    """
    covered = np.zeros(shape, np.uint8)
    for control in layout.controls:
        if 0 < control.height_mm < viewpoint_mm[2]:
            foot = outline_mm(control)
            top = foot + (foot - viewpoint_mm[:2]) * control.height_mm / (viewpoint_mm[2] - control.height_mm)
            hull = cv2.convexHull(np.vstack([foot, top]).astype(np.float32))[:, 0]
            cv2.fillPoly(covered, [_polygon_px(hull, shape[0], px_per_mm)], 1, cv2.LINE_8, _SHIFT)
    return covered.astype(bool)


def _polygon_px(points_mm: npt.NDArray[Any], height_px: int, px_per_mm: float) -> npt.NDArray[np.int32]:
    uv = points_mm @ np.diag([px_per_mm, -px_per_mm]) + (-0.5, height_px - 0.5)
    return np.rint(uv * (1 << _SHIFT)).astype(np.int32)


class _Canvas:
    """An image with millimetres as its coordinates.

    A pixel's weight is the share of it that a shape covers, computed from the distance to the shape's edge. OpenCV's
    drawing rounds to whole pixels, which would move edges by more than the measurement's accuracy.
    """

    def __init__(self, width: int, height: int, px_per_mm: float, colour: str) -> None:
        self.scale = px_per_mm
        self.pixels = np.full((height, width, 3), _bgr(colour), np.float32)

    def picture(self) -> npt.NDArray[np.uint8]:
        return np.rint(self.pixels).astype(np.uint8)

    def artwork(self, item: Artwork) -> None:
        if isinstance(item, ArtworkRectangle):
            x, y, width, height = item.rectangle_mm
            self.rectangle(x, y, width, height, item.fill)
            self.frame(x, y, width, height, item.outline, item.line_mm)
        elif isinstance(item, ArtworkCircle):
            x, y, radius = item.circle_mm
            self.ring(x, y, -1.0, radius, item.fill)
            self.ring(x, y, radius - item.line_mm / 2, radius + item.line_mm / 2, item.outline)
        elif isinstance(item, ArtworkLine):
            x0, y0, x1, y1 = item.line_from_to_mm
            self.lines([np.array([(x0, y0), (x1, y1)])], item.colour, item.line_mm)
        else:
            self.lines(text_strokes(item.text, item.at_mm, item.height_mm), item.colour, item.line_mm)

    def control(self, control: Control) -> None:
        (x, y), (width, height) = control.position_mm, control.size_mm
        if control.shape == "circle":
            self.ring(x, y, -1.0, width / 2, control.colour)
        else:
            self.rectangle(x - width / 2, y - height / 2, width, height, control.colour)

    def rectangle(self, x: float, y: float, width: float, height: float, colour: str) -> None:
        window, xs, ys = self._window(x, y, x + width, y + height)
        across = self._share(np.abs(xs - x - width / 2) - width / 2)
        up = self._share(np.abs(ys - y - height / 2) - height / 2)
        self._blend(window, up * across, colour)

    def frame(self, x: float, y: float, width: float, height: float, colour: str, line_mm: float) -> None:
        """Draw an outline with square corners; the middle of its line lies on the rectangle."""
        half = line_mm / 2
        window, xs, ys = self._window(x - half, y - half, x + width + half, y + height + half)
        across, up = np.abs(xs - x - width / 2) - width / 2, np.abs(ys - y - height / 2) - height / 2
        inside = self._share(across + half) * self._share(up + half)
        self._blend(window, self._share(across - half) * self._share(up - half) - inside, colour)

    def ring(self, x: float, y: float, inner: float, outer: float, colour: str) -> None:
        window, xs, ys = self._window(x - outer, y - outer, x + outer, y + outer)
        radius = np.hypot(xs - x, ys - y)
        self._blend(window, self._share(radius - outer) * (1 - self._share(radius - inner)), colour)

    def lines(self, polylines_mm: list[Array], colour: str, line_mm: float) -> None:
        """Draw polylines with round ends."""
        half = line_mm / 2
        for line in polylines_mm:
            low, high = line.min(axis=0) - half, line.max(axis=0) + half
            window, xs, ys = self._window(low[0], low[1], high[0], high[1])
            distance = np.full((ys.size, xs.size), np.inf)
            for start, end in itertools.pairwise(line):
                length = float(np.hypot(*(end - start)))
                if length == 0.0:
                    continue
                ux, uy = (end - start) / length
                along = (xs - start[0]) * ux + (ys - start[1]) * uy
                beyond = np.abs(along - length / 2) - length / 2
                beside = np.abs((ys - start[1]) * ux - (xs - start[0]) * uy)
                np.minimum(distance, np.hypot(np.maximum(beyond, 0), beside), out=distance)
            self._blend(window, self._share(distance - half), colour)

    def _window(self, x0: float, y0: float, x1: float, y1: float) -> tuple[tuple[slice, slice], Array, Array]:
        """Return rows and columns around a box in mm, and the mm of their centres, (1, W) and (H, 1)."""
        height, width = self.pixels.shape[:2]
        left, right = (int(np.clip(np.floor(v * self.scale) + d, 0, width)) for v, d in ((x0, -1), (x1, 2)))
        top, bottom = (int(np.clip(np.floor(height - v * self.scale) + d, 0, height)) for v, d in ((y1, -1), (y0, 2)))
        xs: Array = (np.arange(left, right, dtype=np.float64) + 0.5) / self.scale
        ys: Array = (height - np.arange(top, bottom, dtype=np.float64) - 0.5) / self.scale
        return (slice(top, bottom), slice(left, right)), xs[None, :], ys[:, None]

    def _share(self, distance_mm: Array) -> Array:
        return np.asarray(np.clip(0.5 - distance_mm * self.scale, 0.0, 1.0))

    def _blend(self, window: tuple[slice, slice], share: Array, colour: str) -> None:
        if colour:
            under = self.pixels[window]
            under += share[..., None].astype(np.float32) * (np.array(_bgr(colour), np.float32) - under)


def _bgr(colour: str) -> tuple[int, int, int]:
    red, green, blue = rgb(colour)
    return blue, green, red
