"""How fast one may come: buckets that fill with time, for each page and, over all of them, for each user."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Generic, TypeVar

MESSAGES_PER_S, BURST = 40.0, 80.0
"""Of one page: it sends 15 a second while an arrow is held."""
USER_MESSAGES_PER_S, USER_BURST = 80.0, 160.0
BYTES_PER_S, BURST_BYTES = 16e3, 100e3
"""Of one user: three of the longest messages at once."""
STOPS_PER_S, STOP_BURST = 10.0, 20.0
DROPPED_PER_S, DROPPED_BURST = 10.0, 80.0
"""What a page may send beyond its rate: it is dropped unread, and more than this ends the connection."""
OPENED_PER_S, OPENED_BURST = 4.0, 40.0
"""Connections that one user may open: eight pages that come back at once open sixteen."""
REQUESTS_PER_S, REQUESTS_BURST = 40.0, 400.0
"""Plain requests of one user: a page needs forty files; what comes faster waits."""
PINGS_PER_S, PINGS_BURST = 4.0, 40.0
"""Pings and pongs on one connection, each of which is looked at or answered."""
PICTURES_PER_S, PICTURES_BURST = 120.0, 240.0
"""Messages on the connection of the pictures: one for each that was drawn."""
MAX_USERS = 256


@dataclass(slots=True)
class Bucket:
    """Lets ``burst`` through at once, and then ``per_s``."""

    per_s: float
    burst: float
    _left: float = field(init=False)
    _filled_s: float = field(init=False, default=float("-inf"))

    def __post_init__(self) -> None:
        self._left = self.burst

    def take(self, now_s: float, amount: float = 1.0) -> bool:
        """Whether as much may pass; what may not takes nothing."""
        passed_s = max(now_s - self._filled_s, 0.0)
        self._left = min(self.burst, self._left + passed_s * self.per_s)
        self._filled_s = now_s
        if self._left < amount:
            return False
        self._left -= amount
        return True

    def wait_s(self, amount: float = 1.0) -> float:
        """Return in how many seconds as much may pass, from the last :meth:`take` on."""
        return max(amount - self._left, 0.0) / self.per_s


Kept = TypeVar("Kept")


class OfUsers(Generic[Kept]):
    """One value for each user; those that have not been asked for longest are forgotten."""

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
        """Return the value of a user who has one."""
        return self._of.get(name)


@dataclass(slots=True)
class UserBudget:
    """What all pages of one user may send together."""

    messages: Bucket = field(default_factory=lambda: Bucket(USER_MESSAGES_PER_S, USER_BURST))
    size: Bucket = field(default_factory=lambda: Bucket(BYTES_PER_S, BURST_BYTES))
