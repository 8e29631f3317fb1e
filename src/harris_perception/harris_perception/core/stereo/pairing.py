"""Pairs messages of one instant that arrive on several topics."""

from __future__ import annotations

from collections import OrderedDict
from typing import Any

from icu_common.core.reasons.message import Message


class Pairing:
    """Matches items of several streams by their stamps: equal stamps first, else within a tolerance.

    Parameters
    ----------
    streams
        Number of streams.
    tolerance_ns
        Maximum difference between stamps of one instant; keep it below half of the period.
    depth
        Number of items kept per stream until their partners arrive.

    Attributes
    ----------
    unpaired
        Number of items discarded because partners never came.
    newest_ns
        Stamp, in the first stream, of the newest complete instant.
    apart_ns
        Difference between the stamps of the last unpaired left and right image; 0 after a pair.
    """

    def __init__(self, streams: int, *, tolerance_ns: int = 0, depth: int = 8) -> None:
        self._waiting: list[OrderedDict[int, Any]] = [OrderedDict() for _ in range(streams)]
        self.tolerance_ns, self._depth = tolerance_ns, depth
        self.unpaired = 0
        self.newest_ns = self._due_ns = self.apart_ns = 0

    def add(self, stream: int, stamp_ns: int, item: Any) -> tuple[Any, ...] | None:
        """Add one item; return the items of one instant, in the order of the streams, if they are complete.

        An instant is complete when the last of its items arrives; older items are then discarded.
        """
        waiting = self._waiting[stream]
        waiting[stamp_ns] = item
        chosen = [self._nearest(other, stamp_ns) for other in self._waiting]
        stamps = [stamp for stamp in chosen if stamp is not None]
        if len(stamps) < len(chosen) or max(stamps) - min(stamps) > self.tolerance_ns:
            if len(waiting) > self._depth:
                alone, _ = waiting.popitem(last=False)
                self.unpaired += 1
                if stream < 2 <= len(self._waiting):
                    other = self._waiting[1 - stream]
                    self.apart_ns = min((stamp - alone for stamp in other), key=abs, default=0)
            return None
        self.newest_ns, self.apart_ns = stamps[0], 0
        items = tuple(other[stamp] for other, stamp in zip(self._waiting, stamps))
        for other, stamp in zip(self._waiting, stamps):
            for old in [s for s in other if s <= stamp]:
                del other[old]
                self.unpaired += old != stamp
        return items

    def apart_text(self) -> str:
        """Return how far unpaired left and right images are apart, and the parameter to set; empty if they pair."""
        if abs(self.apart_ns) <= self.tolerance_ns:
            return ""
        apart_ms, tolerance_ms = abs(self.apart_ns) * 1e-6, self.tolerance_ns * 1e-6
        return Message("stereo.left_right_images_differ_tolerance", apart_ms=apart_ms, tolerance_ms=tolerance_ms)

    def due(self, rate_hz: float) -> bool:
        """Return whether the newest instant is a period after the last one that was due; a millisecond is jitter.

        The stamps decide, so that a replayed recording is thinned in the same way, even if it restarts.
        """
        early = self._due_ns <= self.newest_ns < self._due_ns + 1e9 / rate_hz - 1e6
        self._due_ns = self._due_ns if early else self.newest_ns
        return not early

    def _nearest(self, other: OrderedDict[int, Any], stamp_ns: int) -> int | None:
        near = min(other, key=lambda stamp: abs(stamp - stamp_ns), default=None)
        return near if near is not None and abs(near - stamp_ns) <= self.tolerance_ns else None

    def clear(self) -> None:
        """Discard all items, for example when the clock has jumped back."""
        for other in self._waiting:
            self.unpaired += len(other)
            other.clear()
