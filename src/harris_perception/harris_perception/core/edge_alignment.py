"""Measures how far the edges of a template lie beside those of a picture, across each edge.

A panel's drawing is mostly long straight edges, which a corner tracker ignores. Points on them are chosen where the
Harris response is negative (an edge, not a corner), and a short profile across each is looked for in the picture, as in
C. Harris, C. Stennett, "RAPID - a video rate object tracker", BMVC 1990, but by correlation, not by a gradient's peak.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from harris_perception.core.harris import HarrisConfig, HarrisDetector
from icu_common.core.geometry import Array

_HALF_PX = 4.0
_STEP_PX = 0.5
_BESIDE_PX = (-2.0, -1.0, 0.0, 1.0, 2.0)
_LEAST_GRADIENT = 4.0
_CELL_PX = 6


@dataclass(frozen=True, slots=True, eq=False)
class EdgePoints:
    """Points on edges of a picture.

    Attributes
    ----------
    px
        (N, 2) positions.
    across
        (N, 2) unit vectors along the gradient.
    profiles
        (N, K) grey values across the edge, mean zero and length one.
    """

    px: Array
    across: Array
    profiles: Array

    def __len__(self) -> int:
        return len(self.px)

    def chosen(self, which: npt.NDArray[np.bool_] | npt.NDArray[np.intp]) -> EdgePoints:
        """Return some of the points, by mask or index."""
        return EdgePoints(self.px[which], self.across[which], self.profiles[which])


def edge_points(gray: npt.NDArray[np.uint8], allowed: npt.NDArray[np.bool_]) -> EdgePoints:
    """Choose points on the edges of ``gray`` (H, W) where ``allowed`` (H, W): the strongest of each small cell."""
    smooth = cv2.GaussianBlur(gray, (0, 0), 1.0).astype(np.float32)
    gx = cv2.Sobel(smooth, cv2.CV_32F, 1, 0, scale=1 / 8)
    gy = cv2.Sobel(smooth, cv2.CV_32F, 0, 1, scale=1 / 8)
    strength = np.hypot(gx, gy)
    response = HarrisDetector(HarrisConfig(gradient="gaussian", window="gaussian")).response(gray)
    # Profiles must not reach over the picture's border, nor to what is not allowed.
    reach = int(np.ceil(_HALF_PX)) + 1
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
    return EdgePoints(px, across, _normalised(_profiles(gray, px, across, _HALF_PX)))


def shifts(
    points: EdgePoints, picture: npt.NDArray[np.uint8], reach_px: float, least_correlation: float
) -> tuple[Array, npt.NDArray[np.bool_]]:
    """Return how far each edge lies along ``across`` in ``picture``, (N,) px, and which measurements are good.

    Parameters
    ----------
    points
        Edges of the template.
    picture
        (H, W) uint8, warped onto the template.
    reach_px
        Greatest shift that is looked for.
    least_correlation
        Normalised correlation of the profiles from which on a measurement is good.
    """
    long = _profiles(picture, points.px, points.across, _HALF_PX + reach_px)
    windows = np.lib.stride_tricks.sliding_window_view(long, points.profiles.shape[1], axis=1)
    centred = windows - windows.mean(axis=2, keepdims=True)
    length = np.linalg.norm(centred, axis=2)
    likeness = np.einsum("nsk,nk->ns", centred, points.profiles) / np.maximum(length, 1e-6)
    best = likeness.argmax(axis=1)
    middle = np.clip(best, 1, likeness.shape[1] - 2)
    row = np.arange(len(best))
    before, peak, after = (likeness[row, middle + k] for k in (-1, 0, 1))
    curve = before - 2 * peak + after
    offset = np.where(curve < -1e-9, 0.5 * (before - after) / np.where(curve < -1e-9, curve, -1.0), 0.0)
    shift = (middle + np.clip(offset, -1.0, 1.0)) * _STEP_PX - reach_px
    good = (best == middle) & (peak >= least_correlation) & (length[row, middle] > 4.0)
    return shift, good


def _profiles(gray: npt.NDArray[np.uint8], px: Array, across: Array, half_px: float) -> Array:
    """Return (N, K) grey values across each edge, averaged over a few neighbours along it."""
    steps = np.arange(-half_px, half_px + 0.5 * _STEP_PX, _STEP_PX)
    along = across[:, ::-1] * (-1.0, 1.0)
    at = (
        px[:, None, None]
        + steps[None, :, None, None] * across[:, None, None]
        + np.array(_BESIDE_PX)[None, None, :, None] * along[:, None, None]
    ).astype(np.float32)
    if not len(px):
        return np.empty((0, len(steps)))
    flat = at.reshape(len(px), -1, 2)
    smooth = cv2.GaussianBlur(gray, (0, 0), 0.7)
    values = cv2.remap(smooth, flat[..., 0], flat[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(values.reshape(len(px), len(steps), -1).mean(axis=2), dtype=np.float64)


def _normalised(profiles: Array) -> Array:
    centred = profiles - profiles.mean(axis=1, keepdims=True)
    return np.asarray(centred / np.maximum(np.linalg.norm(centred, axis=1, keepdims=True), 1e-6))
