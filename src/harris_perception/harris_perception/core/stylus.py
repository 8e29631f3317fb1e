"""Finds the magenta ball at the stylus's end in a stereo pair and measures its centre.

The shaft hides a part of the ball, so a centroid would be biased. Instead the visible outline is measured to a
fraction of a pixel and a circle of the size that the ball has at its distance is fitted to the part of it that agrees.
In the plane that touches the viewing sphere at the ball's centre the outline of a sphere is an exact circle, whatever
the lens distortion and the place in the picture.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from icu_common.core.camera_model import CameraModel, StereoModel
from icu_common.core.config import Config, ConfigError, setting
from icu_common.core.geometry import Array

Picture = npt.NDArray[np.uint8]
Values = npt.NDArray[np.float32]
Window = tuple[int, int, int, int]
"""x0, y0, x1, y1 in raw pixels, the last ones not included."""

_ARC_BINS = 36
_MAX_BLOBS = 12
_COLOURED = 25.0
"""Grey levels below zero that the chroma of something yellow, green or cyan has."""
_BEYOND_PX = 1.75
"""Farther than this beyond its outline nothing is seen of the ball any more."""
_BESIDE_PX = ((2.0, 2.75), (2.5, 3.25, 4.0))
"""How far beyond the outline to look for what continues straight behind the ball, where the fill does not do."""
_PAIRED = 0.4
"""Colour changes by so much less within pairs of columns than between them when a camera sends one colour for two."""
_MISFIT = 0.04
"""How far a real ball is from Lambert's law, as a share of its chroma; a tighter scale makes the weights jump."""


@dataclass(frozen=True, slots=True, kw_only=True)
class StylusConfig(Config):
    """Settings of the stylus tracker."""

    ball_diameter_m: float = setting(
        0.004, "Diameter of the ball at the stylus's end.", minimum=0.0005, maximum=0.05, unit="m"
    )
    min_depth_m: float = setting(0.2, "The ball is never nearer.", minimum=0.02, maximum=10.0, unit="m")
    max_depth_m: float = setting(1.5, "The ball is never farther.", minimum=0.03, maximum=20.0, unit="m")
    min_chroma: float = setting(
        30.0,
        "The ball's min(red, blue) - green exceeds that of its surroundings by at least this.",
        minimum=5.0,
        maximum=200.0,
        unit="grey levels",
    )
    row_tolerance_px: float = setting(
        0.7, "Rectified rows of both pictures' centres differ by at most this.", minimum=0.05, maximum=10.0, unit="px"
    )
    max_fit_error: float = setting(
        0.1, "Largest rms difference from a shaded disc, as a share of the ball's chroma.", minimum=0.01, maximum=1.0
    )
    max_size_error: float = setting(
        0.12, "Largest relative difference of the circle's radius from the expected one.", minimum=0.01, maximum=0.5
    )
    min_arc_deg: float = setting(
        90.0, "The visible outline covers at least this.", minimum=30.0, maximum=360.0, unit="deg"
    )
    search_margin_px: int = setting(
        60, "The ball is looked for first this far around its last place.", minimum=10, maximum=2000, unit="px"
    )
    pair_tolerance_s: float = setting(
        0.004, "Left and right stamps of a pair differ by at most this.", minimum=0.0, maximum=0.1, unit="s"
    )

    def __post_init__(self) -> None:
        Config.__post_init__(self)
        if self.max_depth_m <= self.min_depth_m:
            raise ConfigError(f"max_depth_m = {self.max_depth_m} is not above min_depth_m = {self.min_depth_m}")


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Outline:
    """A circle fitted to the ball's visible outline in one picture.

    Attributes
    ----------
    centre_px
        (2,) centre in rectified pixels.
    radius_px
        Radius in the plane touching the viewing sphere at the centre, in pixels of the rectified focal length.
    error
        Rms difference of the pixels from a shaded disc, as a share of the ball's chroma.
    arc_deg
        How much of the circle the used outline covers.
    """

    centre_px: Array
    radius_px: float
    error: float
    arc_deg: float


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Search:
    """The result of looking for the ball in one pair: the tip, or the reason why there is none.

    Attributes
    ----------
    tip
        (3,) centre of the ball in metres, left rectified frame; None when it is not certain.
    reason
        Why there is no tip.
    left, right
        The fitted outlines of the tip.
    row_error_px
        Difference of the rows of both centres.
    """

    tip: Array | None
    reason: str = ""
    left: Outline | None = None
    right: Outline | None = None
    row_error_px: float = 0.0


