"""Pairs the images of two cameras: by equal instants, or in sequence for free-running cameras.

Two UVC cameras keep their rate and share no trigger. Their stamps differ by a phase between zero and one period, which
drifts slowly. If no two images are within the tolerance, each left image is paired with the first right image after it.
:mod:`harris_perception.pairing.free_tips` then computes the tip's position at the left image's instant.
"""

from __future__ import annotations

import itertools
from collections import OrderedDict, deque
from dataclasses import dataclass
from statistics import median
from typing import Any

_FREE, _OF_LAST = 2, 8
"""The cameras count as free-running if ``_FREE`` of the last ``_OF_LAST`` left images have no right image of their
instant."""
_KEPT = 8
"""Number of images per camera that are kept until their partners arrive."""
_STAMPS = 30
"""Number of stamps that determine rates and phase: one second at 30 Hz."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ImagePair:
    """A left and a right image with their stamps on the left camera's clock; ``apart``: not of the same instant."""

    left: Any
    right: Any
    left_ns: int
    right_ns: int
    apart: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraPhase:
    """Rates of two cameras and phase between them.

    Attributes
    ----------
    left_period_s, right_period_s
        Median time between two images; 0 while unknown.
    difference_s
        Median of right stamp minus nearest left stamp; negative if the right image is earlier.
    known
        Whether both cameras have sent enough images.
    """

    left_period_s: float = 0.0
    right_period_s: float = 0.0
    difference_s: float = 0.0
    known: bool = False


class FreePairs:
    """Pairs images on arrival; each camera's images must arrive in the order of their stamps.

    Parameters
    ----------
    tolerance_ns
        Maximum difference between the stamps of one instant.
    free_running
        Whether images that are farther apart are also paired.

    Attributes
    ----------
    right_late_ns
        Delay of the right camera's stamps relative to the left camera's clock; subtracted from each right stamp.
    unpaired
        Number of left images that were never paired.
    """

    def __init__(self, *, tolerance_ns: int, free_running: bool = True) -> None:
        self.tolerance_ns, self.free_running = tolerance_ns, free_running
        self.right_late_ns = 0
        self.unpaired = 0
        self._waiting: tuple[OrderedDict[int, Any], OrderedDict[int, Any]] = (OrderedDict(), OrderedDict())
        self._stamps: tuple[deque[int], deque[int]] = (deque(maxlen=_STAMPS), deque(maxlen=_STAMPS))
        self._alone: deque[bool] = deque(maxlen=_OF_LAST)
        self._apart = False

    @property
    def runs_freely(self) -> bool:
        """Whether several of the latest left images had no right image of the same instant."""
        return sum(self._alone) >= _FREE

    @property
    def _near_ns(self) -> int:
        """The tolerance; half of it after a pair that is apart: each switch between both kinds loses a left image."""
        return self.tolerance_ns // 2 if self._apart else self.tolerance_ns

    def add(self, stream: int, stamp_ns: int, image: Any) -> ImagePair | None:
        """Add an image of the left (0) or right (1) camera; return the pair that it completes."""
        stamps = self._stamps[stream]
        if stamps and stamp_ns < stamps[-1]:
            self.clear()  # a recording that has restarted
        stamps.append(stamp_ns)
        at = stamp_ns - (self.right_late_ns if stream else 0)
        own, other = self._waiting[stream], self._waiting[1 - stream]
        own[at] = image
        near = min(other, key=lambda stamp: abs(stamp - at), default=None)
        if near is not None and abs(near - at) <= self._near_ns:
            self._alone.append(False)
            return self._taken(*((near, at) if stream else (at, near)), apart=False)
        if stream == 1 and self.free_running and self.runs_freely:
            before = max((stamp for stamp in other if stamp < at), default=None)
            if before is not None and not self._left_is_due(before, at):
                self._alone.append(True)
                return self._taken(before, at, apart=True)
        while len(own) > _KEPT:
            own.popitem(last=False)
        if stream == 0:
            self._count_alone()
            return self._left_behind() if self.free_running and self.runs_freely else None
        return None

    def _left_behind(self) -> ImagePair | None:
        """Return the second newest left image with the right image after it, if that one is still kept."""
        lefts, rights = self._waiting
        if len(lefts) < 2:
            return None
        before, newest = list(lefts)[-2:]
        after = min((stamp for stamp in rights if before < stamp < newest), default=None)
        return None if after is None else self._taken(before, after, apart=True)

    def _count_alone(self) -> None:
        """Count the left image before the newest if it got no right image."""
        lefts, rights = self._waiting
        if len(lefts) > 1 and rights:
            self._alone.append(True)
            self.unpaired += 1

    def _left_is_due(self, left_ns: int, right_ns: int) -> bool:
        """Whether a later left image that fits the right one is still to arrive, or should already have arrived."""
        period_ns = _period(self._stamps[0])
        return right_ns - left_ns > period_ns - self._near_ns

    def _taken(self, left_ns: int, right_ns: int, *, apart: bool) -> ImagePair:
        self._apart = apart
        lefts, rights = self._waiting
        pair = ImagePair(left=lefts[left_ns], right=rights[right_ns], left_ns=left_ns, right_ns=right_ns, apart=apart)
        for waiting, stamp in ((lefts, left_ns), (rights, right_ns)):
            for old in [s for s in waiting if s <= stamp]:
                del waiting[old]
        return pair

    def phase(self) -> CameraPhase:
        """Return rates and phase from the stamps of the last second."""
        left, right = self._stamps
        if min(len(left), len(right)) < 3 or _period(left) <= 0:
            return CameraPhase()
        period_ns = _period(left)
        # If a left image is lost, the next one is nearest: differences count modulo the period.
        nearest = [(stamp - left[-1] + period_ns / 2) % period_ns - period_ns / 2 for stamp in right]
        return CameraPhase(
            left_period_s=period_ns * 1e-9,
            right_period_s=_period(right) * 1e-9,
            difference_s=median(nearest) * 1e-9,
            known=True,
        )

    def clear(self) -> None:
        """Discard all images, for example when the clock was set back."""
        for kept in (*self._waiting, *self._stamps):
            kept.clear()
        self._alone.clear()
        self._apart = False


def _period(stamps: deque[int]) -> float:
    """Return the median time between stamps, ns; 0 (unknown) for fewer than three stamps."""
    if len(stamps) < 3:
        return 0.0
    return float(median(b - a for a, b in itertools.pairwise(stamps)))
