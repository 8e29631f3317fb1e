"""Windows around corners: their samples, their normalisation, and the shift between two of them.

The shift is refined by Gauss-Newton along the row (B. Lucas, T. Kanade, IJCAI 1981).
"""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from harris_perception.core.image.sampling import sampled
from harris_perception.core.stereo import stereo_kernels as kernels
from icu_common.core.geometry.geometry import Array

F32 = npt.NDArray[np.float32]

_MARGIN = 5
"""Columns of a strip of the right image on each side of its window."""


def windows_at(picture: F32, at: npt.NDArray[Any], half: int, wider: int = 0) -> F32:
    """Return windows around (N, 2) points, each flat, with (2 half + 1) rows and 2 ``wider`` more columns than rows."""
    if not len(at):
        return np.empty((0, (2 * half + 1) * (2 * (half + wider) + 1)), np.float32)
    dy, dx = np.mgrid[-half : half + 1, -half - wider : half + wider + 1].reshape(2, -1).astype(np.float32)
    x = (at[:, :1] + dx).astype(np.float32)
    y = (at[:, 1:] + dy).astype(np.float32)
    return sampled(picture, x, y, cv2.INTER_CUBIC)


def normalised(windows: F32) -> F32:
    """Subtract each window's mean and divide by its length; windows without texture become zero."""
    centred = windows - windows.mean(axis=1, keepdims=True)
    length = np.sqrt(np.einsum("ij,ij->i", centred, centred))[:, None]
    flat = length < 2.0 * np.sqrt(windows.shape[1])
    return np.asarray(np.where(flat, 0.0, centred / np.where(flat, 1.0, length)), np.float32)


def refined(left: F32, right: F32, at: F32, rough_px: npt.NDArray[Any], half: int) -> tuple[Array, Array]:
    """Refine disparities by Gauss-Newton over shift, slant along x and y, gain and offset of the window.

    Returns
    -------
    disparity_px, sigma_px
        (N,) each; NaN if the windows do not determine them.
    """
    if not len(at):
        return np.empty(0), np.empty(0)
    partner = at[:, 0].astype(np.float64) - rough_px
    column = np.floor(partner)
    strips = windows_at(right, np.column_stack([column, at[:, 1]]), half, _MARGIN)
    moved, sigma = kernels.gauss_newton(windows_at(left, at, half), strips, partner - column, half, 6).T
    return rough_px - moved, sigma
