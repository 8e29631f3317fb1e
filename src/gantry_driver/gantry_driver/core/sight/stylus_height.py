"""The stylus's height above the panel from images alone, without a calibration or a machine position."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field

NEEDED = 5
"""Minimum number of images that must agree."""
SPAN_NS = 1_000_000_000
"""Minimum time that these images span."""
SPREAD_M = 0.002
"""Maximum difference of their heights: a sinking stylus, or a reflection that the tracker follows, changes more."""
OLDEST_NS = 3_000_000_000
"""Age beyond which an image proves nothing about the present."""


@dataclass(slots=True)
class StylusHeight:
    """Heights from successive images.

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
        """Add the height from one image; an older stamp means another clock and discards all heights before it."""
        if self.seen and stamp_ns < self.seen[-1][0]:
            self.seen.clear()
        self.seen.append((stamp_ns, height_m))
        while self.seen[-1][0] - self.seen[0][0] > OLDEST_NS:
            self.seen.popleft()

    def at_least_m(self, now_ns: int) -> float | None:
        """Return the minimum height on which enough images agree, None if they do not agree."""
        young = [(stamp, height) for stamp, height in self.seen if now_ns - stamp <= OLDEST_NS]
        if len(young) < NEEDED or young[-1][0] - young[0][0] < SPAN_NS:
            return None
        heights = [height for _, height in young]
        return min(heights) if max(heights) - min(heights) <= SPREAD_M else None
