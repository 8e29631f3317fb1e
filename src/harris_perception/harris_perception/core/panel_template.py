"""What a panel's face looks like from its layout alone: the picture that recognition searches for."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from harris_perception.core.stroke_font import strokes
from icu_common.core.geometry import Array
from icu_common.core.panel_layout import Artwork, Circle, Control, Line, PanelLayout, Rectangle, rgb

_SUPERSAMPLING = 3
_SHIFT = 4  # OpenCV draws to 1/16 px


@dataclass(frozen=True, slots=True, eq=False)
class PanelTemplate:
    """The face seen straight on.

    Attributes
    ----------
    gray
        (H, W) uint8.
    steady
        (H, W) bool: printed on the face itself; neither on a proud control, nor on a screen or a lamp that changes.
    px_per_mm
        Scale; the panel's lower left corner is the picture's.
    """

    gray: npt.NDArray[np.uint8]
    steady: npt.NDArray[np.bool_]
    px_per_mm: float

    @property
    def px_from_mm(self) -> Array:
        """(3, 3) homography from the panel's mm (y up) to pixels (y down, the centre of the first is (0, 0))."""
        return px_from_mm(self.gray.shape[0], self.px_per_mm)


def px_from_mm(height_px: int, px_per_mm: float) -> Array:
    """Return the (3, 3) homography from mm (y up) to pixels (y down) of a picture ``height_px`` high."""
    return np.array([[px_per_mm, 0.0, -0.5], [0.0, -px_per_mm, height_px - 0.5], [0.0, 0.0, 1.0]])


def draw_panel(layout: PanelLayout, px_per_mm: float) -> npt.NDArray[np.uint8]:
    """Draw the face, (H, W, 3) uint8 BGR: artwork in order, then the controls as flat shapes.

    Raises
    ------
    ValueError
        If the picture would have less than 16 or more than 8192 pixels on a side.
    """
    width, height = (round(side * px_per_mm) for side in layout.size_mm)
    if not (min(width, height) >= 16 and max(width, height) <= 8192):
        raise ValueError(f"{width} x {height} px at {px_per_mm:g} px/mm: sides from 16 to 8192 px are needed")
    canvas = _Canvas(width, height, px_per_mm, layout.colour)
    for item in layout.artwork:
        canvas.artwork(item)
    for control in layout.controls:
        canvas.control(control)
    return canvas.picture()


def panel_template(
    layout: PanelLayout, px_per_mm: float, picture: npt.NDArray[Any] | None = None, picture_px_per_mm: float = 0.0
) -> PanelTemplate:
    """Make the template at ``px_per_mm`` from the layout's drawing, or from a picture of the face.

    Parameters
    ----------
    layout
        Size, controls and (without a picture) artwork.
    px_per_mm
        Scale of the template.
    picture
        (H, W) or (H, W, 3) BGR uint8: the face seen straight on, from edge to edge.
    picture_px_per_mm
        Scale of ``picture``.

    Raises
    ------
    ValueError
        If the picture's size does not fit the layout's (1 % or 2 px).
    """
    if picture is None:
        bgr: npt.NDArray[Any] = draw_panel(layout, px_per_mm)
    else:
        wanted = np.array(layout.size_mm) * picture_px_per_mm
        found = np.array(picture.shape[1::-1])
        if (np.abs(wanted - found) > np.maximum(2.0, 0.01 * wanted)).any():
            raise ValueError(
                f"the template picture has {found[0]} x {found[1]} px, the layout's {layout.size_mm[0]:g} x "
                f"{layout.size_mm[1]:g} mm at {picture_px_per_mm:g} px/mm are {wanted[0]:.0f} x {wanted[1]:.0f} px"
            )
        size = tuple(round(side * px_per_mm) for side in layout.size_mm)
        smaller = px_per_mm < picture_px_per_mm
        bgr = cv2.resize(picture, size, interpolation=cv2.INTER_AREA if smaller else cv2.INTER_LINEAR)
    gray = bgr if bgr.ndim == 2 else cv2.cvtColor(bgr, cv2.COLOR_BGR2GRAY)
    steady = np.ones(gray.shape, np.uint8)
    for control in layout.controls:
        if control.height_mm > 0 or control.kind == "touch_area" or control.lit_colour:
            cv2.fillPoly(steady, [_polygon_px(outline_mm(control), gray.shape[0], px_per_mm)], 0, cv2.LINE_8, _SHIFT)
    return PanelTemplate(np.ascontiguousarray(gray, dtype=np.uint8), steady.astype(bool), px_per_mm)


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
    """Return where proud controls cover the face for a camera at ``viewpoint_mm``: a (H, W) bool picture.

    A point at height h over the face at p hides the face at ``p + (p - c) h / (c_z - h)`` from a camera at c; the hull
    of footprint and hidden top is what the control and its sides cover.

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
    """A supersampled picture with millimetres as its coordinates."""

    def __init__(self, width: int, height: int, px_per_mm: float, colour: str) -> None:
        self.size = (width, height)
        self.scale = px_per_mm * _SUPERSAMPLING
        self.pixels = np.full((height * _SUPERSAMPLING, width * _SUPERSAMPLING, 3), _bgr(colour), np.uint8)

    def picture(self) -> npt.NDArray[np.uint8]:
        return np.asarray(cv2.resize(self.pixels, self.size, interpolation=cv2.INTER_AREA), dtype=np.uint8)

    def artwork(self, item: Artwork) -> None:
        if isinstance(item, Rectangle):
            x, y, width, height = item.rectangle_mm
            corners = np.array([(x, y), (x + width, y), (x + width, y + height), (x, y + height)])
            self.shape(corners, item.fill, item.outline, item.line_mm)
        elif isinstance(item, Circle):
            x, y, radius = item.circle_mm
            angle = np.arange(72) * (2 * np.pi / 72)
            corners = np.array((x, y)) + radius * np.column_stack([np.cos(angle), np.sin(angle)])
            self.shape(corners, item.fill, item.outline, item.line_mm)
        elif isinstance(item, Line):
            x0, y0, x1, y1 = item.line_from_to_mm
            self.lines([np.array([(x0, y0), (x1, y1)])], item.colour, item.line_mm)
        else:
            placed = [stroke + item.at_mm for stroke in strokes(item.text, item.height_mm)]
            self.lines(placed, item.colour, item.line_mm)

    def control(self, control: Control) -> None:
        self.shape(outline_mm(control), control.colour, "", 0.0)

    def shape(self, corners_mm: Array, fill: str, outline: str, line_mm: float) -> None:
        if fill:
            polygon = _polygon_px(corners_mm, self.pixels.shape[0], self.scale)
            cv2.fillPoly(self.pixels, [polygon], _bgr(fill), cv2.LINE_AA, _SHIFT)
        if outline:
            self.lines([np.vstack([corners_mm, corners_mm[:1]])], outline, line_mm)

    def lines(self, polylines_mm: list[Array], colour: str, line_mm: float) -> None:
        pixels = [_polygon_px(line, self.pixels.shape[0], self.scale) for line in polylines_mm]
        thickness = max(1, round(line_mm * self.scale))
        cv2.polylines(self.pixels, pixels, False, _bgr(colour), thickness, cv2.LINE_AA, _SHIFT)


def _bgr(colour: str) -> tuple[int, int, int]:
    red, green, blue = rgb(colour)
    return blue, green, red
