"""Finds the magenta ball at the stylus's end in a stereo pair and measures its centre.

The shaft hides a part of the ball, so a centroid would be biased. Instead the visible outline is measured to a fraction
of a pixel (ball_view.py). A circle with the size of the ball at its distance is fitted to the part of the outline that
agrees (ball_fit.py). In the plane that touches the viewing sphere at the ball's centre the outline of a sphere is an
exact circle, for any lens distortion and any position in the image.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from harris_perception.colour.coarse import coarse_colour, rows_share_colour
from harris_perception.colour.soft_ball import measure_soft
from harris_perception.core.alignment.layout_config import LayoutConfig
from harris_perception.core.alignment.pair_config import PairConfig
from harris_perception.core.image.medians import median
from harris_perception.core.stereo.depth_range import DepthRange
from harris_perception.core.stylus.ball_fit import (
    ARC_BINS,
    Circle,
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
from harris_perception.core.stylus.still_ball import StillBall, Window
from harris_perception.pairing.search import Outline, Search
from icu_common.core.configuration.config import nested, setting
from icu_common.core.geometry.camera_model import CameraModel, StereoModel
from icu_common.core.geometry.geometry import Array

_MAX_BLOBS = 12
_REST_PAIRS = 30
"""Number of unchanged pairs after which the stylus is at rest: 2 s at 15 Hz, longer than any measurement after a
motion."""
_COMPARED_BEYOND_PX = 3.0
"""Width, in pixels, of the ring beyond the ball's outline that is compared with the last measured pair."""
_COLOURED = 25.0
"""Chroma of yellow, green or cyan objects, in grey levels below zero."""
_BEYOND_PX = 1.75
"""Distance beyond its outline at which the ball is no longer visible."""
_LARGEST_SPEED_M_S = 0.2
"""Maximum speed at which the ball is found in two images that are apart."""
_COARSE_PAIRS = 150
"""Number of regions of the ball's colour, those of ten seconds, that decide whether the cameras' colour is coarse."""
_COARSE_ROWS = 2.0
"""Factor for the row tolerance if colour is coarser than the image."""
_COARSE_SIZE = 2.5
"""Factor for the tolerance of the outline's size then: the outline is only the start of the fit."""
_BESIDE_PX = ((2.0, 2.75), (2.5, 3.25, 4.0))
"""Distances beyond the outline at which the background is sampled, if inpainting it does not work."""


@dataclass(frozen=True, slots=True, kw_only=True)
class StylusConfig(DepthRange):
    """Settings of the stylus tracker."""

    ball_diameter_m: float = setting(
        0.004, "Diameter of the ball at the stylus's end", minimum=0.0005, maximum=0.05, unit="m"
    )
    min_depth_m: float = setting(0.2, "Minimum depth of the ball", minimum=0.02, maximum=10.0, unit="m")
    max_depth_m: float = setting(1.5, "Maximum depth of the ball", minimum=0.03, maximum=20.0, unit="m")
    min_chroma: float = setting(
        30.0,
        "Minimum difference between the ball's min(red, blue) - green and that of its surroundings",
        minimum=5.0,
        maximum=200.0,
        unit="grey levels",
    )
    row_tolerance_px: float = setting(
        0.7,
        "Maximum difference between the rectified rows of the centres in both images",
        minimum=0.05,
        maximum=10.0,
        unit="px",
    )
    max_fit_error: float = setting(
        0.1, "Maximum rms difference from a shaded disc, as a fraction of the ball's chroma", minimum=0.01, maximum=1.0
    )
    max_size_error: float = setting(
        0.12,
        "Maximum relative difference between the circle's radius and the expected radius",
        minimum=0.01,
        maximum=0.5,
    )
    min_arc_deg: float = setting(90.0, "Minimum angle of the visible outline", minimum=30.0, maximum=360.0, unit="deg")
    search_margin_px: int = setting(
        60, "Distance around the ball's last position that is searched first", minimum=10, maximum=2000, unit="px"
    )
    unchanged_pairs: int = setting(
        3,
        "Maximum number of successive pairs that reuse the last tip without measuring, while the stylus rests "
        "and its surroundings do not change; 0: each pair is measured",
        minimum=0,
        maximum=15,
    )
    pair_tolerance_s: float = setting(
        0.004, "Maximum difference between the left and right stamps of one instant", minimum=0.0, maximum=0.1, unit="s"
    )
    free_running: bool = setting(
        True,
        "Cameras have no common trigger: pair images that are farther apart, and interpolate the right "
        "camera's view to the left image's instant",
    )
    layout: str = setting(
        "", "Layout file of the designated panel; empty: the cameras are not compared", read_only=True
    )
    template: str = setting("", "Image of the panel's face, straight on; empty: drawn from the layout", read_only=True)
    template_px_per_mm: float = setting(
        4.0, "Scale of the template image", minimum=0.1, maximum=100.0, unit="px/mm", read_only=True
    )
    pair: PairConfig = nested(PairConfig)
    controls: LayoutConfig = nested(LayoutConfig)


