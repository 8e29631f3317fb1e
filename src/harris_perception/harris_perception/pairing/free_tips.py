"""Position of the tip at a left image's instant if no right image was taken at that instant.

The ball is measured once in each image. Its position in the right camera is interpolated between the two right images
before and after the left image's stamp. A ball at rest has the same position in both, so a pair needs no common
instant.
"""

from __future__ import annotations

import dataclasses
from collections import deque
from typing import Any, Protocol

from harris_perception.pairing.free_pairs import ImagePair
from harris_perception.pairing.offset import Offset, OffsetEstimator
from harris_perception.pairing.search import Outline, Search
from icu_common.core.geometry.camera_model import StereoModel
from icu_common.core.geometry.geometry import Array
from icu_common.core.reasons.message import Message

_LONGEST_GAP_S = 0.2
"""Maximum time between two right images for interpolation between them."""
_LARGEST_OFFSET_SIGMA_S = 0.001
_LEAST_OFFSET_S = 0.002
"""Minimum offset that is corrected: a moving tip is measured no better than to 0.4 mm at 0.2 m/s."""


class Tracker(Protocol):
    """Measures the ball in one pair of images."""

    stereo: StereoModel

    def find(self, left: Any, right: Any, apart_s: float = 0.0) -> Search: ...


class FreeTips:
    """Measures the tip in pairs of images; interpolates the right camera's view if the images of a pair are apart.

    Parameters
    ----------
    tracker
        Measures the ball.
    """

    def __init__(self, tracker: Tracker) -> None:
        self.tracker = tracker
        self._rights: deque[tuple[int, Outline]] = deque(maxlen=2)
        self._offsets = OffsetEstimator()
        self._lefts: deque[tuple[int, Outline]] = deque(maxlen=2)

    @property
    def offset(self) -> Offset:
        """The measured offset of the right camera's stamps."""
        return self._offsets.estimate()

    def right_late_ns(self) -> int:
        """Return the offset to subtract from right stamps; 0 while it is small or uncertain."""
        offset = self.offset
        certain = offset.sigma_s <= _LARGEST_OFFSET_SIGMA_S and abs(offset.late_s) >= _LEAST_OFFSET_S
        return round(offset.late_s * 1e9) if certain else 0

    def forget(self) -> None:
        """Discard the previous positions of the ball."""
        self._rights.clear()
        self._lefts.clear()

    def find(self, pair: ImagePair, left: Any, right: Any, right_late_ns: int = 0) -> Search:
        """Measure the tip at the left image's instant.

        Parameters
        ----------
        pair
            Stamps of the images.
        left, right
            Images, (H, W, 3) uint8 BGR.
        right_late_ns
            Correction that was subtracted from the pair's right stamp.

        Raises
        ------
        ValueError
            Like the tracker.
        """
        apart_s = abs(pair.right_ns - pair.left_ns) * 1e-9 if pair.apart else 0.0
        search = self.tracker.find(left, right, apart_s)
        if search.left is None or search.right is None or search.tip is None:
            self.forget()
            return search
        self._rights.append((pair.right_ns, search.right))
        self._lefts.append((pair.left_ns, search.left))
        self._measure_offset(right_late_ns)
        if not pair.apart:
            return search
        at = self._right_at(pair.left_ns)
        if at is None:
            return Search(tip=None, reason=Message("tips.right_image_before_not_show"))
        return self._joined(search, at)

    def _right_at(self, stamp_ns: int) -> Array | None:
        """Return the ball's rectified (2,) px in the right camera at an instant between its last two images."""
        if len(self._rights) < 2:
            return None
        (before_ns, before), (after_ns, after) = self._rights
        gap_ns = after_ns - before_ns
        if not 0 < gap_ns <= _LONGEST_GAP_S * 1e9 or not before_ns <= stamp_ns <= after_ns:
            return None
        part = (stamp_ns - before_ns) / gap_ns
        return (1 - part) * before.centre_px + part * after.centre_px

    def _joined(self, search: Search, right_px: Array) -> Search:
        assert search.left is not None and search.right is not None
        left_px = search.left.centre_px
        rows = float(abs(left_px[1] - right_px[1]))
        if rows > search.row_limit_px:
            reason = Message("tips.rows_differ_above_left_image", rows_px=rows, row_limit_px=search.row_limit_px)
            return Search(tip=None, reason=reason, row_error_px=rows, row_limit_px=search.row_limit_px)
        right = dataclasses.replace(search.right, centre_px=right_px)
        tip = self.tracker.stereo.triangulate(left_px, right_px)[0]
        return dataclasses.replace(search, tip=tip, right=right, row_error_px=rows)

    def _measure_offset(self, right_late_ns: int) -> None:
        """Compare the rows at the instant given by the uncorrected stamps."""
        if len(self._rights) < 2:
            return
        (before_ns, before), (after_ns, after) = self._rights
        (_, _), (left_ns, left) = self._lefts
        gap_s = (after_ns - before_ns) * 1e-9
        if not 0 < gap_s <= _LONGEST_GAP_S:
            return
        velocity = float(after.centre_px[1] - before.centre_px[1]) / gap_s
        # The stamps here are corrected; the camera's own stamps are later by the correction.
        since_s = (left_ns - (before_ns + right_late_ns)) * 1e-9
        row = float(before.centre_px[1]) + velocity * since_s
        self._offsets.add(float(left.centre_px[1]) - row, velocity)
