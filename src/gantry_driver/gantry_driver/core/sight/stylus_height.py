"""The stylus's height above the panel, by images alone: needs no calibration and no position of the machine."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field

NEEDED = 5
"""Images that must agree."""
SPAN_NS = 1_000_000_000
"""Time that they must span."""
SPREAD_M = 0.002
"""Largest difference of their heights: a stylus that sinks, or a reflection that the tracker follows, changes more."""
OLDEST_NS = 3_000_000_000
"""Age at which an image proves nothing about the present."""


@dataclass(slots=True)
class StylusHeight:
    """Heights that successive images show.

    Examples
    --------
    >>> height = StylusHeight()
    >>> for n in range(6):
    ...     height.take(n * 300_000_000, 0.0301)
    >>> height.at_least_m(now_ns=1_600_000_000)
    0.0301
    >>> height.at_least_m(now_ns=9_000_000_000) is None
    True
    """

    seen: deque[tuple[int, float]] = field(default_factory=deque)
    """Stamp in ns and height in m of each image."""

    def take(self, stamp_ns: int, height_m: float) -> None:
        """Take what one image shows; a stamp that goes back means another clock, and nothing before it counts."""
        if self.seen and stamp_ns < self.seen[-1][0]:
            self.seen.clear()
        self.seen.append((stamp_ns, height_m))
        while self.seen[-1][0] - self.seen[0][0] > OLDEST_NS:
            self.seen.popleft()

    def at_least_m(self, now_ns: int) -> float | None:
        """Return the smallest height that enough images agree on, None while they do not."""
        young = [(stamp, height) for stamp, height in self.seen if now_ns - stamp <= OLDEST_NS]
        if len(young) < NEEDED or young[-1][0] - young[0][0] < SPAN_NS:
            return None
        heights = [height for _, height in young]
        return min(heights) if max(heights) - min(heights) <= SPREAD_M else None
