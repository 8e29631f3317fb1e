"""Exposure times and stamps of the cameras' images, and the choice of lost and repeated images."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from icu_simulator.imaging.motion import ShutterTimes

if TYPE_CHECKING:
    from icu_simulator.core.configuration import BenchConfig

_JITTERS = 4.0
"""Number of standard deviations of a stamp's delay that the bench waits before it delivers an image."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Shot:
    """One image: its camera, the middle of its exposure, its stamp, and whether it repeats the last image."""

    camera: int
    exposure_s: float
    stamp_s: float
    repeated: bool = False


def shots(config: BenchConfig, now_s: float) -> list[Shot]:
    """Return the images delivered at ``now_s``, in order of cameras; lost images are missing.

    The result depends only on configuration and time. Exposures and stamps are not later than ``now_s``.
    """
    imaging, period_s = config.imaging, 1 / config.camera.rate_hz
    half_s = ShutterTimes.of(imaging).half_s(config.camera.height_px)
    stamps, losses, free = imaging.stamps, imaging.losses, imaging.free_running
    offset_s, jitter_s = (stamps.offset_ms / 1000, stamps.jitter_ms / 1000) if stamps.enabled else (0.0, 0.0)
    newest_s = now_s - max(half_s, offset_s + _JITTERS * jitter_s)
    phase_s = (free.phase_ms / 1000 + 1e-6 * free.drift_ppm * now_s) % period_s if free.enabled else 0.0
    rng = np.random.default_rng((config.seed, 91, round(now_s * 1e6)))
    result = []
    for camera in (0, 1):
        delay, drop, repeat = rng.standard_normal(), rng.random(), rng.random()
        if losses.enabled and drop < losses.dropped:
            continue
        exposure_s = newest_s - camera * phase_s
        stamp_s = min(exposure_s + offset_s + jitter_s * float(delay), now_s)
        repeated = losses.enabled and repeat < losses.repeated
        result.append(Shot(camera=camera, exposure_s=exposure_s, stamp_s=stamp_s, repeated=repeated))
    return result