class _Doubt(Exception):
    """A candidate is not the ball; the message says why."""


@dataclass(frozen=True, slots=True, eq=False)
class _Blob:
    box: Window
    centre_px: Array  # (2,) rectified


class StylusTracker:
    """Looks for the ball around its last place first, then in the whole pictures.

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

    def find(self, left: Picture, right: Picture) -> Search:
        """Measure the ball's centre in one pair of raw pictures, (H, W, 3) uint8 BGR.

        Raises
        ------
        ValueError
            If a picture's shape does not fit the calibration.
        """
        pictures = (left, right)
        for picture, model in zip(pictures, (self.stereo.left, self.stereo.right)):
            if picture.shape != (model.height, model.width, 3) or picture.dtype != np.uint8:
                raise ValueError(f"picture {picture.shape}: {(model.height, model.width, 3)} is calibrated")
        result = Search(tip=None, reason="not seen")
        for windows in self._windows():
            result = self._search(pictures, windows)
            if result.tip is not None:
                break
        self._last = result.tip
        return result

    def _windows(self) -> Iterator[tuple[Window, Window]]:
        whole = [(0, 0, model.width, model.height) for model in (self.stereo.left, self.stereo.right)]
        if self._last is not None:
            margin = self.config.search_margin_px + self._radius_px(self._last)
            seen = (self.stereo.left.project(self._last)[0], self.stereo.project_right(self._last)[0])
            near = [_around(at, margin, window) for at, window in zip(seen, whole)]
            yield near[0], near[1]
        yield whole[0], whole[1]

    def _radius_px(self, tip: Array) -> float:
        # A sphere of radius R at distance D is seen under the angle asin(R / D); its tangent is R / sqrt(D^2 - R^2).
        radius = 0.5 * self.config.ball_diameter_m
        return float(self.stereo.focal_px * radius / np.sqrt(max(float(tip @ tip) - radius**2, radius**2)))

    def _search(self, pictures: tuple[Picture, Picture], windows: tuple[Window, Window]) -> Search:
        models = (self.stereo.left, self.stereo.right)
        chroma = [_chroma(_cut(picture, window)) for picture, window in zip(pictures, windows)]
        blobs = [list(self._blobs(*part)) for part in zip(chroma, windows, models)]
        for side, found in zip(("left", "right"), blobs):
            if not found:
                return Search(tip=None, reason=f"not seen in the {side} picture")
        good: list[Search] = []
        reason = "nothing of the ball's colour is in both pictures at a possible depth"
        for a, b in self._pairs(*blobs):
            try:
                good.append(self._measure((a, b), pictures, windows))
            except _Doubt as doubt:
                reason = str(doubt)
        if len(good) > 1:
            return Search(tip=None, reason=f"{len(good)} places look like the ball")
        return good[0] if good else Search(tip=None, reason=reason)

    def _blobs(self, chroma: Picture, window: Window, model: CameraModel) -> Iterator[_Blob]:
        """Yield connected regions of the ball's colour and a possible size, the largest first."""
        level = float(np.median(chroma[::8, ::8])) + self.config.min_chroma
        mask = np.asarray(cv2.threshold(chroma, min(level, 254.0), 255, cv2.THRESH_BINARY)[1])
        left, top, across, down = cv2.boundingRect(mask)  # much quicker than labelling, and mostly small
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
                # Shaft and arm hide different parts in both pictures: half a ball is allowed here, the fit decides.
                if near <= depth <= far and abs(a.centre_px[1] - b.centre_px[1]) <= self.stereo.focal_px * (
                    0.5 * self.config.ball_diameter_m / depth
                ):
                    yield a, b

    def _measure(
        self, blobs: tuple[_Blob, _Blob], pictures: tuple[Picture, Picture], windows: tuple[Window, Window]
    ) -> Search:
        models = (self.stereo.left, self.stereo.right)
        tip: Array = self.stereo.triangulate(blobs[0].centre_px, blobs[1].centre_px)[0]
        radius = self._radius_px(tip)
        views, circles = zip(
            *(
                self._outlined(*_surroundings(picture, blob.box, window), model, radius)
                for picture, blob, window, model in zip(pictures, blobs, windows, models)
            )
        )
        tip = self.stereo.triangulate(*(self._pixel(fit.ray, model) for fit, model in zip(circles, models)))[0]
        left, right = (
            self._refined(view, fit, self._radius_px(tip), model) for view, fit, model in zip(views, circles, models)
        )
        tip = self.stereo.triangulate(left.centre_px, right.centre_px)[0]
        row_error = float(abs(left.centre_px[1] - right.centre_px[1]))
        if not row_error <= self.config.row_tolerance_px:
            raise _Doubt(f"rows differ by {row_error:.2f} px, above {self.config.row_tolerance_px:g}")
        if not self.config.min_depth_m <= tip[2] <= self.config.max_depth_m:
            raise _Doubt(f"depth {tip[2]:.3f} m is not possible")
        return Search(tip=tip, left=left, right=right, row_error_px=row_error)

    def _outlined(self, colours: Picture, corner: Array, model: CameraModel, radius: float) -> tuple[_View, _Circle]:
        """Measure the outline of one region in its surroundings (h, w, 3) and fit a circle to it.

        Beside something yellow or green the colours next to the ball are continued behind it. Of what may be there the
        one with the smallest error counts.
        """
        colours = _without_pairs(colours)
        chroma = _chroma(colours, cv2.CV_32F)
        clipped = np.maximum(chroma, 0)
        border = np.concatenate([clipped[0], clipped[-1], clipped[:, 0], clipped[:, -1]])
        plain = np.full_like(chroma, np.median(border))
        view = _view(clipped, plain, corner, model, self.config.min_chroma)
        circle = self._circle(view, radius)
        if chroma.min() > -_COLOURED:
            return view, self._checked(circle, radius)
        centre = model.project(circle.ray)[0] - corner
        mixed = _mixed_chroma(colours)
        filled = [(values, _filled(values, centre, radius + _BEYOND_PX)) for values in (mixed, chroma)]
        best, doubt = self._best(filled, corner, model, radius)
        for gaps in _BESIDE_PX:
            if best is None:
                best, doubt = self._best([(mixed, _beside(mixed, centre, radius, gaps))], corner, model, radius)
        if best is None:
            raise doubt
        return best

    def _best(
        self, backgrounds: Sequence[tuple[Values, Values]], corner: Array, model: CameraModel, radius: float
    ) -> tuple[tuple[_View, _Circle] | None, _Doubt]:
        """Return outline and circle of the smallest error among values with their backgrounds, or why there is none."""
        best, least, doubt = None, np.inf, _Doubt()
        for values, around in backgrounds:
            try:
                view = _view(values, around, corner, model, self.config.min_chroma)
                circle = self._checked(self._circle(view, radius), radius)
                error = self._refined(view, circle, radius, model).error
            except _Doubt as reason:
                doubt = reason
                continue
            if error < least:
                best, least = (view, circle), error
        return best, doubt

    def _circle(self, view: _View, radius: float) -> _Circle:
        """Fit a circle to the outline."""
        focal = self.stereo.focal_px
        frame = _touching_frame(view.outline.mean(axis=0))
        at = _in_plane(view.outline, frame, focal)
        outward = _in_plane(view.outer, frame, focal) - at
        outward /= np.maximum(np.linalg.norm(outward, axis=1, keepdims=True), 1e-6)  # no slope, no direction
        xyr, weight = _fit_circle(at, outward, radius)
        used = weight > 0.2
        seen = np.zeros(_ARC_BINS, dtype=bool)
        seen[_bins(at[used] - xyr[:2])] = True
        return _Circle(frame.T @ np.array([*(xyr[:2] / focal), 1.0]), float(xyr[2]), seen)

    def _checked(self, circle: _Circle, radius: float) -> _Circle:
        if circle.arc_deg < self.config.min_arc_deg:
            raise _Doubt(f"only {circle.arc_deg:.0f} deg of the outline are visible")
        if abs(circle.radius / radius - 1) > self.config.max_size_error:
            raise _Doubt(f"an outline of {circle.radius:.1f} px radius does not fit the expected {radius:.1f} px")
        return circle

    def _refined(self, view: _View, fit: _Circle, radius: float, model: CameraModel) -> Outline:
        frame = _touching_frame(fit.ray)
        at = _in_plane(view.rays, frame, self.stereo.focal_px)
        offset, grown, error = _fit_shaded(at, view, radius, fit.seen)
        if error > self.config.max_fit_error:
            raise _Doubt(f"brightness is {error:.2f} of the ball's off a shaded disc")
        if abs(grown / radius - 1) > self.config.max_size_error:
            raise _Doubt(f"a radius of {grown:.1f} px does not fit the expected {radius:.1f} px")
        pixel = self._pixel(frame.T @ np.array([*(offset / self.stereo.focal_px), 1.0]), model)
        return Outline(centre_px=pixel, radius_px=grown, error=error, arc_deg=fit.arc_deg)

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


