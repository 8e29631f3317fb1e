"""Noise of an image, estimated from the image itself.

Source: J. Immerkaer, "Fast Noise Variance Estimation", CVIU 64(2), 1996 (the mask).
"""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from harris_perception.core.image.compiled import compiled

_MASK = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]], np.float32)
"""Zero for an image that is linear in x or y; its response to white noise has six times the noise's standard
deviation."""

_LOWER_HALF, _MIDDLE = 0.3246, 0.6745
"""Mean of the lower half, and median, of the absolute values of a standard normal distribution."""

_LEAST = 0.25
"""Minimum share of an image that is needed: the only usable pixels of a drawing without noise are its corners."""

_STRIPS, _STRIP_PX = 16, 32


def noise_of(gray: npt.NDArray[Any]) -> float:
    """Return the standard deviation of the noise of an image (H, W), in its grey levels.

    It is estimated from the weaker half of the pixels, so that local texture raises it little. Texture in the whole
    image cannot be distinguished from noise. Uniform areas at the image's minimum or maximum, such as the surroundings
    of a fisheye image or a saturated area, contain no noise and do not count. Returns 0 for an image without noise,
    without finite pixels, or of which less than a quarter counts.
    """
    values = gray.astype(np.float32).ravel()
    if values.size == 0:
        return 0.0
    found = np.abs(cv2.filter2D(values.reshape(gray.shape), cv2.CV_32F, _MASK)).ravel()
    known = np.isfinite(found)
    found, values = found[known], values[known]
    if len(found) == 0:
        return 0.0
    counts = found[(found > 0.0) | ((values > values.min()) & (values < values.max()))]
    half = len(counts) // 2
    if half == 0 or len(counts) < _LEAST * len(found):
        return 0.0
    return float(np.partition(counts, half)[:half].mean()) / (6.0 * _LOWER_HALF)


def noise_above(gray: npt.NDArray[Any], least: float) -> float:
    """Return the noise of an image (H, W) to within a tenth, from 512 of its pixels; 0 if it is below ``least``."""
    if min(gray.shape) < 3:
        return 0.0
    return float(_noise_above(np.ascontiguousarray(gray, gray.dtype.newbyteorder("=")), least))


@compiled
def _noise_above(picture: npt.NDArray[Any], least: float) -> float:
    height, width = picture.shape
    length, two, count = min(_STRIP_PX, width - 2), np.float32(2.0), 0
    found = np.zeros(_STRIPS * _STRIP_PX, np.float32)
    values = np.zeros(_STRIPS * _STRIP_PX, np.float32)
    # At positions that no pattern of the image repeats: R2, the golden ratio's sequence in a plane.
    for i in range(_STRIPS):
        y = int(i * 0.7548776662466927 % 1.0 * (height - 2))
        x = int(i * 0.5698402909980532 % 1.0 * (width - 1 - length))
        up, at, down = picture[y, x:], picture[y + 1, x:], picture[y + 2, x:]
        for j in range(length):
            left = np.float32(up[j]) - two * np.float32(at[j]) + np.float32(down[j])
            middle = np.float32(up[j + 1]) - two * np.float32(at[j + 1]) + np.float32(down[j + 1])
            right = np.float32(up[j + 2]) - two * np.float32(at[j + 2]) + np.float32(down[j + 2])
            found[count + j] = abs(left - two * middle + right)
            values[count + j] = at[j + 1]
        count += length
    low, high, even = values[:count].min(), values[:count].max(), 0
    for j in range(count):
        even += (found[j] == 0.0) & ((values[j] == low) | (values[j] == high))
    if count - even < _LEAST * count:
        return 0.0
    # Comparing all values with rising limits is faster than sorting, whose branches no processor predicts.
    limit = start = least if least > 0.0 else 1e-3
    while limit < np.inf:
        above, bound = 0, np.float32(6.0 * _MIDDLE * limit)
        for j in range(_STRIPS * _STRIP_PX):
            above += found[j] >= bound
        if 2 * above <= count - even:
            break
        limit *= 1.1
    return limit if limit > start else 0.0
