"""Which pictures a viewer has got and not yet drawn: at most two are under way; only the newest is worth sending."""

from __future__ import annotations

from collections import deque


class FrameWindow:
    """Flow control of one viewer."""

    def __init__(self, limit: int = 2) -> None:
        self._limit = limit
        self._under_way: deque[int] = deque()
        self._last_sent = -1

    def wants(self, seq: int) -> bool:
        """Tell whether picture ``seq`` may be sent now: newer than the last one, and room in the window."""
        return self.open and seq > self._last_sent

    @property
    def open(self) -> bool:
        """Whether any picture may be sent now."""
        return len(self._under_way) < self._limit

    def sent(self, seq: int) -> None:
        """Note that picture ``seq`` is under way."""
        self._under_way.append(seq)
        self._last_sent = seq

    def acknowledged(self, seq: int) -> None:
        """Note that the viewer has drawn ``seq``, which settles all before it; unknown numbers change nothing."""
        if seq in self._under_way:
            while self._under_way.popleft() != seq:
                pass
