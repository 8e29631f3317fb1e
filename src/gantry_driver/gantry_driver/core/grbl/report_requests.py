"""Requests for status reports, and their answers in order; no I/O and no clock."""

from __future__ import annotations

from collections import deque

MAX_OPEN = 6
"""Maximum number of open report requests (three polls of two); beyond it the oldest one, or its report, was lost."""
SILENT_POLLS = 3
"""Number of poll intervals without a report after which the next report may answer a request that counts as lost."""
ANSWER_WITHIN_S = 0.08
"""Seconds after which an open request counts as lost, if requests are rarer than that: a board merges two requests that
arrive together, and a starting board answers none. Among frequent requests a lost one looks like a slow link."""


class ReportRequests:
    """Times of the requests without an answer."""

    def __init__(self) -> None:
        self._asked: deque[float] = deque()
        self._dropped_at: float | None = None
        """Time of the first request since the last report that counts as lost."""

    def __bool__(self) -> bool:
        """Whether a request has no answer."""
        return bool(self._asked)

    def clear(self) -> None:
        """Forget all requests."""
        self._asked.clear()
        self._dropped_at = None

    def answered(self, now: float, *, silent: bool) -> float:
        """Take a report and return the time of its request; ``now`` for a report without a request.

        ``silent``: the board was silent before it, so it may be the late answer to a request that counts as lost.
        """
        asked_at = self._asked.popleft() if self._asked else now
        if silent and self._dropped_at is not None:
            asked_at = self._dropped_at
        self._dropped_at = None
        return asked_at

    def drop_lost(self, interval_s: float, now: float) -> None:
        """Forget the requests that were lost; ``interval_s`` is the time between two requests."""
        while self._asked and interval_s >= ANSWER_WITHIN_S <= now - self._asked[0]:
            self._drop()

    def ask(self, count: int, now: float) -> None:
        """Note requests that are sent now."""
        self._asked.extend([now] * count)
        while len(self._asked) > MAX_OPEN:
            self._drop()

    def _drop(self) -> None:
        asked_at = self._asked.popleft()
        self._dropped_at = asked_at if self._dropped_at is None else self._dropped_at
