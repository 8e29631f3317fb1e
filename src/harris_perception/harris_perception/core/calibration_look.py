"""One look of a calibration at the tip and the panel, and the budget for steps that were only late.

What an image shows comes later than the image: the stylus tracker needs time. So a look ends with the last image that
it needs, and the machine moves on while that is evaluated. The stamps decide what belongs to a look.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from harris_perception.core.calibration_plan import RunConfig
from harris_perception.core.calibration_tour import Stop
from harris_perception.core.carriage_camera import PanelSample
from harris_perception.core.hand_eye import Sample
from harris_perception.core.planar_pose import FacePoints
from harris_perception.core.still_watch import NO_READINGS, StillConfig, panel_sample_of, sample_of
from icu_common.core.geometry import Array, Transform

FEWEST = 2
"""Sightings that make a sample where the tip was not seen in one of the images."""
_NANO = 1_000_000_000


class Rest:
    """Since when the readings have not changed."""

    def __init__(self, config: StillConfig) -> None:
        self._config = config
        self.reading: Array | None = None
        self.since_ns = self._newest_ns = 0

    def take(self, stamp_ns: int, reading: Array) -> None:
        """Take the readings (3,) m of ``stamp_ns``."""
        if self.reading is None or np.abs(reading - self.reading).max() > self._config.moved_m:
            self.reading, self.since_ns = np.array(reading, dtype=np.float64), stamp_ns
        self._newest_ns = max(stamp_ns, self._newest_ns)

    def known(self, now_ns: int) -> Array | None:
        """Return the readings, None when they are too old."""
        return self.reading if now_ns - self._newest_ns <= self._config.fresh_s * _NANO else None


@dataclass(frozen=True, slots=True, eq=False)
class Seen:
    """What a look has given; None for what it was not to see."""

    tip: Sample | None
    panel: PanelSample | None


class Look:
    """Everything seen at one stop.

    Parameters
    ----------
    stop
        Where.
    sent_ns
        When the goal was sent: nothing older belongs to the look.
    still
        Settle time and numbers of sightings.
    see_tip, see_panel
        What is looked at.
    """

    def __init__(self, stop: Stop, sent_ns: int, still: StillConfig, *, see_tip: bool, see_panel: bool) -> None:
        self.stop = stop
        self._still, self._see_tip, self._see_panel = still, see_tip, see_panel
        self._from_ns, self._until_ns = sent_ns, 0
        self._reading: Array | None = None
        self._images: set[int] = set()
        self._tips: dict[int, Array | None] = {}
        self._panels: dict[int, tuple[Transform, FacePoints]] = {}

    def rest(self, since_ns: int, reading: Array | None) -> None:
        """Take since when the machine has rested: images count from then on, after the settle time."""
        self._from_ns = max(self._from_ns, since_ns + round(self._still.settle_s * _NANO))
        self._reading = reading

    def leave(self, now_ns: int) -> None:
        """Let no later image count: the machine moves on."""
        self._until_ns = now_ns

    def image(self, stamp_ns: int) -> None:
        """Note that an image was taken."""
        self._images.add(stamp_ns)

    def tip(self, stamp_ns: int, tip: Array | None) -> None:
        """Take a sighting (3,) m; None: the tip was looked for in that image and not found."""
        self._tips[stamp_ns] = tip

    def panel(self, stamp_ns: int, camera_from_panel: Transform, points: FacePoints) -> None:
        """Take a pose of the panel and what was measured for it."""
        self._panels[stamp_ns] = camera_from_panel, points

    def _counts(self, stamp_ns: int) -> bool:
        return stamp_ns >= self._from_ns and (not self._until_ns or stamp_ns <= self._until_ns)

    @property
    def tips(self) -> list[Array]:
        """The sightings that count, oldest first; of a machine that still rests the newest only."""
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
        """The newest pose that counts."""
        return self._poses[-1][0] if self._poses else None

    def lacks(self) -> str:
        """Return what is still missing before the machine may move on, empty when nothing is."""
        still, images = self._still, sum(map(self._counts, self._images))
        if self._reading is None:
            return NO_READINGS
        if self._see_tip:
            tips = self.tips
            if max(images, len(tips)) < still.tips:
                return f"the tip was seen {len(tips)} of {still.tips} times while the machine stood still"
            if isinstance(sample := self._sample(), str):
                return sample
        if self._see_panel and len(self._poses) < still.panels:
            return f"the panel was seen {len(self._poses)} of {still.panels} times while the machine stood still"
        return ""

    def _sample(self) -> Sample | str:
        tips = self.tips
        if len(tips) < FEWEST:
            return f"the tip was seen {len(tips)} of {self._still.tips} times while the machine stood still"
        assert self._reading is not None
        return sample_of(tips, self._reading, self._still)

    def evaluated(self) -> bool:
        """Whether nothing more is to come that is needed: enough sightings, or an answer for each image."""
        if not self._see_tip:
            return True
        # The tracker takes the images in order.
        answered = bool(self._until_ns) and any(stamp > self._until_ns for stamp in self._tips)
        counted = {stamp for stamp in self._images if self._counts(stamp)}
        return len(self.tips) >= self._still.tips or answered or counted <= self._tips.keys()

    def result(self) -> Seen | str:
        """Return what was seen, or what of it was not."""
        tip = panel = None
        if self._see_tip:
            sample = self._sample()
            if isinstance(sample, str):
                return sample
            tip = sample
        if self._see_panel:
            if len(self._poses) < self._still.panels:
                return self.lacks() or "it was seen too late"
            assert self._reading is not None
            panel = panel_sample_of(self._poses, self._reading)
        return Seen(tip, panel)

    def late(self, now_ns: int) -> str:
        """Return what is slow when a look has not ended in time, empty when everything was seen in time but the tip."""
        if any(map(self._counts, (*self._tips, *self._panels))):
            return ""
        waited_s = (now_ns - self._from_ns) / _NANO
        if any(map(self._counts, self._images)):
            return f"no image of the resting machine was evaluated for {waited_s:.1f} s"
        return f"no image of the resting machine arrived for {waited_s:.1f} s"


def _stamp(item: tuple[int, object]) -> int:
    return item[0]


class Patience:
    """Repetitions of steps that failed because something was late, each with twice the time; a bounded number."""

    def __init__(self, config: RunConfig) -> None:
        self._config = config
        self._step = self.total = 0

    def begin(self) -> None:
        """Begin the next step with the usual times."""
        self._step = 0

    def again(self) -> bool:
        """Whether the step may be tried again, which counts as one repetition."""
        if self._step >= self._config.retries or self.total >= self._config.max_retries:
            return False
        self._step += 1
        self.total += 1
        return True

    def limit_ns(self, seconds: float) -> int:
        """Return a time limit as it has grown in this step."""
        longest_s = max(self._config.longest_wait_s, seconds)
        return round(min(seconds * 2.0**self._step, longest_s) * _NANO)

    def note(self, late: str) -> str:
        """Return what is late, and the repetition, for people."""
        return f"{late}; repetition {self._step} of {self._config.retries}"
