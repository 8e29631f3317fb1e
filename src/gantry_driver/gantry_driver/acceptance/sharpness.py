"""Blur of an image's edges, by blurring it once more.

At an edge of blur sigma, a Gaussian of sigma 1 reduces the gradient by the ratio sqrt(sigma^2 + 1) / sigma, which gives
sigma (Zhuo and Sim, "Defocus map estimation from a single image", Pattern Recognition 44, 2011). The contrast of the
edge cancels out.
"""

from __future__ import annotations

import math
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

MIN_CONTRAST = 6.0
"""Minimum gradient of an edge in grey levels per pixel, above the noise of a camera."""
MIN_EDGES = 50
"""Minimum number of edge pixels for a median."""
_FLAT = 0.1
"""Maximum opposite gradient within four pixels of an edge, as a share of the edge's own."""
_FIRST_PX = 0.5
_DIFFERENCE_PX2 = 1 / 3
"""Variance by which a central difference, the mean over two pixels, blurs a gradient."""


def edge_blur_px(gray: npt.NDArray[np.uint8], mask: npt.NDArray[np.bool_]) -> float:
    """Return the median blur in pixels (standard deviation) of the strong edges; NaN with too few edges.

    Parameters
    ----------
    gray, mask
        (H, W) image and the pixels to evaluate.
    """
    image = gray.astype(np.float32)
    once = _gradients(cv2.GaussianBlur(image, (0, 0), _FIRST_PX))  # less noise, and a known part of the blur
    twice = _gradients(cv2.GaussianBlur(image, (0, 0), math.hypot(_FIRST_PX, 1.0)))
    blurs = []
    for axis, line in enumerate(((1, 9), (9, 1))):  # edges across x, and across y
        first, second, along = once[axis], twice[axis], np.abs(once[1 - axis])
        for sign in (1.0, -1.0):
            rise, near = sign * first, np.ones(line, np.uint8)
            peak = (rise > MIN_CONTRAST) & (rise >= cv2.dilate(rise, near)) & (rise > 3 * along)
            # A line has a fall next to its rise: blurred again, it fades more than a step does.
            step = peak & (cv2.erode(rise, near) > -_FLAT * rise) & mask
            ratio = rise[step] / np.maximum(sign * second[step], 1e-6)
            blurs.append(1.0 / np.sqrt(np.maximum(ratio**2 - 1.0, 1e-6)))
    all_blurs = np.concatenate(blurs)
    if len(all_blurs) < MIN_EDGES:
        return math.nan
    return math.sqrt(max(float(np.median(all_blurs)) ** 2 - _FIRST_PX**2 - _DIFFERENCE_PX2, 0.0))


def _gradients(image: npt.NDArray[Any]) -> tuple[npt.NDArray[Any], npt.NDArray[Any]]:
    """Return the gradients along x and y."""
    kernel = np.array([[-0.5, 0.0, 0.5]], np.float32)
    return cv2.filter2D(image, -1, kernel), cv2.filter2D(image, -1, kernel.T)
