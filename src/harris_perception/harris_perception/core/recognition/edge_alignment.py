"""Measures the distance between the edges of a template and those of an image, across each edge.

A panel's drawing consists mostly of long straight edges, which a corner tracker ignores. Points on them are chosen
where the Harris response is negative (an edge, not a corner). A short profile across each is searched in the image, as
in C. Harris, C. Stennett, "RAPID - a video rate object tracker", BMVC 1990, but by correlation instead of the
gradient's peak.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from harris_perception.core.corners.harris import HarrisConfig, HarrisDetector
from harris_perception.core.image.sampling import sampled
from icu_common.core.geometry.geometry import Array

_HALF_PX = 4.0
_STEP_PX = 0.5
_BESIDE_PX = np.array([-2.0, -1.0, 0.0, 1.0, 2.0], np.float32)
_LEAST_GRADIENT = 4.0
_CELL_PX = 6
_CONTRAST = 2.5
# Maximum differences of direction and distance between points of one line.
_LINE_RAD, _LINE_PX = np.pi / 18, 2.0


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class EdgePoints:
    """Points on the edges of an image.

    Attributes
    ----------
    px
        (N, 2) positions.
    across
        (N, 2) unit vectors along the gradient.
    profiles
        (N, K) grey values across the edge, mean zero and length one.
    contrast
        (N,) length of the profiles before normalisation.
    line
        (N,) number of the line of print that contains the point.
    half_px
        Extent of the profiles on either side.
    """

    px: Array
    across: Array
    profiles: Array
    contrast: Array
    line: npt.NDArray[np.intp]
    half_px: float

    def __len__(self) -> int:
        return len(self.px)

    def chosen(self, which: npt.NDArray[np.bool_] | npt.NDArray[np.intp]) -> EdgePoints:
        """Return a subset of the points, by mask or index."""
        return EdgePoints(
            px=self.px[which],
            across=self.across[which],
            profiles=self.profiles[which],
            contrast=self.contrast[which],
            line=self.line[which],
            half_px=self.half_px,
        )


def edge_points(gray: npt.NDArray[np.uint8], allowed: npt.NDArray[np.bool_], half_px: float = _HALF_PX) -> EdgePoints:
    """Choose points on the edges of ``gray`` (H, W) where ``allowed`` (H, W): the strongest of each small cell.

    Profiles extend ``half_px`` to both sides; use more for a blurred image.
    """
    smooth = cv2.GaussianBlur(gray, (0, 0), 1.0).astype(np.float32)
    gx = cv2.Sobel(smooth, cv2.CV_32F, 1, 0, scale=1 / 8)
    gy = cv2.Sobel(smooth, cv2.CV_32F, 0, 1, scale=1 / 8)
    strength = np.hypot(gx, gy)
    response = HarrisDetector(HarrisConfig(gradient="gaussian", window="gaussian")).response(gray)
    # Profiles must not extend beyond the image border or into areas that are not allowed.
    reach = int(np.ceil(half_px)) + 1
    size = 2 * reach + 1
    inside = cv2.erode(allowed.astype(np.uint8), np.ones((size, size), np.uint8), borderValue=0).astype(bool)
    strength[~inside | (response >= 0)] = 0.0
    rows, columns = strength.shape[0] // _CELL_PX, strength.shape[1] // _CELL_PX
    blocks = strength[: rows * _CELL_PX, : columns * _CELL_PX].reshape(rows, _CELL_PX, columns, _CELL_PX)
    cells = blocks.transpose(0, 2, 1, 3).reshape(rows * columns, -1)
    best = cells.argmax(axis=1)
    kept = np.flatnonzero(cells.max(axis=1) > _LEAST_GRADIENT)
    y = kept // columns * _CELL_PX + best[kept] // _CELL_PX
    x = kept % columns * _CELL_PX + best[kept] % _CELL_PX
    across = np.column_stack([gx[y, x], gy[y, x]]).astype(np.float64)
    across /= np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-9)
    px = np.column_stack([x, y]).astype(np.float64)
    profiles = _profiles(gray, px, across, half_px)
    profiles = profiles - profiles.mean(axis=1, keepdims=True)
    contrast = np.maximum(np.linalg.norm(profiles, axis=1), 1e-6)
    return EdgePoints(
        px=px,
        across=across,
        profiles=profiles / contrast[:, None],
        contrast=contrast,
        line=_lines(px, across),
        half_px=half_px,
    )


def shifts(
    points: EdgePoints, picture: npt.NDArray[np.uint8], reach_px: float, least_correlation: float
) -> tuple[Array, npt.NDArray[np.bool_]]:
    """Return the shift of each edge along ``across`` in ``picture``, (N,) px, and which measurements are good.

    Parameters
    ----------
    points
        Edges of the template.
    picture
        (H, W) uint8, warped onto the template.
    reach_px
        Maximum shift that is searched.
    least_correlation
        Minimum normalised correlation of the profiles of a good measurement.
    """
    long = _profiles(picture, points.px, points.across, points.half_px + reach_px)
    count = points.profiles.shape[1]
    windows = np.lib.stride_tricks.sliding_window_view(long, count, axis=1)
    # Running sums give each window's variance; the template's profiles have zero mean, so windows need not be centred.
    sums, squares = (_running(values, count) for values in (long, long * long))
    length = np.sqrt(np.maximum(squares - sums * sums / count, 0.0))
    likeness = np.einsum("nsk,nk->ns", windows, points.profiles) / np.maximum(length, 1e-6)
    best = likeness.argmax(axis=1)
    middle = np.clip(best, 1, likeness.shape[1] - 2)
    row = np.arange(len(best))
    before, peak, after = (likeness[row, middle + k] for k in (-1, 0, 1))
    curve = before - 2 * peak + after
    offset = np.where(curve < -1e-9, 0.5 * (before - after) / np.where(curve < -1e-9, curve, -1.0), 0.0)
    shift = (middle + np.clip(offset, -1.0, 1.0)) * _STEP_PX - reach_px
    found = length[row, middle]
    good = (best == middle) & (peak >= least_correlation) & (found > 4.0)
    # A smooth object in front looks like a faint edge anywhere; light makes all edges fainter or stronger alike.
    gain = found / points.contrast
    usual = float(np.median(gain[good])) if good.any() else 1.0
    return shift, good & (gain > usual / _CONTRAST) & (gain < usual * _CONTRAST)


def _lines(px: Array, across: Array) -> npt.NDArray[np.intp]:
    """Return the line of each edge point, (N,) numbers from 0: by direction, and by distance from the line."""
    turns = np.rint(np.arctan2(across[:, 1], across[:, 0]) / _LINE_RAD) % round(2 * np.pi / _LINE_RAD)
    off = np.rint((np.cos(turns * _LINE_RAD) * px[:, 0] + np.sin(turns * _LINE_RAD) * px[:, 1]) / _LINE_PX)
    return np.asarray(np.unique(np.column_stack([turns, off]), axis=0, return_inverse=True)[1]).ravel()


def _running(values: Array, count: int) -> Array:
    """Return (N, K - count + 1) sums of ``count`` neighbours in each row of (N, K)."""
    total = np.pad(np.cumsum(values, axis=1), ((0, 0), (1, 0)))
    return np.asarray(total[:, count:] - total[:, :-count])


def _profiles(gray: npt.NDArray[np.uint8], px: Array, across: Array, half_px: float) -> Array:
    """Return (N, K) grey values across each edge, averaged over a few neighbours along it."""
    steps = np.arange(-half_px, half_px + 0.5 * _STEP_PX, _STEP_PX)
    if not len(px):
        return np.empty((0, len(steps)))
    # Float32 takes half the time and has a resolution of 0.0001 px.
    (x, y), (dx, dy) = px.T.astype(np.float32)[..., None], across.T.astype(np.float32)[..., None]
    x, y = x + steps.astype(np.float32) * dx, y + steps.astype(np.float32) * dy
    smooth = np.asarray(cv2.GaussianBlur(gray, (0, 0), 0.7), np.uint8)
    total = np.zeros(x.shape, np.float32)
    for beside in _BESIDE_PX:
        total += sampled(smooth, x - beside * dy, y + beside * dx)
    return np.asarray(total / len(_BESIDE_PX), np.float64)