def _chroma(colours: Picture, dtype: int = -1) -> npt.NDArray[Any]:
    """Return min(red, blue) - green of (h, w, 3): linear in what a pixel has of the ball before something grey.

    In uint8, which is quicker, what is below zero becomes zero.
    """
    blue, green, red = cv2.split(colours)
    return np.asarray(cv2.subtract(cv2.min(blue, red), green, dtype=dtype))


def _without_pairs(colours: Picture) -> Picture:
    """Smooth (h, w, 3) along its rows if two neighbours each have one colour, as YUYV (4:2:2) has when it is unpacked.

    Else the outline is a flight of stairs that no circle fits.
    """
    steps = np.abs(np.diff(cv2.subtract(colours[:, :, 2], colours[:, :, 1], dtype=cv2.CV_32F), axis=1))
    within, between = sorted(float(steps[:, start::2].mean()) for start in (0, 1))
    if within > _PAIRED * between:
        return colours
    return np.asarray(cv2.sepFilter2D(colours, -1, np.array([0.25, 0.5, 0.25]), np.ones(1)), np.uint8)


def _mixed_chroma(colours: Picture) -> Values:
    """Return (red + blue) / 2 - green of (h, w, 3): also linear where red and blue of the background differ."""
    blue, green, red = cv2.split(colours.astype(np.float32))
    return np.asarray(cv2.subtract(cv2.addWeighted(blue, 0.5, red, 0.5, 0), green))


