"""Comparison of each report with the sent path: a tube, the deepest point, the highest feed.

GRBL follows a G1 exactly and cuts no corner, so the tube is narrow. It contains whole motor steps, the rounding of line
and report, and the steps that the board makes while it writes a report. The time between two reports limits the
distance that the board can have moved along the path. A report on the path, but too far ahead, is therefore outside as
well: the board omitted a detour.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from gantry_driver.core.configuration.clearance import TUBE_MM
from gantry_driver.core.program.polyline import Polyline
from icu_common.core.reasons.message import Message

Vector = tuple[float, float, float]

REPORT_LATE_S = 0.1
"""Maximum seconds by which the time between two positions exceeds that from the request of the first to the report of
the second: a lost request, and different clocks."""
AMBIGUOUS_MM = 4.0 * TUBE_MM
"""Length of path above which a report fits more than one position: the path returns there."""
EARLY_MM = 0.1
"""Maximum distance by which a report may be ahead of the limit of feed and time: rounding, and the tube's ends."""
FEED_SHARE, FEED_MM_MIN = 1.05, 30.0
"""Factor and surplus of the feed that a report may show beyond the path's: rounding of F words and of reports."""
PREPARED_S = 0.1
"""Maximum time by which a board's planner and its reported feed may be ahead of its steps."""
SEGMENTS_S = 0.06
"""Maximum time by which GRBL's reported feed is ahead of its position: five segments of 10 ms, and the steps of one."""
INTERVALS = 12
"""Number of intervals in the sum of the highest possible speed between two reports."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Segment:
    """A straight move in machine coordinates (mm) at a feed (mm/min)."""

    start_mm: Vector
    end_mm: Vector
    feed_mm_min: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Deviation:
    """How a report differs from the path.

    Parameters
    ----------
    at_mm
        The reported machine position.
    off_mm
        Distance from the part of the path where the board can be, 0 if only the feed is wrong.
    feed_mm_min, feed_limit_mm_min
        Reported feed, and the maximum that the path allows.
    """

    at_mm: tuple[float, ...]
    off_mm: float
    feed_mm_min: float
    feed_limit_mm_min: float

    def text(self) -> str:
        """Return the deviation for people."""
        place = ", ".join(f"{value:.3f}" for value in self.at_mm)
        if self.off_mm > 0.0:
            return Message("link.reports_mpos_off_limit", place_mm=place, off_mm=self.off_mm, tube_mm=TUBE_MM)
        return Message(
            "link.reports_feed_min_limit_min", feed_mm_min=self.feed_mm_min, feed_limit_mm_min=self.feed_limit_mm_min
        )

    def details(self) -> tuple[tuple[str, str], ...]:
        """Return the values as pairs for ``GoalResult.details``."""
        return (
            ("off_path_mm", f"{self.off_mm:.3f}"),
            ("feed_mm_min", f"{self.feed_mm_min:.0f}"),
            ("feed_limit_mm_min", f"{self.feed_limit_mm_min:.0f}"),
        )


class PathWatch:
    """Follows the reports along a path that starts at rest.

    Parameters
    ----------
    path
        Pieces of the path; none for a path without motion.
    now
        Time of the start, s.
    acceleration_mm_s2
        Acceleration of each axis; None if the reported speeds do not limit the speed between two reports.
    """

    def __init__(self, path: Polyline, now: float, acceleration_mm_s2: Sequence[float] | None = None) -> None:
        self._path = path
        self._low_mm = self._high_mm = 0.0
        self._most_mm = math.inf
        self._at = now
        self._feed_mm_min: float | None = 0.0
        self._acceleration_mm_s2 = acceleration_mm_s2
        self.early = False
        """Whether the last report on the path was farther ahead than the board can be: a second one decides."""

    @classmethod
    def along(
        cls,
        start_mm: Vector,
        segments: Sequence[Segment],
        axes: int,
        now: float,
        acceleration_mm_s2: Sequence[float] | None = None,
    ) -> PathWatch:
        """Return the watch of a stage's segments."""
        path = Polyline(start_mm, axes)
        for segment in segments:
            path.append(segment.end_mm, segment.feed_mm_min)
        return cls(path, now, acceleration_mm_s2)

    def bound(self, executed_mm: float, sent_mm: float) -> None:
        """Take the executed and the sent distance along the path.

        A board drops a move from its planner when it has prepared the move's last steps, shortly before it makes them.
        """
        self._low_mm = max(self._low_mm, executed_mm - self._path.highest_feed / 60.0 * PREPARED_S)
        self._high_mm = max(self._high_mm, self._low_mm)
        self._most_mm = sent_mm + TUBE_MM

    def feed_limit_mm_min(self, high_mm: float) -> float:
        """Return the maximum feed in a report of a board that has moved at most ``high_mm`` along the path."""
        ahead_mm = self._path.highest_feed / 60.0 * PREPARED_S
        return self._feed_to(high_mm + ahead_mm) * FEED_SHARE + FEED_MM_MIN

    def off_end_mm(self, mpos_mm: Sequence[float]) -> float:
        """Return the distance of a position from the path's end, in mm."""
        return math.dist(mpos_mm[: self._path.axes], self._path.end_mm)

    def check(
        self, mpos_mm: tuple[float, ...], feed_mm_min: float | None, now: float, asked_at: float | None = None
    ) -> Deviation | None:
        """Return how a report deviates; if it does not, return None and follow the report unless it is early.

        The board wrote it between ``asked_at`` and ``now``; a busy computer may read it late. Some boards report no
        feed.
        """
        place = mpos_mm[: self._path.axes]
        reach_mm = self._high_mm + self._path.highest_feed / 60.0 * (now - self._at + REPORT_LATE_S) + TUBE_MM
        reach_mm = min(reach_mm, self._most_mm)
        low, high = self._matched(place, reach_mm)
        limit = self.feed_limit_mm_min(high if low <= high else reach_mm)
        too_fast = feed_mm_min is not None and feed_mm_min > limit
        if max(high - low, self._high_mm - self._low_mm) > AMBIGUOUS_MM:  # use the most probable position
            ahead_mm = low - self._high_mm
        else:
            ahead_mm = min(low - self._low_mm, high - self._high_mm)  # near a corner one end is on the other piece
        self.early = low <= high and not self.early and ahead_mm > self._way_mm(feed_mm_min, now, high) + EARLY_MM
        if self.early and not too_fast:
            return None
        if low <= high and not too_fast:
            self._low_mm, self._high_mm, self._at = low, high, now if asked_at is None else asked_at
            self._feed_mm_min = feed_mm_min
            return None
        return Deviation(
            at_mm=mpos_mm,
            off_mm=0.0 if low <= high else max(self._off_mm(place, reach_mm), TUBE_MM),
            feed_mm_min=feed_mm_min or 0.0,
            feed_limit_mm_min=limit,
        )

    def _way_mm(self, feed_mm_min: float | None, now: float, high_mm: float) -> float:
        """Return the maximum distance since the last report, from the speeds in both reports and the path's feed.

        The axes' acceleration limits the speed between the times of the two reported speeds. The time of a speed may be
        later than that of its position by ``SEGMENTS_S``.
        """
        seconds, highest = max(now - self._at, 0.0), self._feed_to(high_mm) / 60.0
        if feed_mm_min is None or self._feed_mm_min is None or self._acceleration_mm_s2 is None:
            return highest * seconds
        first, last = self._feed_mm_min / 60.0, feed_mm_min / 60.0
        acceleration = max((self._acceleration(number) for number in self._pieces(high_mm)), default=0.0)
        times = [seconds * (number + 0.5) / INTERVALS for number in range(INTERVALS)]
        speeds = (
            min(
                highest,
                first + acceleration * max(at, SEGMENTS_S - at),
                last + acceleration * (seconds - at + SEGMENTS_S),
            )
            for at in times
        )
        return sum(speeds) * seconds / INTERVALS

    def _acceleration(self, number: int) -> float:
        """Return the acceleration along a piece in mm/s^2, limited by the axis that allows the least."""
        assert self._acceleration_mm_s2 is not None
        start, end = self._path.points[number - 1 : number + 1]
        length = math.dist(start, end)
        return min(a * length / abs(e - s) for a, s, e in zip(self._acceleration_mm_s2, start, end) if e != s)

    def _feed_to(self, along_mm: float) -> float:
        """Return the highest feed between the board's last position and a position farther along the path."""
        return max((self._path.feeds[number] for number in self._pieces(along_mm)), default=0.0)

    def _pieces(self, reach_mm: float) -> range:
        """Return the numbers of the pieces where the board can be."""
        return self._path.pieces(self._low_mm - TUBE_MM, reach_mm)

    def _matched(self, place: Sequence[float], reach_mm: float) -> tuple[float, float]:
        """Return the lowest and highest distance along the path at which the tube contains ``place``."""
        low, high = math.inf, -math.inf
        if len(self._path.points) == 1:
            inside = math.dist(place, self._path.points[0]) <= TUBE_MM
            return (0.0, 0.0) if inside else (low, high)
        for number in self._pieces(reach_mm):
            begin_mm, end_mm = self._path.ends_mm[number - 1 : number + 1]
            length = end_mm - begin_mm
            start, end = self._path.points[number - 1 : number + 1]
            unit = [(b - a) / length for a, b in zip(start, end)]
            along = sum((p - a) * u for p, a, u in zip(place, start, unit))
            across_sqr = sum((p - a) ** 2 for p, a in zip(place, start)) - along * along
            half_sqr = TUBE_MM * TUBE_MM - across_sqr
            if half_sqr < 0.0:
                continue
            half = math.sqrt(half_sqr)
            nearest, farthest = max(along - half, 0.0), min(along + half, length)
            if nearest > farthest:
                continue
            nearest, farthest = max(begin_mm + nearest, self._low_mm - TUBE_MM), min(begin_mm + farthest, reach_mm)
            if nearest <= farthest:
                low, high = min(low, nearest), max(high, farthest)
        return low, high

    def _off_mm(self, place: Sequence[float], reach_mm: float) -> float:
        """Return the distance from the part of the path where the board can be."""
        best = math.dist(place, self._path.points[0]) if len(self._path.points) == 1 else math.inf
        for number in self._pieces(reach_mm):
            begin_mm, end_mm = self._path.ends_mm[number - 1 : number + 1]
            length = end_mm - begin_mm
            start, end = self._path.points[number - 1 : number + 1]
            along = sum((p - a) * (b - a) for p, a, b in zip(place, start, end)) / length
            along = min(max(along, self._low_mm - begin_mm, 0.0), length, max(reach_mm - begin_mm, 0.0))
            near = [a + (b - a) * along / length for a, b in zip(start, end)]
            best = min(best, math.dist(place, near))
        return best
