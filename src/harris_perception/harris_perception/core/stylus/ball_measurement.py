"""Measures the ball in both images: its outline, the circle that fits it, and the centre of its shaded disc."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence

import cv2
import numpy as np

from harris_perception.colour.coarse import coarse_colour, rows_share_colour
from harris_perception.colour.soft_ball import measure_soft
from harris_perception.core.image.medians import median
from harris_perception.core.stylus.ball_candidates import Blob
from harris_perception.core.stylus.ball_fit import (
    ARC_BINS,
    OutlineCircle,
    arc_bins,
    fit_circle,
    fit_shaded,
    in_plane,
    touching_frame,
)
from harris_perception.core.stylus.ball_view import (
    BallView,
    Doubt,
    Picture,
    Values,
    ball_view,
    beside,
    chroma_of,
    filled,
    mixed_chroma_of,
)
from harris_perception.core.stylus.image_windows import Window, surroundings
from harris_perception.core.stylus.stylus_config import StylusSearchConfig
from harris_perception.pairing.search import Outline, Search
from icu_common.core.geometry.camera_model import CameraModel, StereoModel
from icu_common.core.geometry.geometry import Array

_COLOURED = 25.0
"""Chroma of yellow, green or cyan objects, in grey levels below zero."""
_BEYOND_PX = 1.75
"""Distance beyond its outline at which the ball is no longer visible."""
_COARSE_PAIRS = 150
"""Number of regions of the ball's colour, those of ten seconds, that decide whether the cameras' colour is coarse."""
_COARSE_ROWS = 2.0
"""Factor for the row tolerance if colour is coarser than the image."""
_COARSE_SIZE = 2.5
"""Factor for the tolerance of the outline's size then: the outline is only the start of the fit."""
_BESIDE_PX = ((2.0, 2.75), (2.5, 3.25, 4.0))
"""Distances beyond the outline at which the background is sampled, if inpainting it does not work."""


