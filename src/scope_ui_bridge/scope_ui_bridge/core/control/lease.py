"""Lease of control: one operator at a time may move the machine, until release, handover or silence of the page."""

from __future__ import annotations

import math

from scope_ui_bridge.core.wire import Refusal


class OperatorLease:
    """The right to move the machine.

    Each change of the holder increments ``epoch``; commands with an older epoch are refused. A silent holder keeps the
    lease until the desk removes it; no page gets it without a request.
    """

    def __init__(self) -> None:
        self.epoch = 0
        self.holder = ""
        self.requester = ""
        self._last_alive_s = -math.inf

    def take(self, viewer: str, now_s: float) -> None:
        """Give the free lease to ``viewer``.

        Raises
        ------
        Refusal
            ``lease_held`` if another viewer has it.
        """
        if self.holder and self.holder != viewer:
            raise Refusal("lease_held", holder=self.holder)
        self._give(viewer, now_s)

    def request(self, viewer: str, now_s: float) -> None:
        """Request the lease from the holder; a free lease is taken at once."""
        if not self.holder:
            self._give(viewer, now_s)
        elif self.holder != viewer:
            self.requester = viewer

    def grant(self, viewer: str, to: str, now_s: float) -> None:
        """Hand the lease of ``viewer`` over to ``to``, who requested it."""
        self._check_request(viewer, to)
        self._give(to, now_s)

    def decline(self, viewer: str, to: str) -> None:
        """Decline the request of ``to``."""
        self._check_request(viewer, to)
        self.requester = ""

    def release(self, viewer: str) -> bool:
        """Remove the lease (or the request) of ``viewer``; return whether it held the lease."""
        if self.requester == viewer:
            self.requester = ""
        if self.holder != viewer:
            return False
        self.holder = self.requester = ""
        self.epoch += 1
        return True

    def alive(self, viewer: str, now_s: float) -> None:
        """Record a keep-alive."""
        if viewer == self.holder:
            self._last_alive_s = now_s

    def silence_s(self, now_s: float) -> float:
        """Return the seconds since the holder's last keep-alive; infinite without a holder."""
        return now_s - self._last_alive_s if self.holder else math.inf

    def check(self, viewer: str, epoch: int | None = None) -> None:
        """Refuse unless ``viewer`` holds the lease (``no_lease``) and names its epoch (``stale_epoch``)."""
        if not self.holder or viewer != self.holder:
            raise Refusal("no_lease", holder=self.holder)
        if epoch is not None and epoch != self.epoch:
            raise Refusal("stale_epoch", found=epoch, epoch=self.epoch)

    def _check_request(self, viewer: str, to: str) -> None:
        self.check(viewer)
        if not self.requester:
            raise Refusal("no_request")
        if to != self.requester:  # another viewer has requested since that name was read
            raise Refusal("other_request")

    def _give(self, viewer: str, now_s: float) -> None:
        if viewer != self.holder:
            self.epoch += 1
        self.holder, self.requester, self._last_alive_s = viewer, "", now_s