@dataclass(frozen=True, slots=True, eq=False)
class _Circle:
    """A circle fitted to an outline: its centre's direction (3,), its radius in px, which parts of it are visible."""

    ray: Array
    radius: float
    seen: npt.NDArray[np.bool_]

    @property
    def arc_deg(self) -> float:
        return 360.0 / _ARC_BINS * int(self.seen.sum())


def _surroundings(picture: Picture, box: Window, window: Window) -> tuple[Picture, Array]:
    """Return what is around a region, whose box is in pixels of the window, (h, w, 3), and its first raw pixel (2,)."""
    pad = 6
    x0, y0 = max(window[0] + box[0] - pad, window[0]), max(window[1] + box[1] - pad, window[1])
    x1, y1 = min(window[0] + box[2] + pad, window[2]), min(window[1] + box[3] + pad, window[3])
    return _cut(picture, (x0, y0, x1, y1)), np.array([x0, y0])


def _filled(chroma: Values, centre: Array, radius: float) -> Values:
    """Return (h, w) with the disc in it filled from its rim on, lines continued (Bertalmio, Bertozzi, Sapiro 2001)."""
    rows, columns = np.indices(chroma.shape)
    disc = (np.hypot(columns - centre[0], rows - centre[1]) < radius).astype(np.uint8)
    lowest = float(chroma.min())
    return np.asarray(cv2.inpaint(chroma - lowest, disc, 3, cv2.INPAINT_NS) + lowest, np.float32)


