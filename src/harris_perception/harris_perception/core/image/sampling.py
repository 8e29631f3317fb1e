"""Values of an image between its pixels, at any number of positions, and means around them."""

from __future__ import annotations

import math
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

_MOST = 32_766
"""Maximum number of rows or columns of OpenCV's tables and images."""
_FOLDED = 1024
_PART, _OVERLAP = 16_384, 8
"""Size in px of the parts into which longer images are cut, and their overlap, which interpolation needs."""

_SHRUNK = 8
"""Factor by which the image is reduced before means are computed."""


def sampled(
    picture: npt.NDArray[Any], x: npt.NDArray[Any], y: npt.NDArray[Any], interpolation: int = cv2.INTER_LINEAR
) -> npt.NDArray[np.float32]:
    """Return the values of an image (H, W) or (H, W, C) uint8, uint16 or float32 at positions ``x``, ``y`` px.

    ``x`` and ``y`` are (N, K); the result is (N, K) or (N, K, C). Border pixels are replicated beyond the image.
    """
    shape, found = x.shape, (*x.shape, *picture.shape[2:])
    if not x.size:
        return np.zeros(found, np.float32)
    if max(picture.shape[:2]) > _MOST:
        return _sampled_in_parts(picture, x, y, interpolation)
    if max(shape) > _MOST:
        folded = (-(-x.size // _FOLDED), _FOLDED)
        x, y = np.resize(x, folded), np.resize(y, folded)
    table = np.asarray(x, np.float32), np.asarray(y, np.float32)
    values = cv2.remap(picture, *table, interpolation, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(values.ravel()[: math.prod(found)].reshape(found), np.float32)


def _sampled_in_parts(
    picture: npt.NDArray[Any], x: npt.NDArray[Any], y: npt.NDArray[Any], interpolation: int
) -> npt.NDArray[np.float32]:
    along = int(np.argmax(picture.shape[:2]))
    length, values = picture.shape[along], np.empty((*x.shape, *picture.shape[2:]), np.float32)
    part = np.clip((x, y)[1 - along], 0, length - 1).astype(np.int64) // _PART
    for number in np.unique(part):
        first, there = max(int(number) * _PART - _OVERLAP, 0), part == number
        rows = slice(first, (int(number) + 1) * _PART + _OVERLAP)
        u, v = x[there][None], y[there][None]
        if along == 0:
            values[there] = sampled(picture[rows], u, v - first, interpolation)[0]
        else:
            values[there] = sampled(np.ascontiguousarray(picture[:, rows]), u - first, v, interpolation)[0]
    return values


def mean_around(values: npt.NDArray[np.float32], sigma_px: float) -> npt.NDArray[np.float32]:
    """Return the mean of ``values`` (H, W) around each pixel, weighted by a Gaussian of at least 8 px."""
    height, width = values.shape
    if values.size == 0:
        return np.zeros_like(values)
    small = cv2.resize(values, (max(width // _SHRUNK, 1), max(height // _SHRUNK, 1)), interpolation=cv2.INTER_AREA)
    soft = cv2.GaussianBlur(small, (0, 0), sigma_px / _SHRUNK, borderType=cv2.BORDER_REFLECT)
    return np.asarray(cv2.resize(soft, (width, height), interpolation=cv2.INTER_LINEAR), np.float32)
