"""Requests for status reports, and their answers in order; no I/O and no clock."""

from __future__ import annotations

from collections import deque

MAX_OPEN = 6
"""Maximum number of open report requests (three polls of two); beyond it the oldest one, or its report, was lost."""
ANSWER_WITHIN_S = 0.08
"""Seconds after which an open request counts as lost, if requests are rarer than that: a board merges two requests that
arrive together, and a starting board answers none. Among frequent requests a lost one looks like a slow link."""


class ReportRequests:
    """Times of the requests without an answer."""

    def __init__(self) -> None:
        self._asked: deque[float] = deque()

    def __bool__(self) -> bool:
        """Whether a request has no answer."""
        return bool(self._asked)

    def clear(self) -> None:
        """Forget all requests."""
        self._asked.clear()

    def answered(self, now: float) -> float:
        """Take a report and return the time of its request; ``now`` for a report without a request."""
        return self._asked.popleft() if self._asked else now

    def drop_lost(self, interval_s: float, now: float) -> None:
        """Forget the requests that were lost; ``interval_s`` is the time between two requests."""
        while self._asked and interval_s >= ANSWER_WITHIN_S <= now - self._asked[0]:
            self._asked.popleft()

    def ask(self, count: int, now: float) -> None:
        """Note requests that are sent now."""
        self._asked.extend([now] * count)
        while len(self._asked) > MAX_OPEN:
            self._asked.popleft()
