"""Accepts a pose of the panel: several frames must agree, and the agreeing poses are averaged."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np

from icu_common.core.configuration.config import Config, setting
from icu_common.core.geometry.geometry import Transform, mean_pose


@dataclass(frozen=True, slots=True, kw_only=True)
class AgreementConfig(Config):
    """Conditions for accepting a pose."""

    frames: int = setting(3, "Number of successive frames that must agree", minimum=1, maximum=50)
    tolerance_mm: float = setting(
        0.4, "Maximum distance between the panel corners of agreeing frames", minimum=0.01, maximum=100.0, unit="mm"
    )
    window: int = setting(20, "Number of agreeing frames that are averaged", minimum=1, maximum=500)


class PoseAgreement:
    """Turns sightings, frame by frame, into an accepted pose: the mean of those that agree, while enough do.

    The panel is at rest most of the time, so agreeing poses are averaged. Poses that disagree with the mean but agree
    with each other replace it after ``frames`` of them.
    """

    def __init__(self, config: AgreementConfig, size_mm: tuple[float, float]) -> None:
        self._config = config
        width, height = (side * 1e-3 for side in size_mm)
        self._corners = np.array([(0.0, 0.0, 0.0), (width, 0.0, 0.0), (width, height, 0.0), (0.0, height, 0.0)])
        self._agreeing: deque[Transform] = deque(maxlen=config.window)
        self._others: deque[Transform] = deque(maxlen=config.window)

    def add(self, pose: Transform | None) -> Transform | None:
        """Add one frame's pose (None: not seen) and return the accepted pose after it, or None."""
        if pose is None:
            self._agreeing.clear()
            self._others.clear()
            return None
        if self._agreeing and self._near(pose, mean_pose(self._agreeing)):
            self._agreeing.append(pose)
            self._others.clear()
        else:
            if self._others and not self._near(pose, mean_pose(self._others)):
                self._others.clear()
            self._others.append(pose)
            if not self._agreeing or len(self._others) >= self._config.frames:
                self._agreeing, self._others = self._others, self._agreeing
                self._others.clear()
        if self._others or len(self._agreeing) < self._config.frames:
            return None
        return mean_pose(self._agreeing)

    @property
    def settled(self) -> Transform | None:
        """The accepted pose once the averaging window is full of agreeing frames; one more would not change it."""
        full = len(self._agreeing) == self._agreeing.maxlen and not self._others
        return mean_pose(self._agreeing) if full else None

    def _near(self, a: Transform, b: Transform) -> bool:
        apart = np.linalg.norm(a.apply(self._corners) - b.apply(self._corners), axis=1)
        return bool(apart.max() * 1e3 <= self._config.tolerance_mm)
