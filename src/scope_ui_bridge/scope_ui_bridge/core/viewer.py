"""One page at the desk: who looks, what it may ask for, and how often; nothing of the machine is needed to tell."""

from __future__ import annotations

import math
from dataclasses import dataclass

from scope_ui_bridge.core import wire
from scope_ui_bridge.core.passwords import Role
from scope_ui_bridge.core.refusal import Refusal

MESSAGES_PER_S, BURST = 40.0, 80.0
_TELL_RATE_EVERY_S = 1.0


@dataclass(slots=True)
class Viewer:
    """A page of the user ``name``, whose sign-in ends at ``signed_in_until_s``."""

    name: str
    role: Role
    signed_in_until_s: float = math.inf
    _last_seq: int = -1
    _stopped_seq: int = -1
    _tokens: float = BURST
    _refilled_s: float = 0.0
    _told_rate_s: float = -math.inf

    def need(self, role: Role) -> None:
        """Refuse (``role_needed``) what only ``role`` may do."""
        if not self.role.may(role):
            raise Refusal("role_needed", role=role.value, found=self.role.value)

    def limit_rate(self, now_s: float) -> None:
        """Refuse (``rate_limited``) what comes faster than ``MESSAGES_PER_S``, after ``BURST`` at once."""
        self._tokens = min(BURST, self._tokens + (now_s - self._refilled_s) * MESSAGES_PER_S)
        self._refilled_s = now_s
        if self._tokens < 1:
            raise Refusal("rate_limited", limit=MESSAGES_PER_S)
        self._tokens -= 1

    def admit(self, message: wire.Message, boot_id: str, now_s: float) -> None:
        """Refuse what comes too fast, for another run of the server (``old_boot``), or again (``replayed``)."""
        self.limit_rate(now_s)
        if message.boot != boot_id:
            raise Refusal("old_boot")
        if message.seq <= self._last_seq:
            raise Refusal("replayed", found=message.seq, last=self._last_seq)
        self._last_seq = message.seq

    def stopped(self, seq: int) -> None:
        """Note that this page has pressed STOP after it had sent message ``seq``, which may still be on its way."""
        self._stopped_seq = max(self._stopped_seq, seq)

    def check_after_stop(self, seq: int) -> None:
        """Refuse (``before_stop``) what was sent before a STOP that has come by another way and overtaken it."""
        if seq <= self._stopped_seq:
            raise Refusal("before_stop")

    def may_tell_rate(self, now_s: float) -> bool:
        """Whether this page is told, once a second, that it sends too fast."""
        if now_s - self._told_rate_s < _TELL_RATE_EVERY_S:
            return False
        self._told_rate_s = now_s
        return True
