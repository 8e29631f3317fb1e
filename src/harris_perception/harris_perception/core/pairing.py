"""Brings together what belongs to one moment but arrives on several topics."""

from __future__ import annotations

from collections import OrderedDict
from typing import Any


class Pairing:
    """Matches items of several streams by their stamps: equal stamps first, else within a tolerance.

    Parameters
    ----------
    streams
        Number of streams.
    tolerance_ns
        Stamps of one moment differ by at most this; keep it below half of the period.
    depth
        Items kept per stream while their partners are on the way.

    Attributes
    ----------
    unpaired
        Items given up so far because partners never came.
    newest_ns
        The stamp, in the first stream, of the newest complete moment.
    """

    def __init__(self, streams: int, *, tolerance_ns: int = 0, depth: int = 8) -> None:
        self._waiting: list[OrderedDict[int, Any]] = [OrderedDict() for _ in range(streams)]
        self.tolerance_ns, self._depth = tolerance_ns, depth
        self.unpaired = 0
        self.newest_ns = self._due_ns = 0

    def add(self, stream: int, stamp_ns: int, item: Any) -> tuple[Any, ...] | None:
        """Take one item; return the items of one moment, in the order of the streams, once they are complete.

        The moment is complete when the last of its items arrives; whatever is older is given up then.
        """
        waiting = self._waiting[stream]
        waiting[stamp_ns] = item
        chosen = [self._nearest(other, stamp_ns) for other in self._waiting]
        stamps = [stamp for stamp in chosen if stamp is not None]
        if len(stamps) < len(chosen) or max(stamps) - min(stamps) > self.tolerance_ns:
            if len(waiting) > self._depth:
                waiting.popitem(last=False)
                self.unpaired += 1
            return None
        self.newest_ns = stamps[0]
        items = tuple(other[stamp] for other, stamp in zip(self._waiting, stamps))
        for other, stamp in zip(self._waiting, stamps):
            for old in [s for s in other if s <= stamp]:
                del other[old]
                self.unpaired += old != stamp
        return items

    def due(self, rate_hz: float) -> bool:
        """Whether the newest moment comes a period after the last one that was due; a millisecond is jitter.

        By their stamps, so that a replayed recording is thinned in the same way, also one that starts anew.
        """
        early = self._due_ns <= self.newest_ns < self._due_ns + 1e9 / rate_hz - 1e6
        self._due_ns = self._due_ns if early else self.newest_ns
        return not early

    def _nearest(self, other: OrderedDict[int, Any], stamp_ns: int) -> int | None:
        near = min(other, key=lambda stamp: abs(stamp - stamp_ns), default=None)
        return near if near is not None and abs(near - stamp_ns) <= self.tolerance_ns else None

    def clear(self) -> None:
        """Forget everything, for example when the clock has jumped back."""
        for other in self._waiting:
            self.unpaired += len(other)
            other.clear()
