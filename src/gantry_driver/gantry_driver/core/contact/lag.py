"""The ball's lag behind its drive, measured against the motion in the air of the same descent.

The stylus is sprung. In the air the ball goes down as far as its drive; a surface stops the ball while the drive goes
on. Both heights are differences within one descent, so an offset between readings and heights cancels.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from gantry_driver.core.contact.config import ContactConfig
from icu_common.core.geometry.geometry import Array

_MAD = 1.4826
"""Standard deviation of a normal variable, as a multiple of its median absolute deviation."""
_OUTLIER, _LEAST_M = 3.0, 0.0001
"""Deviation from the median, in standard deviations of at least this size, above which a height counts as this far
off: a few wrong measurements move neither the median nor its error much."""
_PRIOR_IMAGES = 4
"""Number of images that ``image_sigma_m`` counts as."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Height:
    """Measured height of the ball over one standstill.

    Parameters
    ----------
    seen_m
        Median of the heights along base z, in metres.
    extension_m
        Reading of the stylus, which grows downwards.
    scatter_m2
        Sum of the squared deviations.
    count
        Number of image pairs.
    """

    seen_m: float
    extension_m: float
    scatter_m2: float
    count: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Lag:
    """Distance of the ball behind its drive, and its standard deviation, in metres."""

    lag_m: float
    sigma_m: float

    def stopped(self, config: ContactConfig) -> bool:
        """Whether something has stopped the ball."""
        return self.lag_m >= max(config.lag_m, config.sigmas * self.sigma_m)

    def free(self, config: ContactConfig) -> bool:
        """Whether the ball has certainly followed its drive."""
        return self.lag_m + self.sigma_m < config.lag_m

    def details(self) -> tuple[tuple[str, str], ...]:
        """Return the values as pairs for ``GoalResult.details``."""
        return (("lag_m", f"{self.lag_m:.6f}"), ("lag_sigma_m", f"{self.sigma_m:.6f}"))


def height_of(tips: Array, extension_m: float) -> Height:
    """Return the height of tips (N, 3) in base_link at a reading; N is at least 1."""
    heights = tips[:, 2]
    middle = float(np.median(heights))
    off = np.abs(heights - middle)
    off = np.minimum(off, _OUTLIER * max(_MAD * float(np.median(off)), _LEAST_M))
    return Height(seen_m=middle, extension_m=extension_m, scatter_m2=float(off @ off), count=len(heights))


def lag_between(air: Height, now: Height, config: ContactConfig) -> Lag:
    """Return the lag at a standstill, relative to one in the air."""
    height = config.height
    freedom = max(air.count - 1, 0) + max(now.count - 1, 0)
    pooled = _PRIOR_IMAGES * height.image_sigma_m**2 + air.scatter_m2 + now.scatter_m2
    variance = pooled / (_PRIOR_IMAGES + freedom)
    # The median of few values scatters by about a quarter more than their mean.
    sigma = math.sqrt(1.5 * variance * (1.0 / air.count + 1.0 / now.count) + height.place_sigma_m**2)
    lag = (now.seen_m - air.seen_m) + (now.extension_m - air.extension_m)
    return Lag(lag_m=lag, sigma_m=sigma)