def _beside(chroma: Values, centre: Array, radius: float, gaps: Sequence[float]) -> Values:
    """Return what is behind the ball (h, w): the mean of what is seen so far beside it, in the same direction."""
    rows, columns = np.indices(chroma.shape)
    offset = np.column_stack([columns.ravel(), rows.ravel()]) - centre
    toward = offset / np.maximum(np.linalg.norm(offset, axis=1, keepdims=True), 1e-6)
    seen = [_sample(chroma, centre + (radius + gap) * toward) for gap in gaps]
    return np.asarray(np.mean(seen, axis=0), np.float32).reshape(chroma.shape)


@dataclass(frozen=True, slots=True, eq=False)
class _View:
    """One region in one picture: its outline, a pixel outward of it, and all pixels around, as rays with z = 1."""

    outline: Array
    outer: Array
    rays: Array
    chroma: Array
    around: Array
    """What the pixels would show without the ball."""
    above: npt.NDArray[np.bool_]
    """Pixels within the outline."""
    inner: npt.NDArray[np.bool_]
    """Pixels that show nothing but the ball."""


def _view(
    chroma: Values,
    around: Values,
    corner: Array,
    model: CameraModel,
    min_chroma: float,
) -> _View:
    """Measure the outline of one region in its surroundings (h, w).

    The level half way between inside and outside is crossed along rows and columns, as in marching squares.
    """
    bright = float(np.percentile(chroma, 98))
    contrast = np.maximum(bright - around, 1.0)
    share = (chroma - around) / contrast
    level = max(0.4, 0.6 * min_chroma / float(np.median(contrast)))
    above = share > level
    points = []
    for dx, dy in ((1, 0), (0, 1)):
        a, b = share[: share.shape[0] - dy, : share.shape[1] - dx], share[dy:, dx:]
        v, u = np.nonzero(above[: a.shape[0], : a.shape[1]] != above[dy:, dx:])
        part = (level - a[v, u]) / (b[v, u] - a[v, u])
        points.append(np.column_stack([u + dx * part, v + dy * part]))
    at: Array = np.vstack(points).astype(np.float64)
    if len(at) < 8:
        raise _Doubt("too small to be measured")
    smooth = cv2.GaussianBlur(share, (0, 0), 0.8)
    slopes = [cv2.Sobel(smooth, cv2.CV_32F, dx, dy) for dx, dy in ((1, 0), (0, 1))]
    normal = -np.column_stack([_sample(slope, at) for slope in slopes])
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-6)
    rows, columns = np.indices(share.shape)
    pixels = np.column_stack([columns.ravel(), rows.ravel()])
    rays = model.rays(np.vstack([at, at + normal, pixels]) + corner)
    n = len(at)
    inner = cv2.erode(above.astype(np.uint8), np.ones((3, 3), np.uint8), borderValue=0).ravel() > 0
    return _View(
        outline=rays[:n],
        outer=rays[n : 2 * n],
        rays=rays[2 * n :],
        chroma=chroma.ravel().astype(np.float64),
        around=around.ravel().astype(np.float64),
        above=above.ravel(),
        inner=inner,
    )


