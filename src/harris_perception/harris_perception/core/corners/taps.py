"""Weights of the separable kernels: derivatives, smoothing and windows."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt

F32 = npt.NDArray[Any]


def gaussian_taps(sigma: float) -> F32:
    """Return the weights (2 ceil(3 sigma) + 1,) of a sampled Gaussian of ``sigma`` px, cut at three sigma, sum one."""
    x = np.arange(-math.ceil(3.0 * sigma), math.ceil(3.0 * sigma) + 1)
    weights = np.exp(-0.5 * (x / sigma) ** 2)
    return np.array(weights / weights.sum(), np.float32)


def gaussian_derivative_taps(sigma: float) -> F32:
    """Return the weights (for correlation) of a Gaussian's derivative; a ramp of slope one gives one."""
    x = np.arange(-math.ceil(3.0 * sigma), math.ceil(3.0 * sigma) + 1)
    weights = x * np.exp(-0.5 * (x / sigma) ** 2)
    return np.array(weights / (weights * x).sum(), np.float32)


def gradient_taps(gradient: str, sigma_d_px: float) -> tuple[F32, F32]:
    """Return the weights of a gradient's derivative and of its smoothing; see ``HarrisConfig`` for the parameters."""
    if gradient in ("gaussian", "deriche"):  # with recursion the taps only give the margin
        return gaussian_derivative_taps(sigma_d_px), gaussian_taps(sigma_d_px)
    smooth = (1, 1, 1) if gradient == "harris" else (1, 2, 1)
    return np.array((-1, 0, 1), np.float32), np.array(smooth, np.float32)


def window_taps(window: str, window_px: int, sigma_i_px: float) -> F32:
    """Return the weights of a window; see ``HarrisConfig`` for the parameters."""
    if window in ("gaussian", "deriche"):
        return gaussian_taps(sigma_i_px)
    return np.ones(window_px, np.float32)
