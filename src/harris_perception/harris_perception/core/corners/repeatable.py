"""Corners with the best repeatability when the image changes: the best setting except for speed.

Unlike the detector of 1988 it takes the image's noise and each corner's surroundings into account. Gradients as weak as
the noise are flattened first. Corners that do not exceed noise and surroundings are dropped, because these are the ones
that do not repeat. docs/decisions/one-setting.md describes how it was chosen and its results.

Sources: for the noise see noise.py, for the diffusion diffusion.py.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from harris_perception.core.corners.harris import Corners, HarrisConfig, HarrisDetector
from harris_perception.core.corners.value_range import checked, in_range, in_unit
from harris_perception.core.image.diffusion import diffused
from harris_perception.core.image.noise import noise_of
from harris_perception.core.image.sampling import mean_around
from icu_common.core.configuration.config import Config, setting

_EVEN = 0.2
"""Exponent of the mean surrounding response by which a corner's rank is divided, so that one textured area does not
take all corners."""

_EVEN_LIGHT = 1.0
"""Exponent of the surrounding brightness in the rank, so that a lamp on one side does not take all corners; a square
would cancel any brightness."""

_LIGHT_PX = 400.0
"""Standard deviation of the Gaussian that averages the surrounding brightness."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RepeatableConfig(Config):
    """Maximum number of corners, and limits of their strength."""

    max_corners: int = setting(
        2000, "Maximum number of corners, strongest first; 0: no limit", minimum=0, maximum=1_000_000
    )
    above_noise: float = setting(
        3.0,
        "Minimum response of a corner, in variances of the noise; noise alone gives 0.05",
        minimum=0.0,
        maximum=1000.0,
    )
    above_around: float = setting(
        2.5, "Minimum ratio of a corner's response to the mean response around it", minimum=0.0, maximum=1000.0
    )
    around_px: float = setting(
        30.0,
        "Standard deviation of the Gaussian that averages the response around a corner",
        minimum=8.0,
        maximum=500.0,
        unit="px",
    )
    least: float = setting(
        0.2, "Fraction of max_corners that is kept even if the corners are weak", minimum=0.0, maximum=1.0
    )
    diffusion_steps: int = setting(3, "Number of diffusion steps applied to the image first", minimum=0, maximum=100)


class RepeatableDetector:
    """Detector of corners that repeat.

    The image is diffused where its gradients are as weak as its noise. Derivatives and window are Gaussians of 0.9 and
    0.85 px; the response is the geometric mean of the eigenvalues, reduced on edges. Corners must exceed the noise and
    their surroundings; if there are too few, the next strongest are added. If there are too many, the corners with the
    largest response relative to the brightness and the texture around them are kept.

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
        """Compile, or load from the cache, all code needed, so that no image waits for it."""
        noisy = np.random.default_rng(0).normal(100.0, 20.0, (64, 64))  # without noise nothing would be diffused
        for dtype in (np.uint8, np.uint16, np.float32):
            self.detect(noisy.astype(dtype))

    def strengths_of(self, response: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
        """Return the strengths of corners with these responses, like ``HarrisDetector.strengths_of``."""
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
        # Ranked by the geometric mean of the ratios to the noise, the same for all corners, and to the surroundings.
        others = _best(~clear, corners.response / np.sqrt(around), max(missing, 0))
        kept = np.union1d(kept, others)
        return Corners(corners.xy[kept], in_unit(corners.response[kept], unit**2))


def _light(gray: npt.NDArray[Any]) -> npt.NDArray[np.float32]:
    """Return the mean brightness around each pixel, 0 or more; values that are not finite count as dark."""
    values = np.nan_to_num(gray.astype(np.float32), nan=0.0, posinf=0.0, neginf=0.0)
    return mean_around(values - np.minimum(values.min(initial=0.0), np.float32(0.0)), _LIGHT_PX)


def _best(among: npt.NDArray[np.bool_], rank: npt.NDArray[Any], limit: int) -> npt.NDArray[np.int64]:
    """Return at most ``limit`` indices of the elements set in ``among``, the highest rank first."""
    places = np.flatnonzero(among)
    return np.asarray(places[np.argsort(-rank[places], kind="stable")[:limit]], np.int64)
