"""One page at the desk: its user, its permitted requests and their rates; independent of the machine's state."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from scope_ui_bridge.core import wire
from scope_ui_bridge.core.access.passwords import Role
from scope_ui_bridge.core.admission import (
    BURST,
    DROPPED_BURST,
    DROPPED_PER_S,
    MESSAGES_PER_S,
    STOP_BURST,
    STOPS_PER_S,
    Bucket,
    UserBudget,
)
from scope_ui_bridge.core.wire import Refusal

_TELL_RATE_EVERY_S = 1.0
SHORT = 2048
"""Maximum size of a message of a page without control, in characters: only orders are longer."""
FLOODING = "flooding"
"""Refusal that ends a page's connection because it kept sending after the request to slow down."""


@dataclass(slots=True)
class Viewer:
    """A page of the user ``name``, whose sign-in ends at ``signed_in_until_s``; the user's pages share ``user``."""

    name: str
    role: Role
    signed_in_until_s: float = math.inf
    user: UserBudget = field(default_factory=UserBudget)
    _last_seq: int = -1
    _stopped_seq: int = -1
    _told_rate_s: float = -math.inf
    _messages: Bucket = field(default_factory=lambda: Bucket(MESSAGES_PER_S, BURST))
    _stops: Bucket = field(default_factory=lambda: Bucket(STOPS_PER_S, STOP_BURST))
    _dropped: Bucket = field(default_factory=lambda: Bucket(DROPPED_PER_S, DROPPED_BURST))

    def need(self, role: Role) -> None:
        """Refuse (``role_needed``) unless the page's role includes ``role``."""
        if not self.role.may(role):
            raise Refusal("role_needed", role=role.value, found=self.role.value)

    def may_stop(self, text: str | bytes, now_s: float) -> bool:
        """Return whether an unparsed text may be a stop, which is read even if this page sends too much.

        Their rate is limited: a repeated stop within half a second is the same stop.
        """
        named = b'"stop"' in text if isinstance(text, bytes) else '"stop"' in text
        return named and len(text) <= wire.MAX_STOP and self._stops.take(now_s)

    def limit(self, size: int, longest: int, now_s: float) -> None:
        """Refuse a message before it is read, by its size, by this page's rate, and by the user's rate.

        ``rate_limited`` messages are dropped; a page that keeps sending is ``flooding``.
        """
        within = self._messages.take(now_s) and self.user.messages.take(now_s)
        if within and size > longest:
            raise Refusal("oversized", size=size, limit=longest)
        if within and self.user.size.take(now_s, size):
            return
        raise Refusal("rate_limited" if self._dropped.take(now_s) else FLOODING, limit=MESSAGES_PER_S)

    def admit(self, message: wire.PageMessage, boot_id: str) -> None:
        """Refuse a message for another run of the server (``old_boot``), or a repeated one (``replayed``)."""
        if message.boot != boot_id:
            raise Refusal("old_boot")
        if message.seq <= self._last_seq:
            raise Refusal("replayed", found=message.seq, last=self._last_seq)
        self._last_seq = message.seq

    def stopped(self, seq: int) -> None:
        """Record that STOP was pressed on this page after message ``seq``, which may not have arrived yet."""
        self._stopped_seq = max(self._stopped_seq, seq)

    def check_after_stop(self, seq: int) -> None:
        """Refuse (``before_stop``) a message sent before a STOP that has overtaken it on another path."""
        if seq <= self._stopped_seq:
            raise Refusal("before_stop")

    def may_tell_rate(self, now_s: float) -> bool:
        """Return whether to report to this page that it sends too fast: at most once a second."""
        if now_s - self._told_rate_s < _TELL_RATE_EVERY_S:
            return False
        self._told_rate_s = now_s
        return True
