"""Positions of the stylus's tip in the last images, so that each image is read with its own tip."""

from __future__ import annotations

from collections import OrderedDict

from icu_common.core.geometry.geometry import Array

_KEPT = 64
_RECENT_NS = 2_000_000_000
"""Maximum time by which a tip may be later than an image; a later one comes from a recording that has restarted."""


class TipRecord:
    """The tracker's results for the last images, by their stamps."""

    def __init__(self) -> None:
        self._tips: OrderedDict[int, Array | None] = OrderedDict()

    def add(self, stamp_ns: int, tip: Array | None) -> None:
        """Add the tip in an image, (3,) metres, left rectified frame; None if it is uncertain."""
        self._tips[stamp_ns] = tip
        while len(self._tips) > _KEPT:
            self._tips.popitem(last=False)

    def is_complete(self, stamp_ns: int) -> bool:
        """Return whether the tracker has processed an image: it works in order, but may skip images."""
        return any(0 <= said_ns - stamp_ns <= _RECENT_NS for said_ns in self._tips)

    def at(self, stamp_ns: int, max_age_ns: float) -> tuple[Array | None, int]:
        """Return the tip for an image, and the time in ns to the image in which it was seen; 0 for that same image.

        If no tip was seen within ``max_age_ns``, the stylus is not in view: (None, 0).
        """
        seen = [(abs(said_ns - stamp_ns), said_ns) for said_ns, tip in self._tips.items() if tip is not None]
        age_ns, nearest_ns = min(seen, default=(0, 0))
        return (self._tips[nearest_ns], age_ns) if seen and age_ns <= max_age_ns else (None, 0)
