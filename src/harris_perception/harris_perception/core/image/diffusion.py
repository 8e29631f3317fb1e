"""Diffusion that flattens weak gradients and preserves strong edges and corners: it removes noise, positions stay.

Sources: P. Perona, J. Malik, "Scale-Space and Edge Detection Using Anisotropic Diffusion", PAMI 12(7), 1990 (their
second conductivity); F. Catte, P.-L. Lions, J.-M. Morel, T. Coll, "Image Selective Smoothing and Edge Detection by
Nonlinear Diffusion", SIAM J. Numer. Anal. 29(1), 1992 (the gradient of the smoothed image).
"""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from harris_perception.core.image.compiled import compiled

F32 = npt.NDArray[np.float32]

_STEP = 0.24
"""Time of one step, px^2: the explicit scheme is stable below 0.25."""


def diffused(gray: npt.NDArray[Any], steps: int, contrast: float) -> F32:
    """Return the image after some steps of diffusion.

    Parameters
    ----------
    gray
        (H, W) of any type. Pixels that are not finite stay so, and spread by 6 px in each step.
    steps
        Number of steps of 0.24 px^2 each.
    contrast
        Gradient, in grey levels per px, at which the flow is halved; 0 for no diffusion.

    Returns
    -------
    (H, W) float32, always a copy.
    """
    picture = np.array(gray, np.float32, order="C")
    for _ in range(steps if picture.size and contrast > 0.0 else 0):
        soft = cv2.GaussianBlur(picture, (0, 0), 1.0)
        gx, gy = (cv2.Sobel(soft, cv2.CV_32F, *order, scale=0.125) for order in ((1, 0), (0, 1)))
        squared = gx * gx + gy * gy
        result = np.empty_like(picture)
        _diffuse(picture, squared, np.float32(1.0 / contrast**2), np.float32(0.5 * _STEP), result)
        picture = result
    return picture


@compiled
def _diffuse(picture: F32, squared: F32, per_contrast: Any, half_step: Any, result: F32) -> None:
    """Fill ``result`` (H, W) with ``picture`` one step later; nothing flows across the image border."""
    height, width = picture.shape
    one = np.float32(1.0)
    conductivity = np.empty((height, width), np.float32)
    for y in range(height):
        for x in range(width):
            conductivity[y, x] = one / (one + squared[y, x] * per_contrast)
    for y in range(height):
        up, down = max(y - 1, 0), min(y + 1, height - 1)
        for x in range(width):
            left, right = max(x - 1, 0), min(x + 1, width - 1)
            value, c = picture[y, x], conductivity[y, x]
            flow = (conductivity[up, x] + c) * (picture[up, x] - value)
            flow += (conductivity[down, x] + c) * (picture[down, x] - value)
            flow += (conductivity[y, left] + c) * (picture[y, left] - value)
            flow += (conductivity[y, right] + c) * (picture[y, right] - value)
            result[y, x] = value + half_step * flow
