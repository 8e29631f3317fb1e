"""Maximum rates of each page, and of all pages of a user: buckets that fill with time."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Generic, TypeVar

MESSAGES_PER_S, BURST = 40.0, 80.0
"""Messages of one page; a page sends 15 a second while an arrow is held."""
USER_MESSAGES_PER_S, USER_BURST = 80.0, 160.0
BYTES_PER_S, BURST_BYTES = 16e3, 100e3
"""Bytes of one user's messages; the burst allows three of the longest messages."""
STOPS_PER_S, STOP_BURST = 10.0, 20.0
DROPPED_PER_S, DROPPED_BURST = 10.0, 80.0
"""Messages of a page beyond its rate that are dropped unread; more than this ends the connection."""
OPENED_PER_S, OPENED_BURST = 4.0, 40.0
"""New connections of one user; eight pages that reconnect at once open sixteen."""
REQUESTS_PER_S, REQUESTS_BURST = 40.0, 400.0
"""Plain requests of one user; a page needs fifty files. Requests beyond the rate wait."""
PINGS_PER_S, PINGS_BURST = 4.0, 40.0
"""Pings and pongs on one connection."""
PICTURES_PER_S, PICTURES_BURST = 120.0, 240.0
"""Messages on the video connection: one for each drawn picture."""
MAX_USERS = 256


@dataclass(slots=True)
class Bucket:
    """Token bucket: allows ``burst`` at once, and ``per_s`` over time."""

    per_s: float
    burst: float
    _left: float = field(init=False)
    _filled_s: float = field(init=False, default=float("-inf"))

    def __post_init__(self) -> None:
        self._left = self.burst

    def take(self, now_s: float, amount: float = 1.0) -> bool:
        """Return whether the amount may pass; a rejected amount costs nothing."""
        passed_s = max(now_s - self._filled_s, 0.0)
        self._left = min(self.burst, self._left + passed_s * self.per_s)
        self._filled_s = now_s
        if self._left < amount:
            return False
        self._left -= amount
        return True

    def wait_s(self, amount: float = 1.0) -> float:
        """Return the seconds from the last :meth:`take` until the amount may pass."""
        return max(amount - self._left, 0.0) / self.per_s


Kept = TypeVar("Kept")


class OfUsers(Generic[Kept]):
    """One value for each user; the least recently used ones are forgotten."""

    def __init__(self, make: Callable[[], Kept]) -> None:
        self._make = make
        self._of: OrderedDict[str, Kept] = OrderedDict()

    def __getitem__(self, name: str) -> Kept:
        found = self._of.pop(name, None)
        self._of[name] = kept = self._make() if found is None else found
        while len(self._of) > MAX_USERS:
            self._of.popitem(last=False)
        return kept

    def get(self, name: str) -> Kept | None:
        """Return a user's value, None if there is none."""
        return self._of.get(name)


@dataclass(slots=True)
class UserBudget:
    """Limits of all pages of one user together."""

    messages: Bucket = field(default_factory=lambda: Bucket(USER_MESSAGES_PER_S, USER_BURST))
    size: Bucket = field(default_factory=lambda: Bucket(BYTES_PER_S, BURST_BYTES))
