"""Drawings of the report: SVG plots on the panel's face, and marks in the camera images."""

from __future__ import annotations

import html
from collections.abc import Sequence

import cv2
import numpy as np
import numpy.typing as npt

from gantry_driver.acceptance.measured import CameraSnapshot, Measured, MeasuredTouch
from icu_common.core.geometry.geometry import Array

_WIDTH = 640.0
_MARGIN = 40.0
GOOD, BAD, LINE = "#1a7f37", "#b3261e", "#57606a"


class Plot:
    """An SVG drawing of an area in millimetres, y up, with a frame, a scale bar and a caption."""

    def __init__(self, points_mm: Array, caption: str) -> None:
        self._low, high = points_mm.min(axis=0) - 8.0, points_mm.max(axis=0) + 8.0
        size = np.maximum(high - self._low, 10.0)
        self._scale = (_WIDTH - 2 * _MARGIN) / float(size[0])
        self._height = float(size[1]) * self._scale + 2 * _MARGIN
        self._parts: list[str] = []
        self._caption = caption

    def at(self, point_mm: Array) -> tuple[float, float]:
        """Return the position of a point in the drawing."""
        x, y = (np.asarray(point_mm) - self._low) * self._scale
        return _MARGIN + float(x), self._height - _MARGIN - float(y)

    def outline(self, corners_mm: Array) -> None:
        points = " ".join(f"{x:.1f},{y:.1f}" for x, y in map(self.at, corners_mm))
        self._parts.append(f'<polygon points="{points}" fill="#f6f8fa" stroke="{LINE}"/>')

    def dot(self, point_mm: Array, radius: float, colour: str, title: str = "") -> None:
        x, y = self.at(point_mm)
        text = f"<title>{html.escape(title)}</title>" if title else ""
        self._parts.append(f'<circle cx="{x:.1f}" cy="{y:.1f}" r="{radius:.1f}" fill="{colour}">{text}</circle>')

    def label(self, point_mm: Array, text: str) -> None:
        """Write a text above a point, to its left near the right border."""
        x, y = self.at(point_mm)
        side, anchor = (-6.0, "end") if x > 0.8 * _WIDTH else (6.0, "start")
        words = html.escape(text)
        self._parts.append(
            f'<text x="{x + side:.1f}" y="{y - 6:.1f}" font-size="11" text-anchor="{anchor}" fill="{LINE}">'
            f"{words}</text>"
        )

    def arrow(self, point_mm: Array, way_mm: Array, colour: str) -> None:
        """Draw a vector; its length is in millimetres of the drawing."""
        (x0, y0), (x1, y1) = self.at(point_mm), self.at(np.asarray(point_mm) + way_mm)
        self._parts.append(
            f'<line x1="{x0:.1f}" y1="{y0:.1f}" x2="{x1:.1f}" y2="{y1:.1f}" stroke="{colour}" stroke-width="2"/>'
        )

    def svg(self) -> str:
        bar = 50.0 * self._scale
        y = self._height - 14
        return (
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {_WIDTH:g} {self._height:.0f}" '
            f'width="{_WIDTH:g}" height="{self._height:.0f}" font-family="sans-serif" role="img">'
            f'<rect width="100%" height="100%" fill="#fff"/>'
            f'<text x="{_MARGIN:g}" y="22" font-size="14" fill="#1f2328">{html.escape(self._caption)}</text>'
            + "".join(self._parts)
            + f'<line x1="{_MARGIN:g}" y1="{y:.1f}" x2="{_MARGIN + bar:.1f}" y2="{y:.1f}" stroke="{LINE}" '
            f'stroke-width="3"/><text x="{_MARGIN + bar + 6:.1f}" y="{y + 4:.1f}" font-size="11" fill="{LINE}">50 mm'
            "</text></svg>"
        )


def axes_plot(measured: Measured, enlarged: float = 500.0) -> str:
    """Return the seen tips on the panel, with their enlarged distances from straight axes."""
    seen, fit = measured.seen, measured.fit
    tips = np.array([visit.tip for visit in seen if visit.tip is not None]).reshape(-1, 3)[:, :2] * 1e3
    outline = measured.outline * 1e3
    caption = f"Tips seen at {len(seen)} of {len(measured.visits)} stops; distance from straight axes x {enlarged:g}"
    plot = Plot(np.vstack([outline, tips]), caption)
    plot.outline(outline)
    for number, (visit, tip) in enumerate(zip(seen, tips)):
        if fit is not None:
            plot.arrow(tip, fit.residuals[number, :2] * 1e3 * enlarged, BAD)
        x, y = visit.stop.reading * 1e3
        plot.dot(tip, 4.0, GOOD, f"reading {x:.1f}, {y:.1f} mm")
    return plot.svg()


def touch_plot(measured: Measured, limit_m: float) -> str:
    """Return the touched points; the area of a circle grows with the error."""
    outline = measured.outline * 1e3
    plot = Plot(outline, f"Touched points in order, with the measured error in mm (limit {1e3 * limit_m:g})")
    plot.outline(outline)
    for number, touch in enumerate(measured.touches, start=1):
        good = touch.touched and touch.error_m <= limit_m
        radius = 4.0 + 8.0 * (min(touch.error_m / limit_m, 2.0) if touch.touched and limit_m > 0 else 0.0)
        plot.dot(touch.point * 1e3, radius, GOOD if good else BAD, touch.reason)
        plot.label(
            touch.point * 1e3, f"{number}: {1e3 * touch.error_m:.2f}" if touch.touched else f"{number}: not touched"
        )
    return plot.svg()


def marked_image(camera: CameraSnapshot, touches: Sequence[MeasuredTouch]) -> npt.NDArray[np.uint8]:
    """Return a copy of the image with the panel's outline and the touched points."""
    image = np.ascontiguousarray(camera.image).copy()
    outline = camera.view.outline_px
    inside = outline[np.isfinite(outline).all(axis=1)]
    cv2.polylines(image, [np.rint(inside).astype(np.int32)], True, (0, 200, 255), 2, cv2.LINE_AA)
    for number, (pixel, touch) in enumerate(zip(camera.touch_px, touches), start=1):
        if np.isfinite(pixel).all():
            x, y = (round(float(v)) for v in pixel)
            colour = (55, 127, 26) if touch.touched else (30, 38, 179)
            cv2.circle(image, (x, y), 7, (255, 255, 255), 3, cv2.LINE_AA)
            cv2.circle(image, (x, y), 7, colour, 2, cv2.LINE_AA)
            cv2.putText(image, str(number), (x + 9, y - 7), cv2.FONT_HERSHEY_SIMPLEX, 0.45, (0, 0, 0), 3, cv2.LINE_AA)
            cv2.putText(
                image, str(number), (x + 9, y - 7), cv2.FONT_HERSHEY_SIMPLEX, 0.45, (255, 255, 255), 1, cv2.LINE_AA
            )
    return image
