"""Which pictures a viewer has got and not yet drawn, and how large they should be for its link.

At most two are under way and only the newest is worth sending. When they take long to arrive, the viewer gets the
light form (half the size) one at a time; the full one is tried again after a while, less and less often while it
fails. What counts is the time from sending to the acknowledgement after drawing, so no clocks have to agree.
"""

from __future__ import annotations

from collections import deque

SLOW_S = 0.15
"""Flights longer than this, three in a row, make the pictures light."""
_SLOW_IN_A_ROW = 3
_FIRST_RETRY_S, _LONGEST_RETRY_S = 5.0, 80.0


class FrameWindow:
    """Flow control of one viewer; times in monotonic seconds."""

    def __init__(self) -> None:
        self.light = False
        self._under_way: deque[tuple[int, float]] = deque()
        self._last_sent = -1
        self._slow = 0
        self._retry_s = _FIRST_RETRY_S
        self._full_again_s = 0.0

    @property
    def open(self) -> bool:
        """Whether any picture may be sent now."""
        return len(self._under_way) < (1 if self.light else 2)

    def wants(self, seq: int) -> bool:
        """Tell whether picture ``seq`` may be sent now: newer than the last one, and room in the window."""
        return self.open and seq > self._last_sent

    def sent(self, seq: int, now_s: float) -> None:
        """Note that picture ``seq`` is under way."""
        self._under_way.append((seq, now_s))
        self._last_sent = seq

    def acknowledged(self, seq: int, now_s: float) -> None:
        """Note that the viewer has drawn ``seq``, which settles all before it; unknown numbers change nothing."""
        sent_s = next((moment for number, moment in self._under_way if number == seq), None)
        if sent_s is None:
            return
        while self._under_way.popleft()[0] != seq:
            pass
        self._judge(now_s - sent_s, now_s)

    def _judge(self, flight_s: float, now_s: float) -> None:
        if self.light:
            if flight_s < SLOW_S / 2 and now_s >= self._full_again_s:
                self.light, self._slow = False, _SLOW_IN_A_ROW - 1  # one slow picture is enough now
        elif flight_s <= SLOW_S:
            if self._slow == 0 and now_s - self._full_again_s > _LONGEST_RETRY_S:
                self._retry_s = _FIRST_RETRY_S
            self._slow = 0
        else:
            self._slow += 1
            if self._slow >= _SLOW_IN_A_ROW:
                self.light, self._full_again_s = True, now_s + self._retry_s
                self._retry_s = min(2 * self._retry_s, _LONGEST_RETRY_S)
