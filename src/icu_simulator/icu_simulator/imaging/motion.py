"""Positions of the stylus during the exposure of the rows of an image."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from icu_common.core.geometry.geometry import Array
from icu_simulator.imaging.configuration import ImagingConfig

STILL_M = 1e-6
MAX_PARTS = 5
"""Maximum number of moments that are averaged for the motion blur of the stylus."""
PART_M = 0.0008
"""Motion in metres in one part of the exposure: about two pixels, of a ball of ten."""
SAMPLE_S = 0.001


@dataclass(frozen=True, slots=True, kw_only=True)
class ShutterTimes:
    """Times of one image in seconds: between two rows, and the exposure of a row."""

    row_s: float = 0.0
    exposure_s: float = 0.0

    @classmethod
    def of(cls, imaging: ImagingConfig) -> ShutterTimes:
        """Return the times of the enabled effects."""
        return cls(
            row_s=imaging.rolling_shutter.row_us * 1e-6 if imaging.rolling_shutter.enabled else 0.0,
            exposure_s=imaging.exposure.time_ms * 1e-3 if imaging.exposure.enabled else 0.0,
        )

    def half_s(self, height: int) -> float:
        """Return the time from the middle of the exposure to its first and its last moment."""
        return 0.5 * (self.row_s * height + self.exposure_s)

    def row_times(self, height: int) -> Array:
        """Return the middle of each row's exposure, (height,), relative to the middle of the image's exposure."""
        return np.asarray((np.arange(height) - 0.5 * (height - 1)) * self.row_s, dtype=np.float64)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TipTrack:
    """The tip's path around an exposure: (N,) times relative to its middle in seconds, (N, 3) metres in base_link."""

    times_s: Array
    tips: Array

    def at(self, times_s: Array) -> Array:
        """Return (..., 3) positions at relative times."""
        return np.stack([np.interp(times_s, self.times_s, self.tips[:, i]) for i in range(3)], axis=-1)

    @property
    def moves(self) -> bool:
        """Whether the tip moves."""
        return bool(np.ptp(self.tips, axis=0).max() > STILL_M)


def row_tips(track: TipTrack, shutter: ShutterTimes, height: int) -> list[Array]:
    """Return the tip of each row, (height, 3), at moments of the exposure; the mean of their images has motion blur.

    The tip moves little between two of these moments, as long as ``MAX_PARTS`` suffices.
    """
    rows = shutter.row_times(height)
    middle = track.at(np.linspace(-0.5, 0.5, 9) * shutter.exposure_s)
    way = float(np.linalg.norm(np.diff(middle, axis=0), axis=1).sum())
    parts = min(max(math.ceil(way / PART_M), 1), MAX_PARTS)
    offsets = ((np.arange(parts) + 0.5) / parts - 0.5) * shutter.exposure_s
    return [track.at(rows + offset) for offset in offsets]
