"""The noise of a picture, told by the picture itself.

Source: J. Immerkaer, "Fast Noise Variance Estimation", CVIU 64(2), 1996 (the mask).
"""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from harris_perception.core.compiled import compiled

_MASK = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]], np.float32)
"""Zero on whatever is linear in x or y; of white noise it makes six times its standard deviation."""

_LOWER_HALF, _MIDDLE = 0.3246, 0.6745
"""Of the absolute values of a standard normal distribution the mean of the lower half, and the median."""

_STRIPS, _STRIP_PX = 16, 32


def noise_of(gray: npt.NDArray[Any]) -> float:
    """Return the standard deviation of the noise of a picture (H, W), in its grey levels.

    Told by the weaker half of the pixels, so that texture here and there raises it little; a picture that is texture
    everywhere cannot be told from noise. 0 for a picture without noise, or without finite pixels.
    """
    if gray.size == 0:
        return 0.0
    found = np.abs(cv2.filter2D(gray.astype(np.float32), cv2.CV_32F, _MASK)).ravel()
    found = found[np.isfinite(found)]
    half = len(found) // 2
    return float(np.partition(found, half)[:half].mean()) / (6.0 * _LOWER_HALF) if half else 0.0


def noise_above(gray: npt.NDArray[Any], least: float) -> float:
    """Return the noise of a picture (H, W) to a tenth, from 512 of its pixels; 0 if it is below ``least``."""
    if min(gray.shape) < 3:
        return 0.0
    return float(_noise_above(np.ascontiguousarray(gray, gray.dtype.newbyteorder("=")), least))


@compiled
def _noise_above(picture: npt.NDArray[Any], least: float) -> float:
    height, width = picture.shape
    length, two, count = min(_STRIP_PX, width - 2), np.float32(2.0), 0
    found = np.zeros(_STRIPS * _STRIP_PX, np.float32)
    for i in range(
        _STRIPS
    ):  # places that no pattern of the picture repeats: R2, the golden ratio's sequence in a plane
        y = int(i * 0.7548776662466927 % 1.0 * (height - 2))
        x = int(i * 0.5698402909980532 % 1.0 * (width - 1 - length))
        up, at, down = picture[y, x:], picture[y + 1, x:], picture[y + 2, x:]
        for j in range(length):
            left = np.float32(up[j]) - two * np.float32(at[j]) + np.float32(down[j])
            middle = np.float32(up[j + 1]) - two * np.float32(at[j + 1]) + np.float32(down[j + 1])
            right = np.float32(up[j + 2]) - two * np.float32(at[j + 2]) + np.float32(down[j + 2])
            found[count + j] = abs(left - two * middle + right)
        count += length
    # Comparing all with rising limits is quicker than sorting, which no processor foretells.
    limit = start = max(least, 1e-3)
    while limit < np.inf:
        above, bound = 0, np.float32(6.0 * _MIDDLE * limit)
        for j in range(_STRIPS * _STRIP_PX):
            above += found[j] >= bound
        if 2 * above <= count:
            break
        limit *= 1.1
    return limit if limit > start else 0.0