def _sample(values: npt.NDArray[Any], at: Array) -> Array:
    """Interpolate (h, w) float32 linearly at (N, 2) pixels."""
    x, y = at.T.astype(np.float32)
    taken = cv2.remap(values, x[None], y[None], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    result: Array = np.asarray(taken, np.float64)[0]
    return result


def _touching_frame(centre: Array) -> Array:
    """Return the (3, 3) rotation plane_from_camera of the plane touching the viewing sphere at a direction."""
    z = centre / np.linalg.norm(centre)
    x = np.cross([0.0, 1.0, 0.0], z)
    x /= np.linalg.norm(x)
    return np.array([x, np.cross(z, x), z])


def _in_plane(rays: Array, frame: Array, focal: float) -> Array:
    turned = rays @ frame.T
    flat: Array = turned[:, :2] / turned[:, 2:] * focal
    return flat


def _bins(offset: Array) -> npt.NDArray[np.intp]:
    """Return in which of the equal parts of the circle each (N, 2) offset from its centre lies."""
    turn = np.arctan2(offset[:, 1], offset[:, 0]) / (2 * np.pi) + 0.5
    return np.minimum((turn * _ARC_BINS).astype(np.intp), _ARC_BINS - 1)


def _fit_circle(at: Array, outward: Array, radius: float) -> tuple[Array, Array]:
    """Fit a circle of about ``radius`` to the part of an outline that lies on one.

    Every outline point with its normal proposes a centre; the proposal that most points agree with starts a
    least-squares fit with Tukey's weights. The radius is known to about 4 %, which enters as one more observation.

    Returns
    -------
    xyr, weight
        (3,) centre and radius in pixels, (N,) weights from 0 to 1.
    """
    proposed = at - radius * outward
    offset = at[None] - proposed[:, None]
    distance = np.linalg.norm(offset, axis=2)
    facing = np.einsum("ijk,jk->ij", offset, outward) > 0.7 * distance
    near = np.abs(distance - radius) < max(0.6, 0.1 * radius)
    xyr = np.r_[proposed[int(np.argmax((near & facing).sum(axis=1)))], radius]
    weight = np.zeros(len(at))
    for _ in range(8):
        offset = at - xyr[:2]
        distance = np.maximum(np.hypot(*offset.T), 1e-9)
        error = distance - xyr[2]
        facing_now = np.einsum("ij,ij->i", offset, outward) > 0.6 * distance
        close = np.abs(error[facing_now & (np.abs(error) < 1.5)])
        scale = 4.685 * max(1.48 * float(np.median(close)), 0.08) if len(close) else 1.0
        weight = np.where(facing_now, np.clip(1 - (error / scale) ** 2, 0, None) ** 2, 0.0)
        jacobian = np.column_stack([-offset / distance[:, None], -np.ones(len(at))])
        weighted = jacobian * weight[:, None]
        normal = weighted.T @ jacobian
        prior = (0.2 / (0.04 * radius)) ** 2  # outline points are good to about 0.2 px
        normal[2, 2] += prior
        right = -weighted.T @ error
        right[2] += prior * (radius - xyr[2])
        normal[np.diag_indices(3)] += 1e-9
        change = np.linalg.solve(normal, right)
        xyr = xyr + np.clip(change, -radius, radius)
        if np.abs(change).max() < 1e-2:
            break
    return xyr, weight


def _fit_shaded(at: Array, view: _View, radius: float, seen: npt.NDArray[np.bool_]) -> tuple[Array, float, float]:
    """Fit a shaded, blurred disc to the pixels around the visible part of the outline.

    A half-level outline moves inwards where the ball is dark. Here the chroma of a pixel is the ball's, which varies
    linearly with the surface normal (Lambert), times the share of the pixel that the ball covers, a normal
    distribution's integral across the outline, and ``view.around`` for the rest; Gauss-Newton with Tukey's weights over
    centre, radius, blur and brightness.

    Parameters
    ----------
    at
        (N, 2) the view's pixels in the plane touching at the first centre.
    view
        What they show.
    radius
        The expected radius in pixels.
    seen
        (36,) which parts of the outline are visible.

    Returns
    -------
    centre, radius, error
        (2,) and float in pixels, and the rms difference as a share of the ball's chroma.
    """
    distance = np.hypot(*at.T)
    # The ends of the visible part are blurred with what hides the rest.
    clear = seen & np.roll(seen, 1) & np.roll(seen, -1)
    use = (distance < radius + 3.0) & (clear[_bins(at)] & (distance > radius - 2.5) | view.inner)
    # A thin stem hides few directions of the outline and many of the ball within it, with a pixel of blur around.
    hidden = at[~view.above & (distance < radius - 1.0)]
    at, chroma, around, inner = at[use], view.chroma[use], view.around[use], view.inner[use]
    shown = (np.linalg.norm(at[:, None] - hidden, axis=2) > 1.5).all(axis=1)
    state = np.array([0.0, 0.0, radius, 0.8])  # x, y, radius, blur
    expected = state.copy()
    trust = np.array([0.0, 0.0, 1 / (0.01 * radius), 1 / 0.3])  # how well radius and blur are known beforehand
    # Shading is at most as strong as the ball's chroma itself.
    level = max(float(np.median(chroma[inner])), 1.0) if inner.any() else 1.0
    still = np.array([1e-3, 1.0, 1.0, 1.0, 1e-3]) / level
    diagonal = np.diag_indices(9)
    brightness: Array = np.zeros(5)
    noise = 1.0
    for turn in range(7):
        offset = at - state[:2]
        distance = np.maximum(np.hypot(*offset.T), 1e-6)
        toward = offset / distance[:, None]
        sine = np.minimum(distance / state[2], 1.0)
        across = (state[2] - distance) / state[3]
        cover = 0.5 * (1 + _erf(across / np.sqrt(2)))
        shape = np.column_stack([np.ones(len(at)), toward * sine[:, None], np.sqrt(1 - sine**2)])
        basis = np.column_stack([shape * cover[:, None], 1 - cover])
        behind = around * (1 - cover)
        if turn == 0:
            brightness = np.asarray(np.linalg.lstsq(basis, chroma - behind, rcond=1e-3)[0])
        error = chroma - behind - basis @ brightness
        if turn < 3:  # a scale that follows the fit for ever keeps it from settling
            noise = max(1.48 * float(np.median(np.abs(error))), _MISFIT * level)
        weight = np.clip(1 - (error / (4.685 * noise)) ** 2, 0, None) ** 2
        if not weight.any():
            raise _Doubt("nothing of it is as bright as a shaded disc")
        step = (
            np.exp(-0.5 * across**2) / np.sqrt(2 * np.pi) / state[3] * (shape @ brightness[:4] - brightness[4] - around)
        )
        # How brightness at a place changes when the centre moves counts too, or the iteration creeps.
        drift = np.where(distance < state[2], cover, 0.0)[:, None] / state[2]
        moved = drift * (brightness[3] * toward * (sine / np.maximum(shape[:, 3], 0.4))[:, None] - brightness[1:3])
        slope = np.column_stack([toward * step[:, None] + moved, step, -across * step])
        joint = np.column_stack([slope, basis])
        weighted = joint * weight[:, None]
        normal = weighted.T @ joint / noise**2
        known = weighted.T @ error / noise**2
        normal[diagonal] += np.r_[trust, still] ** 2
        known += np.r_[trust**2 * (expected - state), -(still**2) * brightness]
        change = np.linalg.solve(normal, known)
        state, brightness = state + np.clip(change[:4], -0.5, 0.5), brightness + change[4:]
        state[3] = min(max(state[3], 0.3), 2.5)
        if np.abs(change[:3]).max() < 1e-2:
            break
    if np.hypot(*state[:2]) > 1.5:
        raise _Doubt("outline and brightness disagree about the centre")
    # Not weighted: what the fit left out counts against the ball, but not what the stem hides.
    spread = float(np.sqrt(np.mean(error[shown] ** 2))) if shown.any() else np.inf
    return state[:2], float(state[2]), spread / level


def _erf(x: Array) -> Array:
    """Approximate the error function to 1.5e-7 (Abramowitz and Stegun 7.1.26)."""
    t = 1 / (1 + 0.3275911 * np.abs(x))
    series = t * (0.254829592 + t * (-0.284496736 + t * (1.421413741 + t * (-1.453152027 + t * 1.061405429))))
    value: Array = np.sign(x) * (1 - series * np.exp(-x * x))
    return value
