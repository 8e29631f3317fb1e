"""Blur by distance: the circle of confusion of a thin lens."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from icu_common.core.geometry.geometry import Array
from icu_simulator.imaging.configuration import DefocusConfig

_BLURS = 3
"""Number of blurred images between which the blur of each pixel is interpolated."""
_GRID = (32, 18)
_NEAREST_M = 0.05
Layer = npt.NDArray[np.float32]


@dataclass(frozen=True, slots=True, kw_only=True)
class Focus:
    """Blur of a lens: constant part, aperture, and focus distance; with aperture 0 it does not depend on distance."""

    blur_px: float
    focal_px: float
    aperture_m: float = 0.0
    focused_m: float = 1.0

    @classmethod
    def of(cls, blur_px: float, focal_px: float, config: DefocusConfig) -> Focus:
        """Return the blur described by ``config``."""
        aperture_m = config.aperture_mm / 1000 if config.enabled else 0.0
        return cls(blur_px=blur_px, focal_px=focal_px, aperture_m=aperture_m, focused_m=config.focused_m)

    def circle_px(self, depth_m: npt.ArrayLike) -> Array:
        """Return the diameter of the circle of confusion in pixels at depths in metres."""
        return np.asarray(
            self.focal_px * self.aperture_m * np.abs(1 / np.asarray(depth_m, dtype=np.float64) - 1 / self.focused_m)
        )

    def sigma_px(self, depth_m: npt.ArrayLike) -> Array:
        """Return the standard deviation of the whole blur: that of a disc is a quarter of its diameter."""
        return np.asarray(np.hypot(self.blur_px, self.circle_px(depth_m) / 4))

    def over_image(self, xy: Array, depth_of: Callable[[Array], Array]) -> Layer | None:
        """Return the blur of a plane in each pixel, (H, W); None if the blur does not depend on distance.

        Parameters
        ----------
        xy
            Points of the plane seen by the pixels, (2, H, W).
        depth_of
            Returns the depth in metres, (N,), of points (N, 3) with z = 0.
        """
        if self.aperture_m <= 0:
            return None
        few = np.stack([cv2.resize(layer, _GRID, interpolation=cv2.INTER_AREA).ravel() for layer in xy], axis=-1)
        depth = np.maximum(depth_of(np.column_stack([few, np.zeros(len(few))])), _NEAREST_M)
        sigma = self.sigma_px(depth).astype(np.float32).reshape(_GRID[::-1])
        return np.asarray(cv2.resize(sigma, xy.shape[:0:-1], interpolation=cv2.INTER_LINEAR), np.float32)


def blurred(lit: Layer, sigma: Layer, of_all: Layer) -> Layer:
    """Blur each pixel of (H, W, 3) by its own ``sigma`` (H, W), between a few blurs that span the range ``of_all``."""
    variances = np.linspace(float(of_all.min()) ** 2, float(of_all.max()) ** 2, _BLURS)
    result = np.zeros_like(lit)
    step = max(float(variances[1] - variances[0]), 1e-9)
    for variance in variances:
        share = np.clip(1 - np.abs(sigma**2 - np.float32(variance)) / np.float32(step), 0, 1)
        if share.any():
            layer = cv2.GaussianBlur(lit, (0, 0), float(np.sqrt(variance))) if variance > 1e-4 else lit
            result += layer * share[..., None]
    return result
