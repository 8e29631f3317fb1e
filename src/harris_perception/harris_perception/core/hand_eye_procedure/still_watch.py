"""Sightings of the tip, and of the panel, while the machine is at rest."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from harris_perception.core.hand_eye.carriage_camera import PanelSample
from harris_perception.core.hand_eye.tip_samples import Sample
from harris_perception.core.pose.planar_pose import FacePoints
from icu_common.core.configuration.config import Config, setting
from icu_common.core.geometry.geometry import Array, Transform, mean_pose
from icu_common.core.reasons.message import Message

NO_READINGS = Message("still.no_joint_states_arrive")
_PANEL_S = 2.0
"""Maximum interval between sightings of a visible panel; recognition may be slow."""


@dataclass(frozen=True, slots=True, kw_only=True)
class StillConfig(Config):
    """Conditions for a machine at rest and a well-measured tip."""

    settle_s: float = setting(
        0.1, "Minimum time at rest before an image's stamp for the image to count", minimum=0.0, maximum=10.0, unit="s"
    )
    moved_m: float = setting(
        0.00001, "Maximum change of the readings at rest; a larger one is motion", minimum=0.0, maximum=0.01, unit="m"
    )
    fresh_s: float = setting(1.0, "Maximum age of the readings and tips used", minimum=0.1, maximum=60.0, unit="s")
    tips: int = setting(3, "Number of sightings of the tip in one sample", minimum=3, maximum=200)
    scatter_m: float = setting(0.0008, "Maximum rms scatter of these sightings", minimum=1e-6, maximum=0.05, unit="m")
    panels: int = setting(3, "Number of panel poses in one sample", minimum=1, maximum=200)


class StillWatch:
    """Collects sightings of the tip, and of the panel, while the readings do not change."""

    def __init__(self, config: StillConfig) -> None:
        self._config = config
        self._reading: Array | None = None
        self._reading_ns = self._since_ns = 0
        self._tips: deque[tuple[int, Array]] = deque(maxlen=config.tips)
        self._panels: deque[tuple[int, Transform, FacePoints]] = deque(maxlen=config.panels)

    def restart(self, now_ns: int) -> None:
        """Discard sightings before ``now_ns``."""
        self._since_ns = now_ns
        self.forget()

    def forget(self) -> None:
        """Discard all sightings; the machine is still at rest."""
        self._tips.clear()
        self._panels.clear()

    def reading(self, stamp_ns: int, reading: Array) -> None:
        """Add the readings (3,) m of ``stamp_ns``."""
        if stamp_ns < self._reading_ns - self._config.fresh_s * 1e9:
            # The clock was set back, or a recording has restarted: previous sightings belong to another time.
            self._reading, self._reading_ns, self._since_ns = None, 0, 0
        if self._reading is None or np.abs(reading - self._reading).max() > self._config.moved_m:
            self._reading = np.array(reading, dtype=np.float64)
            self.restart(max(stamp_ns, self._since_ns))
        self._reading_ns = max(stamp_ns, self._reading_ns)

    def unrest(self, now_ns: int) -> str:
        """Return why the machine is not known to be at rest; empty if it is."""
        if self._fresh_reading(now_ns) is None:
            return NO_READINGS
        settle_s = self._config.settle_s
        settled = now_ns - self._since_ns >= settle_s * 1e9
        return "" if settled else Message("still.machine_not_stood_still", settle_s=settle_s)

    def _fresh_reading(self, now_ns: int) -> Array | None:
        return self._reading if now_ns - self._reading_ns <= self._config.fresh_s * 1e9 else None

    def _settled_at(self, stamp_ns: int) -> bool:
        return self._reading is not None and stamp_ns >= self._since_ns + self._config.settle_s * 1e9

    def tip(self, stamp_ns: int, tip: Array) -> None:
        """Add a sighting (3,) m of ``stamp_ns``; sightings of a moving or settling machine are dropped."""
        if self._settled_at(stamp_ns):
            self._tips.append((stamp_ns, np.array(tip, dtype=np.float64)))

    def panel(self, stamp_ns: int, camera_from_panel: Transform, points: FacePoints) -> None:
        """Add a pose of the panel of ``stamp_ns``, and the points measured for it; dropped like a tip."""
        if self._settled_at(stamp_ns):
            self._panels.append((stamp_ns, camera_from_panel, points))

    @property
    def newest_ns(self) -> tuple[int, int]:
        """Stamps of the newest sighting of the tip and of the panel, 0 before the first."""
        return self._tips[-1][0] if self._tips else 0, self._panels[-1][0] if self._panels else 0

    def panel_sample(self, now_ns: int, after_ns: int = 0) -> PanelSample | str:
        """Return the mean of the poses after ``after_ns`` and all their points, or why there is none yet."""
        config, reading = self._config, self._fresh_reading(now_ns)
        if reading is None:
            return NO_READINGS
        oldest_ns = now_ns - int((config.fresh_s + config.panels * _PANEL_S) * 1e9)
        fresh = [(pose, points) for stamp, pose, points in self._panels if stamp >= oldest_ns and stamp > after_ns]
        if len(fresh) < config.panels:
            return Message("calibration.panel_seen_times_while_machine", poses=len(fresh), panels=config.panels)
        return panel_sample_of(fresh, reading)

    def sample(self, now_ns: int, after_ns: int = 0) -> Sample | str:
        """Return a sample of the sightings after ``after_ns``, or why there is none yet."""
        config, reading = self._config, self._fresh_reading(now_ns)
        if reading is None:
            return NO_READINGS
        oldest_ns = now_ns - (config.fresh_s + config.tips / 5.0) * 1e9
        fresh = [tip for stamp, tip in self._tips if stamp >= oldest_ns and stamp > after_ns]
        if len(fresh) < config.tips:
            return Message("calibration.tip_seen_times_while_machine", tips=len(fresh), tips_2=config.tips)
        return sample_of(fresh, reading, config)


def sample_of(sightings: Sequence[Array], reading: Array, config: StillConfig) -> Sample | str:
    """Return the mean of sightings (3,) m of a tip at rest, or why they give no sample."""
    tips = np.array(sightings)
    centre = np.median(tips, axis=0)
    distance = np.linalg.norm(tips - centre, axis=1)
    # A single wrong sighting must not affect the mean: sightings beyond three times the median distance are excluded.
    near = tips[distance <= 3.0 * max(float(np.median(distance)), 1e-6)]
    scatter = float(np.sqrt(np.mean(distance**2)))
    if scatter > config.scatter_m:
        return Message(
            "still.tip_scatters_accepted", scatter_mm=scatter * 1000.0, scatter_2_mm=config.scatter_m * 1000.0
        )
    covariance = np.cov(near.T) / len(near) if len(near) > 1 else np.zeros((3, 3))
    return Sample(reading=reading, tip=near.mean(axis=0), covariance=covariance)


def panel_sample_of(sightings: Sequence[tuple[Transform, FacePoints]], reading: Array) -> PanelSample:
    """Return the mean of the panel's poses and all their points."""
    pose = mean_pose([pose for pose, _ in sightings])
    points = FacePoints.joined([points for _, points in sightings])
    return PanelSample(reading=reading, camera_from_panel=pose, points=points)
