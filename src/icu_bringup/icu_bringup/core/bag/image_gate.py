"""Choice of images and clouds for a recorder that cannot keep all: whole stereo pairs, evenly spread in time."""

from __future__ import annotations

import math
from collections import OrderedDict
from collections.abc import Collection, Mapping

_STAMP = slice(4, 12)
"""Stamp in the CDR of a message that starts with a header: seconds and nanoseconds, after the encapsulation."""
_REMEMBERED = 64
_FULLNESS = (0.75, 0.85, 0.92)
"""Filled shares of the queue beyond which one of two, three, four moments is kept."""


def other_side(topic: str) -> str:
    """Return the topic of the other camera of a pair, "" for a topic without a side in its name."""
    parts = topic.split("/")
    for mine, other in (("left", "right"), ("right", "left")):
        if mine in parts:
            return "/".join(other if part == mine else part for part in parts)
    return ""


class ImageGate:
    """Decides for each moment: all messages with one stamp on the topics of a pair.

    Parameters
    ----------
    rates_hz
        Maximum rate of topics, by the stamps of images and clouds; the rate of one side applies to both.
    """

    def __init__(self, rates_hz: Mapping[str, float] | None = None) -> None:
        self._rates_hz = dict(rates_hz or {})
        self._moments: OrderedDict[tuple[str, bytes], tuple[str, set[str]]] = OrderedDict()
        self._count: dict[str, int] = {}
        self._periods: dict[str, int] = {}

    def decide(self, topic: str, data: bytes, size: int, room: int, topics: Collection[str]) -> str:
        """Return "" to keep a message, else ``rate`` or ``room``, the reason for leaving it out.

        Parameters
        ----------
        topic, data
            Topic and CDR of the message.
        size, room
            Number of bytes that wait for the disk, and its maximum.
        topics
            All topics that are recorded.
        """
        other = other_side(topic)
        pair = min(topic, other) if other in topics else topic
        key = (pair, bytes(data[_STAMP]))
        known = self._moments.get(key)
        if known is not None and topic not in known[1]:
            known[1].add(topic)
            return known[0]
        fits = size + len(data) * (2 if other in topics else 1) <= room
        sent_ns = 10**9 * int.from_bytes(data[4:8], "little") + int.from_bytes(data[8:12], "little")
        if self.too_fast(topic if topic in self._rates_hz else other, sent_ns):
            reason = "rate"
        else:
            reason = self._thinned(pair, size / room) if fits else "room"
        self._moments[key] = (reason, {topic})
        while len(self._moments) > _REMEMBERED:
            self._moments.popitem(last=False)
        return reason

    def too_fast(self, topic: str, stamp_ns: int) -> bool:
        """Return whether a message falls into the same period of the topic's maximum rate as the one before."""
        rate_hz = self._rates_hz.get(topic)
        if rate_hz is None:
            return False
        period = math.floor(stamp_ns * rate_hz / 1e9 + 1e-6)
        before, self._periods[topic] = self._periods.get(topic), period
        return period == before

    def _thinned(self, pair: str, fullness: float) -> str:
        every = 1 + sum(fullness > share for share in _FULLNESS)
        self._count[pair] = self._count.get(pair, -1) + 1
        return "" if self._count[pair] % every == 0 else "room"
