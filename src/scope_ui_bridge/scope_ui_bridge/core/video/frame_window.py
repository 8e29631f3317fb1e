"""Flow control of images to one viewer: images sent and not yet drawn, and the form that suits its link.

At most two images are in flight, and only the newest is worth sending. If they take long to arrive, the viewer gets a
lighter form, one image at a time. The first lighter form is small enough that it should suffice. Heavier forms are then
tried step by step, less and less often while they fail. A step is so small that a failed try delays images by at most a
tenth of a second. Flight time is measured from sending to the acknowledgement after drawing, so no clocks have to
agree.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Form:
    """``scale`` of the sides, share of the set JPEG ``quality``, and share of the full form's bytes (measured)."""

    scale: float
    quality: float
    size: float


FORMS = (
    Form(1.0, 1.0, 1.0),
    Form(1.0, 0.75, 0.7),
    Form(0.75, 0.75, 0.43),
    Form(0.5, 0.75, 0.24),
    Form(0.375, 0.6, 0.12),
)
SLOW_S = (0.15, 0.14)
"""Flight times above which an image is slow: with two full images in flight, with one lighter image."""
_QUICK_S = 0.1
_ENOUGH = 5  # slow flights in a row; a very slow one counts twice, so one delay of two images in flight is tolerated
_STEP_UP_S = 1.0
_FIRST_RETRY_S, _LONGEST_RETRY_S = 5.0, 80.0


class FrameWindow:
    """Flow control of one viewer; times in monotonic seconds."""

    def __init__(self) -> None:
        self.level = 0
        self._under_way: deque[tuple[int, float]] = deque()
        self._last_sent = -1
        self._slow = 0
        self._retry_s = _FIRST_RETRY_S
        self._heavier_at_s = 0.0

    @property
    def light(self) -> bool:
        """Whether the form is lighter than the full form."""
        return self.level > 0

    @property
    def open(self) -> bool:
        """Whether an image may be sent now."""
        return len(self._under_way) < (1 if self.light else 2)

    def wants(self, seq: int) -> bool:
        """Return whether image ``seq`` may be sent now: it is newer than the last one, and the window has room."""
        return self.open and seq > self._last_sent

    def sent(self, seq: int, now_s: float) -> None:
        """Record that image ``seq`` is in flight."""
        self._under_way.append((seq, now_s))
        self._last_sent = seq

    def acknowledged(self, seq: int, now_s: float) -> None:
        """Record that the viewer has drawn ``seq``; all earlier images are settled, unknown numbers are ignored."""
        sent_s = next((moment for number, moment in self._under_way if number == seq), None)
        if sent_s is None:
            return
        while self._under_way.popleft()[0] != seq:
            pass
        self._judge(now_s - sent_s, now_s)

    def _judge(self, flight_s: float, now_s: float) -> None:
        slow_s = SLOW_S[self.light]
        if flight_s > slow_s:
            self._slow += 2 if flight_s > 2 * slow_s else 1
            if self._slow >= _ENOUGH and self.level < len(FORMS) - 1:
                self._lighter(flight_s, now_s)
            return
        self._slow = 0
        if now_s - self._heavier_at_s > _LONGEST_RETRY_S:
            self._retry_s = _FIRST_RETRY_S
        if self.light and flight_s < _QUICK_S and now_s >= self._heavier_at_s:
            self.level -= 1
            self._slow = _ENOUGH - 1  # one slow image is enough now
            self._heavier_at_s = now_s + _STEP_UP_S

    def _lighter(self, flight_s: float, now_s: float) -> None:
        per_size = flight_s / FORMS[self.level].size
        lighter = range(self.level + 1, len(FORMS))
        self.level = next((n for n in lighter if per_size * FORMS[n].size < SLOW_S[True]), lighter[-1])
        self._slow = 0
        self._heavier_at_s = now_s + self._retry_s
        self._retry_s = min(2 * self._retry_s, _LONGEST_RETRY_S)