@dataclass(frozen=True, slots=True, eq=False)
class _Blob:
    box: Window
    centre_px: Array  # (2,) rectified


class StylusTracker:
    """Searches the ball around its last position first, then in the whole images.

    Parameters
    ----------
    config
        Sizes and limits.
    stereo
        The calibrated pair.
    """

    def __init__(self, config: StylusConfig, stereo: StereoModel) -> None:
        self.config, self.stereo = config, stereo
        self._last: Array | None = None
        self._still = StillBall(config.unchanged_pairs, _REST_PAIRS)
        self._result = Search(tip=None, reason="not seen")
        self._apart_m = 0.0
        self._coarse: deque[bool] = deque(maxlen=_COARSE_PAIRS)
        self._shared_rows: deque[bool] = deque(maxlen=_COARSE_PAIRS)

    def recalibrate(self, stereo: StereoModel) -> None:
        """Use another calibration of the same pair from the next images on."""
        self.stereo = stereo
        self._still.forget()  # the same images now mean another position

    def find(self, left: Picture, right: Picture, apart_s: float = 0.0) -> Search:
        """Measure the ball's centre in one pair of raw images, (H, W, 3) uint8 BGR, taken ``apart_s`` apart.

        If the images are apart, the tip is valid only for a ball at rest; its outlines are always valid.

        Raises
        ------
        ValueError
            If an image's shape does not fit the calibration, or it is not 8 bits deep.
        """
        pictures = (left, right)
        for picture, model in zip(pictures, (self.stereo.left, self.stereo.right)):
            if picture.shape != (model.height, model.width, 3) or picture.dtype != np.uint8:
                shape = model.height, model.width, 3
                raise ValueError(f"picture {picture.shape} {picture.dtype}: {shape} uint8 is calibrated")
        self._apart_m = apart_s * _LARGEST_SPEED_M_S
        if self._still.unchanged(pictures):
            return self._result
        for windows in self._windows():
            self._result = self._search(pictures, windows)
            if self._result.tip is not None:
                break
        self._last = self._result.tip
        if self._last is not None:
            self._still.measured(pictures, self._around_ball(self._last, _COMPARED_BEYOND_PX))
        else:
            self._still.forget()
        return self._result

    def _around_ball(self, tip: Array, margin: float) -> tuple[Window, Window]:
        """Return the windows, one per raw image, that extend ``margin`` px beyond the ball's outline."""
        margin += max(self._radii_px(tip))
        left, right = self.stereo.left, self.stereo.right
        seen = (left.project(tip)[0], self.stereo.project_right(tip)[0])
        near = [_around(at, margin, (0, 0, model.width, model.height)) for at, model in zip(seen, (left, right))]
        return near[0], near[1]

    def _windows(self) -> Iterator[tuple[Window, Window]]:
        left, right = self.stereo.left, self.stereo.right
        if self._last is not None:
            yield self._around_ball(self._last, self.config.search_margin_px)
        yield (0, 0, left.width, left.height), (0, 0, right.width, right.height)

    def _radii_px(self, tip: Array) -> tuple[float, float]:
        """Return the ball's radius in each image: at the ends of the travel they differ by some per cent."""
        # A sphere of radius R at distance D has the angular radius asin(R / D), whose tangent is R / sqrt(D^2 - R^2).
        radius = 0.5 * self.config.ball_diameter_m
        squares = (float(np.sum((tip - (eye, 0.0, 0.0)) ** 2)) for eye in (0.0, self.stereo.baseline))
        left, right = (self.stereo.focal_px * radius / math.sqrt(max(d - radius**2, radius**2)) for d in squares)
        return left, right

    def _search(self, pictures: tuple[Picture, Picture], windows: tuple[Window, Window]) -> Search:
        models = (self.stereo.left, self.stereo.right)
        blobs: list[list[_Blob]] = []
        for side, picture, window, model in zip(("left", "right"), pictures, windows, models):
            part = _cut(picture, window)
            found = list(self._blobs(chroma_of(part), window, model)) if self._has_colour(part) else []
            if not found:
                return Search(tip=None, reason=f"not seen in the {side} picture")
            blobs.append(found)
        good: list[Search] = []
        reason = "nothing of the ball's colour is in both pictures at a possible depth"
        for a, b in self._pairs(*blobs):
            try:
                good.append(self._measure((a, b), pictures, windows))
            except Doubt as doubt:
                reason = str(doubt)
        if len(good) > 1:
            return Search(tip=None, reason=f"{len(good)} places look like the ball")
        return good[0] if good else Search(tip=None, reason=reason)

    def _has_colour(self, part: Picture) -> bool:
        """Return whether a pixel of every second row and column has the ball's colour; a quarter of a full search.

        A region without such a pixel is less than 2 px wide or high, too small to measure an arc of a ball.
        """
        chroma = chroma_of(part[::2, ::2])
        return bool(chroma.size and chroma.max() > min(self._level(chroma[::4, ::4]), 254.0))

    def _level(self, every_eighth: Picture) -> float:
        """Return the minimum chroma of the ball's colour."""
        return median(every_eighth) + self.config.min_chroma

    def _blobs(self, chroma: Picture, window: Window, model: CameraModel) -> Iterator[_Blob]:
        """Yield connected regions with the ball's colour and a possible size, the largest first."""
        level = min(self._level(chroma[::8, ::8]), 254.0)
        mask = np.asarray(cv2.threshold(chroma, level, 255, cv2.THRESH_BINARY)[1])
        left, top, across, down = cv2.boundingRect(mask)  # much faster than labelling, and usually small
        if not across:
            return
        inside = mask[top : top + down, left : left + across]
        _, _, stats, centres = cv2.connectedComponentsWithStats(inside, connectivity=8, ltype=cv2.CV_32S)
        stats[:, :2] += (left, top)
        centres += (left, top)
        diameter = self.config.ball_diameter_m * self.stereo.focal_px
        largest = 1.3 * diameter / self.config.min_depth_m + 4
        smallest = 0.1 * (diameter / self.config.max_depth_m) ** 2
        area = stats[:, cv2.CC_STAT_AREA]
        size = np.max(stats[:, [cv2.CC_STAT_WIDTH, cv2.CC_STAT_HEIGHT]], axis=1)
        possible = np.flatnonzero((size <= largest) & (area >= max(smallest, 4)))
        possible = possible[possible != 0]
        order: list[int] = possible[np.argsort(-area[possible], kind="stable")][:_MAX_BLOBS].tolist()
        corner = np.array(window[:2])
        for i in order:
            x, y, w, h = (int(stats[i, k]) for k in range(4))
            yield _Blob((x, y, x + w, y + h), model.rectify(centres[i] + corner)[0])

    def _pairs(self, left: list[_Blob], right: list[_Blob]) -> Iterator[tuple[_Blob, _Blob]]:
        near, far = self.config.min_depth_m, self.config.max_depth_m
        for a in left:
            for b in right:
                depth = float(self.stereo.triangulate(a.centre_px, b.centre_px)[0, 2])
                # Shaft and arm hide different parts in the two images: half a ball is allowed here, and the fit
                # decides.
                if near <= depth <= far and abs(a.centre_px[1] - b.centre_px[1]) <= self.stereo.focal_px * (
                    (0.5 * self.config.ball_diameter_m + self._apart_m) / depth
                ):
                    yield a, b

    def _measure(
        self, blobs: tuple[_Blob, _Blob], pictures: tuple[Picture, Picture], windows: tuple[Window, Window]
    ) -> Search:
        models = (self.stereo.left, self.stereo.right)
        tip: Array = self.stereo.triangulate(blobs[0].centre_px, blobs[1].centre_px)[0]
        parts = [_surroundings(image, blob.box, window) for image, blob, window in zip(pictures, blobs, windows)]
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
                self._soft(*part, model, radius) for part, model, radius in zip(parts, models, self._radii_px(tip))
            )
        else:
            left, right = self._sharp(parts, tip)
        tip = self.stereo.triangulate(left.centre_px, right.centre_px)[0]
        row_error = float(abs(left.centre_px[1] - right.centre_px[1]))
        allowed = self.config.row_tolerance_px * (_COARSE_ROWS if coarse else 1.0)
        if not row_error <= allowed + self._apart_m * self.stereo.focal_px / tip[2]:
            raise Doubt(f"rows differ by {row_error:.2f} px, above {allowed:g}")
        if not self.config.min_depth_m <= tip[2] <= self.config.max_depth_m:
            raise Doubt(f"depth {tip[2]:.3f} m is not possible")
        return Search(tip=tip, left=left, right=right, row_error_px=row_error, row_limit_px=allowed)

    def _sharp(self, parts: Sequence[tuple[Picture, Array]], tip: Array) -> tuple[Outline, Outline]:
        """Measure the ball in a crop (h, w, 3) of both images, whose colour is as fine as the image."""
        models = (self.stereo.left, self.stereo.right)
        views, circles = zip(
            *(self._outlined(*part, model, radius) for part, model, radius in zip(parts, models, self._radii_px(tip)))
        )
        tip = self.stereo.triangulate(*(self._pixel(fit.ray, model) for fit, model in zip(circles, models)))[0]
        ends = zip(views, circles, self._radii_px(tip), models)
        left, right = (self._refined(view, fit, radius, model) for view, fit, radius, model in ends)
        return left, right

    def _soft(self, colours: Picture, corner: Array, model: CameraModel, radius: float) -> Outline:
        """Measure the ball in a crop (h, w, 3) of one image whose colour is coarser than the image."""
        config, focal = self.config, self.stereo.focal_px
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

    def _outlined(self, colours: Picture, corner: Array, model: CameraModel, radius: float) -> tuple[BallView, Circle]:
        """Measure the outline of one region in a crop (h, w, 3) and fit a circle to it.

        Next to a yellow or green object, the surrounding colours are extrapolated behind the ball. Of several candidate
        backgrounds the one with the smallest error is used.
        """
        chroma = chroma_of(colours, cv2.CV_32F)
        clipped = np.maximum(chroma, 0)
        border = np.concatenate([clipped[0], clipped[-1], clipped[:, 0], clipped[:, -1]])
        plain = np.full_like(chroma, median(border))
        view = ball_view(clipped, plain, corner, model, self.config.min_chroma)
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
    ) -> tuple[tuple[BallView, Circle] | None, str]:
        """Return outline and circle with the smallest error among values and backgrounds, or the reason for none."""
        best, least, doubt = None, np.inf, ""
        for values, around in backgrounds:
            try:
                view = ball_view(values, around, corner, model, self.config.min_chroma)
                circle = self._checked(self._circle(view, radius), radius)
                error = self._refined(view, circle, radius, model).error
            except Doubt as reason:
                doubt = str(reason)  # a stored exception would keep its frames and their images alive
                continue
            if error < least:
                best, least = (view, circle), error
        return best, doubt

    def _circle(self, view: BallView, radius: float) -> Circle:
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
        return Circle(frame.T @ np.array([*(xyr[:2] / focal), 1.0]), float(xyr[2]), seen)

    def _checked(self, circle: Circle, radius: float, size: float = 1.0) -> Circle:
        if circle.arc_deg < self.config.min_arc_deg:
            raise Doubt(f"only {circle.arc_deg:.0f} deg of the outline are visible")
        if abs(circle.radius / radius - 1) > size * self.config.max_size_error:
            raise Doubt(f"an outline of {circle.radius:.1f} px radius does not fit the expected {radius:.1f} px")
        return circle

    def _refined(self, view: BallView, fit: Circle, radius: float, model: CameraModel) -> Outline:
        frame = touching_frame(fit.ray)
        at = in_plane(view.rays, frame, self.stereo.focal_px)
        offset, grown, error = fit_shaded(at, view, radius, fit.seen)
        if error > self.config.max_fit_error:
            raise Doubt(f"brightness is {error:.2f} of the ball's off a shaded disc")
        if abs(grown / radius - 1) > self.config.max_size_error:
            raise Doubt(f"a radius of {grown:.1f} px does not fit the expected {radius:.1f} px")
        pixel = self._pixel(frame.T @ np.array([*(offset / self.stereo.focal_px), 1.0]), model)
        return Outline(centre_px=pixel, error=error, arc_deg=fit.arc_deg)

    def _pixel(self, ray: Array, model: CameraModel) -> Array:
        pixel: Array = ray[:2] / ray[2] * (model.p[0, 0], model.p[1, 1]) + model.p[:2, 2]
        return pixel


def _around(at: Array, margin: float, window: Window) -> Window:
    x, y = float(at[0]), float(at[1])
    x0, y0, x1, y1 = window
    return (
        max(round(x - margin), x0),
        max(round(y - margin), y0),
        min(round(x + margin), x1),
        min(round(y + margin), y1),
    )


def _cut(picture: Picture, window: Window) -> Picture:
    x0, y0, x1, y1 = window
    return picture[y0:y1, x0:x1]


def _surroundings(picture: Picture, box: Window, window: Window) -> tuple[Picture, Array]:
    """Return the crop (h, w, 3) around a region, whose box is in pixels of the window, and its first raw pixel (2,)."""
    pad = 6
    x0, y0 = max(window[0] + box[0] - pad, window[0]), max(window[1] + box[1] - pad, window[1])
    x1, y1 = min(window[0] + box[2] + pad, window[2]), min(window[1] + box[3] + pad, window[3])
    return _cut(picture, (x0, y0, x1, y1)), np.array([x0, y0])
