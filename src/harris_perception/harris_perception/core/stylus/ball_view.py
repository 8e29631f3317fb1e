"""Features of a ball in one image: its chroma, the background behind it, and its outline to a fraction of a pixel."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from harris_perception.core.image.medians import median
from harris_perception.core.image.sampling import sampled
from icu_common.core.geometry.camera_model import CameraModel
from icu_common.core.geometry.geometry import Array

Picture = npt.NDArray[np.uint8]
Values = npt.NDArray[np.float32]


class Doubt(Exception):
    """A candidate is not the ball; the message says why."""


@dataclass(frozen=True, slots=True, eq=False)
class BallView:
    """One region in one image: its outline, points one pixel outside it, and all pixels around, as rays with z = 1."""

    outline: Array
    outer: Array
    rays: Array
    chroma: Array
    around: Array
    """Values of the pixels without the ball."""
    above: npt.NDArray[np.bool_]
    """Pixels inside the outline."""
    inner: npt.NDArray[np.bool_]
    """Pixels that show only the ball."""


def chroma_of(colours: Picture, dtype: int = -1) -> npt.NDArray[Any]:
    """Return min(red, blue) - green of (h, w, 3): linear in the ball's share of a pixel on a grey background.

    In uint8, which is faster, negative values become zero.
    """
    blue, green, red = cv2.split(colours)
    return np.asarray(cv2.subtract(cv2.min(blue, red), green, dtype=dtype))


def mixed_chroma_of(colours: Picture) -> Values:
    """Return (red + blue) / 2 - green of (h, w, 3): also linear if the background's red and blue differ."""
    blue, green, red = cv2.split(colours.astype(np.float32))
    return np.asarray(cv2.subtract(cv2.addWeighted(blue, 0.5, red, 0.5, 0), green))


def filled(chroma: Values, centre: Array, radius: float) -> Values:
    """Return (h, w) with the disc inpainted from its rim, continuing lines (Bertalmio, Bertozzi, Sapiro 2001)."""
    rows, columns = np.indices(chroma.shape)
    disc = (np.hypot(columns - centre[0], rows - centre[1]) < radius).astype(np.uint8)
    lowest = float(chroma.min())
    return np.asarray(cv2.inpaint(chroma - lowest, disc, 3, cv2.INPAINT_NS) + lowest, np.float32)


def beside(chroma: Values, centre: Array, radius: float, gaps: Sequence[float]) -> Values:
    """Return the background behind the ball (h, w): the mean of the values ``gaps`` beyond it, by direction."""
    rows, columns = np.indices(chroma.shape)
    offset = np.column_stack([columns.ravel(), rows.ravel()]) - centre
    toward = offset / np.maximum(np.linalg.norm(offset, axis=1, keepdims=True), 1e-6)
    seen = [_sample(chroma, centre + (radius + gap) * toward) for gap in gaps]
    return np.asarray(np.mean(seen, axis=0), np.float32).reshape(chroma.shape)


def ball_view(
    chroma: Values,
    around: Values,
    corner: Array,
    model: CameraModel,
    min_chroma: float,
) -> BallView:
    """Measure the outline of one region in a crop (h, w).

    The outline is where the level half way between inside and outside is crossed along rows and columns, as in marching
    squares.

    Raises
    ------
    Doubt
        If the region is too small to measure.
    """
    bright = float(np.percentile(chroma, 98))
    contrast = np.maximum(bright - around, 1.0)
    share = (chroma - around) / contrast
    level = max(0.4, 0.6 * min_chroma / median(contrast))
    above = share > level
    points = []
    for dx, dy in ((1, 0), (0, 1)):
        a, b = share[: share.shape[0] - dy, : share.shape[1] - dx], share[dy:, dx:]
        v, u = np.nonzero(above[: a.shape[0], : a.shape[1]] != above[dy:, dx:])
        part = (level - a[v, u]) / (b[v, u] - a[v, u])
        points.append(np.column_stack([u + dx * part, v + dy * part]))
    at: Array = np.vstack(points).astype(np.float64)
    if len(at) < 8:
        raise Doubt("too small to be measured")
    smooth = cv2.GaussianBlur(share, (0, 0), 0.8)
    slopes = [cv2.Sobel(smooth, cv2.CV_32F, dx, dy) for dx, dy in ((1, 0), (0, 1))]
    normal = -np.column_stack([_sample(slope, at) for slope in slopes])
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-6)
    rows, columns = np.indices(share.shape)
    pixels = np.column_stack([columns.ravel(), rows.ravel()])
    rays = model.rays(np.vstack([at, at + normal, pixels]) + corner)
    n = len(at)
    inner = cv2.erode(above.astype(np.uint8), np.ones((3, 3), np.uint8), borderValue=0).ravel() > 0
    return BallView(
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
    return np.asarray(sampled(values, x[None], y[None])[0], np.float64)
