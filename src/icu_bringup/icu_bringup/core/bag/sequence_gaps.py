"""Count the messages that were sent and not received, by the middleware's sequence numbers."""

from __future__ import annotations

from dataclasses import dataclass, field

_REMEMBERED = 1000


@dataclass(slots=True)
class _Publisher:
    last: int
    open: set[int] = field(default_factory=set)


class SequenceGaps:
    """Sequence numbers of one topic's messages; each publisher counts from 1.

    A message does not name its publisher. With one publisher the count is exact; with several, a number belongs to the
    publisher whose last number is nearest below it.
    """

    def __init__(self) -> None:
        self._publishers: list[_Publisher] = []
        self._newest_ns = 0
        self.lost = 0

    def add(self, number: int, publishers: int, sent_ns: int = 0) -> None:
        """Add a received message's number and time; ``publishers`` is the topic's present number of publishers."""
        for one in self._publishers:
            if number in one.open:  # received out of order
                one.open.remove(number)
                self.lost -= 1
                return
        if sent_ns < self._newest_ns:
            return  # kept for late subscribers: no evidence about the messages after it
        self._newest_ns = sent_ns
        below = [one for one in self._publishers if one.last < number]
        nearest = max(below, key=lambda one: one.last, default=None)
        new = len(self._publishers) < publishers and (nearest is None or nearest.last + 1 != number)
        if nearest is None or new:
            # The first message of a known publisher: there was none before.
            self._publishers.append(_Publisher(number))
            del self._publishers[: -max(1, publishers)]
            return
        gap = number - nearest.last - 1
        self.lost += gap
        nearest.open |= set(range(max(nearest.last + 1, number - _REMEMBERED), number))
        if len(nearest.open) > _REMEMBERED:
            nearest.open = set(sorted(nearest.open)[-_REMEMBERED:])
        nearest.last = number
        self._publishers.remove(nearest)
        self._publishers.append(nearest)
