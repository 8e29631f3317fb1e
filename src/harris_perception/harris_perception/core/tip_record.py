"""Where the stylus's tip was in the last pictures, so that each is read by its own."""

from __future__ import annotations

from collections import OrderedDict

from icu_common.core.geometry import Array

_KEPT = 64
_RECENT_NS = 2_000_000_000
"""A tip so much later than a picture is of a recording that has started anew since."""


class TipRecord:
    """What the tracker has said of the last pictures, by their stamps."""

    def __init__(self) -> None:
        self._tips: OrderedDict[int, Array | None] = OrderedDict()

    def add(self, stamp_ns: int, tip: Array | None) -> None:
        """Take where the tip is in a picture, (3,) metres, left rectified frame; None where that is not certain."""
        self._tips[stamp_ns] = tip
        while len(self._tips) > _KEPT:
            self._tips.popitem(last=False)

    def is_complete(self, stamp_ns: int) -> bool:
        """Whether the tracker is through with a picture: it looks at them in order, but may leave some out."""
        return any(0 <= said_ns - stamp_ns <= _RECENT_NS for said_ns in self._tips)

    def at(self, stamp_ns: int, max_age_ns: float) -> tuple[Array | None, int]:
        """Return the tip in a picture, and how many ns before or after it was seen there, 0 for in that very one.

        Where none was seen for longer than ``max_age_ns``, the stylus is not in view: (None, 0).
        """
        seen = [(abs(said_ns - stamp_ns), said_ns) for said_ns, tip in self._tips.items() if tip is not None]
        age_ns, nearest_ns = min(seen, default=(0, 0))
        return (self._tips[nearest_ns], age_ns) if seen and age_ns <= max_age_ns else (None, 0)
