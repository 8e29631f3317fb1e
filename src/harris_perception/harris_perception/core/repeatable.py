"""The corners that repeat best when the picture changes: the setting for everything but speed.

It differs from the detector of 1988 in knowing the picture's noise and each corner's surroundings: what is as weak as
the noise is flattened first, and corners that do not stand out from both are left out, for it is these that do not
come again. docs/decisions/one-setting.md tells how it was chosen and what it gives.

Sources: for the noise see noise.py, for the diffusion diffusion.py.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from harris_perception.core.diffusion import diffused
from harris_perception.core.harris import Corners, HarrisConfig, HarrisDetector, checked, in_range, in_unit
from harris_perception.core.noise import noise_of
from harris_perception.core.sampling import mean_around
from icu_common.core.config import Config, setting

_EVEN = 0.2
"""Corners rank by response / mean response around to this power, so that one rough place does not take all of them."""

_EVEN_LIGHT = 1.0
"""And by the light around to this power (its square would undo any), so that a lamp on one side does not, either."""

_LIGHT_PX = 400.0
"""Standard deviation of the Gaussian that tells how far around the light is averaged."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RepeatableConfig(Config):
    """How many corners there may be, and how far they must stand out."""

    max_corners: int = setting(2000, "The strongest so many are kept, 0 = all", minimum=0, maximum=1_000_000)
    above_noise: float = setting(
        3.0,
        "Response that a corner has at least, in variances of the noise; noise alone makes 0.05",
        minimum=0.0,
        maximum=1000.0,
    )
    above_around: float = setting(
        2.5, "How many times as large as the mean response around it is a corner's", minimum=0.0, maximum=1000.0
    )
    around_px: float = setting(
        30.0, "Standard deviation of the Gaussian that tells how far around", minimum=8.0, maximum=500.0, unit="px"
    )
    least: float = setting(0.2, "This part of max_corners is kept however weak", minimum=0.0, maximum=1.0)
    diffusion_steps: int = setting(3, "Steps of diffusion of the picture before all else", minimum=0, maximum=100)


class RepeatableDetector:
    """Detector of corners that repeat.

    The picture is diffused where its gradients are as weak as its noise. Derivatives and window are Gaussians of 0.9
    and 0.85 px, the response is the geometric mean of the eigenvalues, lessened on edges. Corners are those that stand
    out from the noise and from their surroundings; if these are too few, those that do so the most. If they are too
    many, those are kept that have the largest response for the light and the roughness around them.

    Examples
    --------
    >>> import numpy as np
    >>> picture = np.random.default_rng(1).normal(100.0, 4.0, (60, 60)).astype(np.float32)
    >>> picture[20:40, 20:40] += 100.0
    >>> corners = RepeatableDetector(RepeatableConfig(least=0.0)).detect(picture)
    >>> sorted(corners.xy.round().astype(int).tolist())
    [[20, 20], [20, 39], [39, 20], [39, 39]]
    """

    def __init__(self, config: RepeatableConfig | None = None) -> None:
        self.config = config if config is not None else RepeatableConfig()
        self._detector = HarrisDetector(
            HarrisConfig(
                gradient="gaussian",
                sigma_d_px=0.9,
                window="gaussian",
                sigma_i_px=0.85,
                response="geometric",
                k=0.01,
                relative_threshold=0.0,
                max_corners=0,
            )
        )

    def warm(self) -> None:
        """Compile, or load from the cache, all that is needed, so that no picture waits for it."""
        noisy = np.random.default_rng(0).normal(100.0, 20.0, (64, 64))  # without noise nothing would be diffused
        for dtype in (np.uint8, np.uint16, np.float32):
            self.detect(noisy.astype(dtype))

    def strengths_of(self, response: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
        """Return how strong corners of this response are, as ``HarrisDetector.strengths_of``."""
        return self._detector.strengths_of(response)

    def detect(self, gray: npt.NDArray[Any]) -> Corners:
        """Return the corners of (H, W) uint8, uint16 or float32, by falling response.

        Raises
        ------
        ValueError
            For another shape or dtype.
        """
        gray, unit = in_range(checked(gray))
        config, noise = self.config, noise_of(gray)
        response = self._detector.response(diffused(gray, config.diffusion_steps, noise))
        corners = self._detector.corners_of(response)
        x, y = np.rint(corners.xy).astype(np.intp).T
        known = np.where(np.isfinite(response), response, np.float32(0.0))
        around = mean_around(known, config.around_px)[y, x]
        clear = corners.response > np.maximum(config.above_noise * noise**2, config.above_around * around)
        even = around**_EVEN * (_light(gray)[y, x] + noise) ** _EVEN_LIGHT
        kept = _best(clear, corners.response / even, config.max_corners or len(corners))
        missing = math.ceil(config.least * config.max_corners) - len(kept)
        # By the geometric mean of how far they stand out from the noise, which is one for all, and from what is around.
        others = _best(~clear, corners.response / np.sqrt(around), max(missing, 0))
        kept = np.union1d(kept, others)
        return Corners(corners.xy[kept], in_unit(corners.response[kept], unit**2))


def _light(gray: npt.NDArray[Any]) -> npt.NDArray[np.float32]:
    """Return the mean light around each pixel, 0 or more; what is not finite counts as dark."""
    values = np.nan_to_num(gray.astype(np.float32), nan=0.0, posinf=0.0, neginf=0.0)
    return mean_around(values - np.minimum(values.min(initial=0.0), np.float32(0.0)), _LIGHT_PX)


def _best(among: npt.NDArray[np.bool_], rank: npt.NDArray[Any], limit: int) -> npt.NDArray[np.int64]:
    """Return at most ``limit`` indices among those that are set, the highest rank first."""
    places = np.flatnonzero(among)
    return np.asarray(places[np.argsort(-rank[places], kind="stable")[:limit]], np.int64)