class BallMeter:
    """Measures pairs of regions, and judges by many of them whether the cameras' colour is coarse.

    Parameters
    ----------
    config
        Sizes and limits.
    stereo
        The calibrated pair; it may be replaced by another calibration of the same pair.
    """

    def __init__(self, config: StylusSearchConfig, stereo: StereoModel) -> None:
        self._config, self.stereo = config, stereo
        self._coarse: deque[bool] = deque(maxlen=_COARSE_PAIRS)
        self._shared_rows: deque[bool] = deque(maxlen=_COARSE_PAIRS)

    def radii_px(self, tip: Array) -> tuple[float, float]:
        """Return the ball's radius in each image: at the ends of the travel they differ by some per cent."""
        # A sphere of radius R at distance D has the angular radius asin(R / D), whose tangent is R / sqrt(D^2 - R^2).
        radius = 0.5 * self._config.ball_diameter_m
        squares = (float(np.sum((tip - (eye, 0.0, 0.0)) ** 2)) for eye in (0.0, self.stereo.baseline))
        left, right = (self.stereo.focal_px * radius / math.sqrt(max(d - radius**2, radius**2)) for d in squares)
        return left, right

    def measure(
        self,
        blobs: tuple[Blob, Blob],
        pictures: tuple[Picture, Picture],
        windows: tuple[Window, Window],
        apart_m: float,
    ) -> Search:
        """Measure two regions, one in each image, as one ball that moves by at most ``apart_m`` between the images.

        Raises
        ------
        Doubt
            If they are not the ball.
        """
        models = (self.stereo.left, self.stereo.right)
        tip: Array = self.stereo.triangulate(blobs[0].centre_px, blobs[1].centre_px)[0]
        parts = [surroundings(image, blob.box, window) for image, blob, window in zip(pictures, blobs, windows)]
        smooth = [coarse_colour(colours, mixed_chroma_of(colours)) for colours, _ in parts]
        found = any(colours is not None for colours in smooth)
        # Coarse colour is a property of the camera, but a lamp next to the ball may conceal it: the majority of pairs
        # decides.
        self._coarse.append(found)
        coarse = found or 2 * sum(self._coarse) > len(self._coarse)
        if coarse:
            self._shared_rows.extend(rows_share_colour(mixed_chroma_of(colours)) for colours, _ in parts)
            parts = [(part[0] if colours is None else colours, part[1]) for part, colours in zip(parts, smooth)]
            left, right = (
                self._soft(*part, model, radius) for part, model, radius in zip(parts, models, self.radii_px(tip))
            )
        else:
            left, right = self._sharp(parts, tip)
        tip = self.stereo.triangulate(left.centre_px, right.centre_px)[0]
        row_error = float(abs(left.centre_px[1] - right.centre_px[1]))
        allowed = self._config.row_tolerance_px * (_COARSE_ROWS if coarse else 1.0)
        if not row_error <= allowed + apart_m * self.stereo.focal_px / tip[2]:
            raise Doubt(f"rows differ by {row_error:.2f} px, above {allowed:g}")
        if not self._config.min_depth_m <= tip[2] <= self._config.max_depth_m:
            raise Doubt(f"depth {tip[2]:.3f} m is not possible")
        return Search(tip=tip, left=left, right=right, row_error_px=row_error, row_limit_px=allowed)

    def _sharp(self, parts: Sequence[tuple[Picture, Array]], tip: Array) -> tuple[Outline, Outline]:
        """Measure the ball in a crop (h, w, 3) of both images, whose colour is as fine as the image."""
        models = (self.stereo.left, self.stereo.right)
        views, circles = zip(
            *(self._outlined(*part, model, radius) for part, model, radius in zip(parts, models, self.radii_px(tip)))
        )
        tip = self.stereo.triangulate(*(self._pixel(fit.ray, model) for fit, model in zip(circles, models)))[0]
        ends = zip(views, circles, self.radii_px(tip), models)
        left, right = (self._refined(view, fit, radius, model) for view, fit, radius, model in ends)
        return left, right

    def _soft(self, colours: Picture, corner: Array, model: CameraModel, radius: float) -> Outline:
        """Measure the ball in a crop (h, w, 3) of one image whose colour is coarser than the image."""
        config, focal = self._config, self.stereo.focal_px
        clipped = np.maximum(chroma_of(colours, cv2.CV_32F), 0)
        border = np.concatenate([clipped[0], clipped[-1], clipped[:, 0], clipped[:, -1]])
        view = ball_view(clipped, np.full_like(clipped, median(border)), corner, model, config.min_chroma)
        circle = self._checked(self._circle(view, radius), radius, _COARSE_SIZE)
        frame = touching_frame(circle.ray)
        first = model.project(circle.ray)[0]
        beside_it = [model.project(frame.T @ np.array([*(step / focal), 1.0]))[0] for step in np.eye(2)]
        at = in_plane(view.rays, frame, focal)
        offset, fit = measure_soft(
            colours,
            at,
            first - corner,
            np.column_stack(beside_it) - first[:, None],
            radius,
            config.max_fit_error,
            rows_share=2 * sum(self._shared_rows) > len(self._shared_rows),
        )
        pixel = self._pixel(frame.T @ np.array([*(offset / focal), 1.0]), model)
        return Outline(centre_px=pixel, error=fit.errors[1], arc_deg=circle.arc_deg)

    def _outlined(
        self, colours: Picture, corner: Array, model: CameraModel, radius: float
    ) -> tuple[BallView, OutlineCircle]:
        """Measure the outline of one region in a crop (h, w, 3) and fit a circle to it.

        Next to a yellow or green object, the surrounding colours are extrapolated behind the ball. Of several candidate
        backgrounds the one with the smallest error is used.
        """
        chroma = chroma_of(colours, cv2.CV_32F)
        clipped = np.maximum(chroma, 0)
        border = np.concatenate([clipped[0], clipped[-1], clipped[:, 0], clipped[:, -1]])
        plain = np.full_like(chroma, median(border))
        view = ball_view(clipped, plain, corner, model, self._config.min_chroma)
        circle = self._circle(view, radius)
        if chroma.min() > -_COLOURED:
            return view, self._checked(circle, radius)
        centre = model.project(circle.ray)[0] - corner
        mixed = mixed_chroma_of(colours)
        backgrounds = [(values, filled(values, centre, radius + _BEYOND_PX)) for values in (mixed, chroma)]
        best, doubt = self._best(backgrounds, corner, model, radius)
        for gaps in _BESIDE_PX:
            if best is None:
                best, doubt = self._best([(mixed, beside(mixed, centre, radius, gaps))], corner, model, radius)
        if best is None:
            raise Doubt(doubt)
        return best

    def _best(
        self, backgrounds: Sequence[tuple[Values, Values]], corner: Array, model: CameraModel, radius: float
    ) -> tuple[tuple[BallView, OutlineCircle] | None, str]:
        """Return outline and circle with the smallest error among values and backgrounds, or the reason for none."""
        best, least, doubt = None, np.inf, ""
        for values, around in backgrounds:
            try:
                view = ball_view(values, around, corner, model, self._config.min_chroma)
                circle = self._checked(self._circle(view, radius), radius)
                error = self._refined(view, circle, radius, model).error
            except Doubt as reason:
                doubt = str(reason)  # a stored exception would keep its frames and their images alive
                continue
            if error < least:
                best, least = (view, circle), error
        return best, doubt

    def _circle(self, view: BallView, radius: float) -> OutlineCircle:
        """Fit a circle to the outline."""
        focal = self.stereo.focal_px
        frame = touching_frame(view.outline.mean(axis=0))
        at = in_plane(view.outline, frame, focal)
        outward = in_plane(view.outer, frame, focal) - at
        outward /= np.maximum(np.linalg.norm(outward, axis=1, keepdims=True), 1e-6)  # zero slope gives no direction
        xyr, weight = fit_circle(at, outward, radius)
        used = weight > 0.2
        seen = np.zeros(ARC_BINS, dtype=bool)
        seen[arc_bins(at[used] - xyr[:2])] = True
        return OutlineCircle(frame.T @ np.array([*(xyr[:2] / focal), 1.0]), float(xyr[2]), seen)

    def _checked(self, circle: OutlineCircle, radius: float, size: float = 1.0) -> OutlineCircle:
        if circle.arc_deg < self._config.min_arc_deg:
            raise Doubt(f"only {circle.arc_deg:.0f} deg of the outline are visible")
        if abs(circle.radius / radius - 1) > size * self._config.max_size_error:
            raise Doubt(f"an outline of {circle.radius:.1f} px radius does not fit the expected {radius:.1f} px")
        return circle

    def _refined(self, view: BallView, fit: OutlineCircle, radius: float, model: CameraModel) -> Outline:
        frame = touching_frame(fit.ray)
        at = in_plane(view.rays, frame, self.stereo.focal_px)
        offset, grown, error = fit_shaded(at, view, radius, fit.seen)
        if error > self._config.max_fit_error:
            raise Doubt(f"brightness is {error:.2f} of the ball's off a shaded disc")
        if abs(grown / radius - 1) > self._config.max_size_error:
            raise Doubt(f"a radius of {grown:.1f} px does not fit the expected {radius:.1f} px")
        pixel = self._pixel(frame.T @ np.array([*(offset / self.stereo.focal_px), 1.0]), model)
        return Outline(centre_px=pixel, error=error, arc_deg=fit.arc_deg)

    def _pixel(self, ray: Array, model: CameraModel) -> Array:
        pixel: Array = ray[:2] / ray[2] * (model.p[0, 0], model.p[1, 1]) + model.p[:2, 2]
        return pixel
