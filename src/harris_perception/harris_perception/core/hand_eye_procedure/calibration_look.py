"""Sightings of the tip and the panel at one stop of a calibration, and the retry budget for late steps.

Results arrive later than their image, because the stylus tracker needs time. A look therefore ends with the last image
that it needs, and the machine moves on while this is evaluated. The stamps decide what belongs to a look.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from harris_perception.core.hand_eye.carriage_camera import PanelSample
from harris_perception.core.hand_eye.tip_samples import Sample
from harris_perception.core.hand_eye_procedure.calibration_plan import RunConfig
from harris_perception.core.hand_eye_procedure.calibration_tour import CalibrationStop
from harris_perception.core.hand_eye_procedure.still_watch import NO_READINGS, StillConfig, panel_sample_of, sample_of
from harris_perception.core.pose.planar_pose import FacePoints
from icu_common.core.geometry.geometry import Array, Transform
from icu_common.core.reasons.message import Message

FEWEST = 2
"""Minimum number of sightings for a sample if the tip was not seen in one of the images."""
_NANO = 1_000_000_000


class Rest:
    """Time since which the readings have not changed."""

    def __init__(self, config: StillConfig) -> None:
        self._config = config
        self.reading: Array | None = None
        self.since_ns = self._newest_ns = 0

    def take(self, stamp_ns: int, reading: Array) -> None:
        """Add the readings (3,) m of ``stamp_ns``."""
        if self.reading is None or np.abs(reading - self.reading).max() > self._config.moved_m:
            self.reading, self.since_ns = np.array(reading, dtype=np.float64), stamp_ns
        self._newest_ns = max(stamp_ns, self._newest_ns)

    def known(self, now_ns: int) -> Array | None:
        """Return the readings, None if they are too old."""
        return self.reading if now_ns - self._newest_ns <= self._config.fresh_s * _NANO else None


@dataclass(frozen=True, slots=True, eq=False)
class Seen:
    """Result of a look; None for what it was not to measure."""

    tip: Sample | None
    panel: PanelSample | None


class CalibrationLook:
    """All sightings at one stop.

    Parameters
    ----------
    stop
        The stop.
    sent_ns
        Time when the goal was sent: nothing older belongs to the look.
    still
        Settle time and numbers of sightings.
    see_tip, see_panel
        Whether tip and panel are to be measured.
    """

    def __init__(
        self, stop: CalibrationStop, sent_ns: int, still: StillConfig, *, see_tip: bool, see_panel: bool
    ) -> None:
        self.stop = stop
        self._still, self._see_tip, self._see_panel = still, see_tip, see_panel
        self._from_ns, self._until_ns = sent_ns, 0
        self._reading: Array | None = None
        self._images: set[int] = set()
        self._tips: dict[int, Array | None] = {}
        self._panels: dict[int, tuple[Transform, FacePoints]] = {}

    def rest(self, since_ns: int, reading: Array | None) -> None:
        """Set the time since which the machine is at rest: images count after it and the settle time."""
        self._from_ns = max(self._from_ns, since_ns + round(self._still.settle_s * _NANO))
        self._reading = reading

    def leave(self, now_ns: int) -> None:
        """Exclude images after ``now_ns``: the machine moves on."""
        self._until_ns = now_ns

    def image(self, stamp_ns: int) -> None:
        """Record that an image was taken."""
        self._images.add(stamp_ns)

    def tip(self, stamp_ns: int, tip: Array | None) -> None:
        """Add a sighting (3,) m; None: the tip was not found in that image."""
        self._tips[stamp_ns] = tip

    def panel(self, stamp_ns: int, camera_from_panel: Transform, points: FacePoints) -> None:
        """Add a pose of the panel and the points measured for it."""
        self._panels[stamp_ns] = camera_from_panel, points

    def _counts(self, stamp_ns: int) -> bool:
        return stamp_ns >= self._from_ns and (not self._until_ns or stamp_ns <= self._until_ns)

    @property
    def tips(self) -> list[Array]:
        """The valid sightings, oldest first; only the newest while the machine is still at rest."""
        found = [
            tip for stamp, tip in sorted(self._tips.items(), key=_stamp) if tip is not None and self._counts(stamp)
        ]
        return found if self._until_ns else found[-self._still.tips :]

    @property
    def _poses(self) -> list[tuple[Transform, FacePoints]]:
        found = [sighting for stamp, sighting in sorted(self._panels.items(), key=_stamp) if self._counts(stamp)]
        return found[-self._still.panels :]

    @property
    def camera_from_panel(self) -> Transform | None:
        """The newest valid pose."""
        return self._poses[-1][0] if self._poses else None

    def lacks(self) -> str:
        """Return the missing part before the machine may move on; empty if none is missing."""
        still, images = self._still, sum(map(self._counts, self._images))
        if self._reading is None:
            return NO_READINGS
        if self._see_tip:
            tips = self.tips
            if max(images, len(tips)) < still.tips:
                return Message("calibration.tip_seen_times_while_machine", tips=len(tips), tips_2=still.tips)
            if isinstance(sample := self._sample(), str):
                return sample
        if self._see_panel and len(self._poses) < still.panels:
            return Message("calibration.panel_seen_times_while_machine", poses=len(self._poses), panels=still.panels)
        return ""

    def _sample(self) -> Sample | str:
        tips = self.tips
        if len(tips) < FEWEST:
            return Message("calibration.tip_seen_times_while_machine", tips=len(tips), tips_2=self._still.tips)
        assert self._reading is not None
        return sample_of(tips, self._reading, self._still)

    def evaluated(self) -> bool:
        """Return whether nothing more is needed: there are enough sightings, or a result for each image."""
        if not self._see_tip:
            return True
        # The tracker processes images in order.
        answered = bool(self._until_ns) and any(stamp > self._until_ns for stamp in self._tips)
        counted = {stamp for stamp in self._images if self._counts(stamp)}
        return len(self.tips) >= self._still.tips or answered or counted <= self._tips.keys()

    def result(self) -> Seen | str:
        """Return the measurements, or which of them is missing."""
        tip = panel = None
        if self._see_tip:
            sample = self._sample()
            if isinstance(sample, str):
                return sample
            tip = sample
        if self._see_panel:
            if len(self._poses) < self._still.panels:
                return self.lacks() or Message("calibration.seen_too_late")
            assert self._reading is not None
            panel = panel_sample_of(self._poses, self._reading)
        return Seen(tip, panel)

    def late(self, now_ns: int) -> str:
        """Return the late part of a look that has not ended in time; empty if only the tip is missing."""
        if any(map(self._counts, (*self._tips, *self._panels))):
            return ""
        waited_s = (now_ns - self._from_ns) / _NANO
        if any(map(self._counts, self._images)):
            return Message("calibration.no_image_resting_machine_evaluated", waited_s=waited_s)
        return Message("calibration.no_image_resting_machine_arrived", waited_s=waited_s)


def _stamp(item: tuple[int, object]) -> int:
    return item[0]


class Patience:
    """Retries of steps that timed out, each with twice the time; their number is limited."""

    def __init__(self, config: RunConfig) -> None:
        self._config = config
        self._step = self.total = 0

    def begin(self) -> None:
        """Start the next step with the usual times."""
        self._step = 0

    def again(self) -> bool:
        """Return whether the step may be retried, which counts as one retry."""
        if self._step >= self._config.retries or self.total >= self._config.max_retries:
            return False
        self._step += 1
        self.total += 1
        return True

    def limit_ns(self, seconds: float) -> int:
        """Return a time limit after the doublings in this step."""
        longest_s = max(self._config.longest_wait_s, seconds)
        return round(min(seconds * 2.0**self._step, longest_s) * _NANO)

    def note(self, late: str) -> str:
        """Return the late part and the retry count as a text for people."""
        return Message("calibration.repetition", late=late, step=self._step, retries=self._config.retries)
