"""A path of straight pieces with their feeds, and the distances along it; no I/O and no clock."""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Sequence

_STRAIGHT = 1.0 - 1e-9


class Polyline:
    """A path in machine coordinates, in mm and mm/min.

    Parameters
    ----------
    start_mm
        Start position.
    axes
        Number of axes in reports, 2 if the stylus is not an axis of the board.

    Attributes
    ----------
    points, ends_mm, feeds
        End of each piece, its distance along the path, and the feed to it; the start is the first entry.
    end_mm
        End of the path.
    highest_feed
        Maximum feed of all pieces.
    """

    def __init__(self, start_mm: Sequence[float], axes: int) -> None:
        self.axes = axes
        self.points: list[tuple[float, ...]] = [tuple(start_mm[:axes])]
        self.ends_mm = [0.0]
        self.feeds = [0.0]
        self.highest_feed = 0.0
        self.end_mm = self.points[0]

    @property
    def length_mm(self) -> float:
        return self.ends_mm[-1]

    def append(self, end_mm: Sequence[float], feed_mm_min: float) -> None:
        """Add a move; a move in the same direction extends the last piece, so that searching a dense path is fast."""
        start, end = self.points[-1], tuple(end_mm[: self.axes])
        self.end_mm = end
        self.highest_feed = max(self.highest_feed, feed_mm_min)
        length = math.dist(start, end)
        if length <= 0.0:
            return
        if len(self.points) > 1:
            before = self.points[-2]
            old = self.ends_mm[-1] - self.ends_mm[-2]
            cosine = sum((b - a) * (d - b) for a, b, d in zip(before, start, end)) / (old * length)
            if cosine > _STRAIGHT and self.feeds[-1] == feed_mm_min:
                self.points.pop()
                self.ends_mm.pop()
                self.feeds.pop()
                length += old
        self.points.append(end)
        self.ends_mm.append(self.ends_mm[-1] + length)
        self.feeds.append(feed_mm_min)

    def pieces(self, low_mm: float, high_mm: float) -> range:
        """Return the numbers of the pieces between two distances along the path; none for a path without motion."""
        last = len(self.ends_mm) - 1
        first = min(bisect_left(self.ends_mm, low_mm, 1), last)
        return range(max(first, 1), min(bisect_left(self.ends_mm, high_mm, max(first, 1)), last) + 1)
