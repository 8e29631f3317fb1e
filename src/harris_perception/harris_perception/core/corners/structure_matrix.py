"""The structure matrix of an image: products of its gradient, summed over a window.

The kernels are separable, or recursive (see deriche.py).
"""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from harris_perception.core.corners.structure import structure_of
from harris_perception.core.corners.taps import gradient_taps, window_taps
from harris_perception.core.corners.value_range import from_lowest
from harris_perception.core.image import deriche

F32 = npt.NDArray[Any]


class StructureMatrix:
    """Sums of gx^2, gy^2 and gx gy over a window, for one gradient and one window.

    Parameters
    ----------
    gradient, sigma_d_px, window, window_px, sigma_i_px
        As in ``HarrisConfig``.

    Attributes
    ----------
    smooth
        (M,) float32 weights by which the gradient is smoothed across its direction.
    gain
        Root of the sum of gx^2 on a slope of one grey level per px.
    margin_px
        Width of the frame at the image border in which kernels and window do not lie inside the image.
    """

    def __init__(self, *, gradient: str, sigma_d_px: float, window: str, window_px: int, sigma_i_px: float) -> None:
        self._recursive_gradient, self._recursive_window = gradient == "deriche", window == "deriche"
        self._sigma_d_px, self._sigma_i_px = sigma_d_px, sigma_i_px
        self._derivative, self.smooth = gradient_taps(gradient, sigma_d_px)
        self._window = window_taps(window, window_px, sigma_i_px)
        x = np.arange(len(self._derivative)) - len(self._derivative) // 2
        self.gain = float((self._derivative * x).sum() * self.smooth.sum() * self._window.sum())
        self.margin_px = len(self._derivative) // 2 + len(self._window) // 2

    def __call__(self, gray: npt.NDArray[Any]) -> tuple[F32, F32, F32]:
        """Return the sums where kernels and window lie inside the image.

        Parameters
        ----------
        gray
            (H, W), both larger than twice ``margin_px``.

        Returns
        -------
        tuple
            Three of (H - 2 margin_px, W - 2 margin_px) float32, without the frame of ``margin_px``.
        """
        margin = self.margin_px
        if not (self._recursive_gradient or self._recursive_window):
            shape = (gray.shape[0] - 2 * margin, gray.shape[1] - 2 * margin)
            a, b, c = (np.empty(shape, np.float32) for _ in range(3))
            derivative, smooth, window = (
                t[len(t) // 2 :].copy() for t in (self._derivative, self.smooth, self._window)
            )
            rows = np.ascontiguousarray(gray, np.uint8 if gray.dtype == np.uint8 else np.float32)
            structure_of(rows, derivative[1:], smooth, window, a, b, c)
            return a, b, c
        source = from_lowest(gray)
        unknown = ~np.isfinite(source)
        source[unknown] = 0.0  # recursion would spread them over the whole image
        if self._recursive_gradient:
            soft, slope = (deriche.recursive_filter(self._sigma_d_px, order) for order in (False, True))
            gx, gy = deriche.filtered(source, slope, soft), deriche.filtered(source, soft, slope)
        else:
            gx = cv2.sepFilter2D(source, cv2.CV_32F, self._derivative, self.smooth)
            gy = cv2.sepFilter2D(source, cv2.CV_32F, self.smooth, self._derivative)
        inside = np.s_[margin:-margin, margin:-margin]
        products = (gx * gx, gy * gy, gx * gy)
        if self._recursive_window:
            soft = deriche.recursive_filter(self._sigma_i_px, False)
            a, b, c = (deriche.filtered(p, soft, soft)[inside] for p in products)
            for squares in (a, b):  # far from a step the recursion is below zero
                np.maximum(squares, 0.0, out=squares)
        else:
            a, b, c = (cv2.sepFilter2D(p, cv2.CV_32F, self._window, self._window)[inside] for p in products)
        if unknown.any():
            near = cv2.dilate(unknown.astype(np.uint8), np.ones(2 * (2 * margin + 1,), np.uint8))[inside] > 0
            a[near] = b[near] = c[near] = np.nan
        return a, b, c
