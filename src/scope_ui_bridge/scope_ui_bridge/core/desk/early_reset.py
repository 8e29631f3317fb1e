"""A reset that is pressed while a stop still holds the board or lifts the stylus.

The driver rejects it until the stop is complete, up to two seconds after STOP. The person has seen the stop and has
decided, so the desk repeats the reset until the driver accepts it. A later stop, a change of control, another state of
the machine (an alarm, a stylus that was not lifted) or the end of the wait voids it.
"""

from __future__ import annotations

import math

from icu_common.core.reasons.message import Message, parts
from scope_ui_bridge.core.desk.order_book import OrderBook
from scope_ui_bridge.core.desk.state import DeskState
from scope_ui_bridge.core.effects import CallService, Effect, Now, RepeatOrder
from scope_ui_bridge.core.records import LogEntry, result_record, shown

RESET = "reset"
NOT_YET = "stop.stop_not_complete_yet"
"""Code of the driver's refusal while a stop is in progress."""
RETRY_S = 0.2
"""Seconds between the driver's refusal and the next attempt."""
RESET_WAIT_S = 10.0
"""Maximum seconds a reset waits: a hold that does not complete, a reset of the board and a lift take less."""


class EarlyReset:
    """The one reset that waits for the end of a stop."""

    def __init__(self, state: DeskState, book: OrderBook) -> None:
        self._state, self._book = state, book
        self._order: CallService | None = None
        self._seen = ""
        """State of the driver that the person has seen."""
        self._until_s = -math.inf
        self._again_s = math.inf

    def ordered(self, order: CallService, now: Now) -> None:
        """Note the newest reset; call it with each order of this service."""
        self._order, self._seen = order, self._state.machine.text("driver")
        self._until_s, self._again_s = now.graph_s + RESET_WAIT_S, math.inf

    def waits(self, now: Now) -> bool:
        """Return whether a refused reset waits, and is not void."""
        order = self._order
        entry = None if order is None else self._state.log.open_entry(order.entry)
        return order is not None and entry is not None and entry.status == "accepted" and self._wanted(order, now)

    def put_off(self, entry: LogEntry, refusal: str, now: Now) -> list[Effect] | None:
        """Keep a refused reset for another attempt; None if the refusal is final."""
        order = self._order
        early = any(part.code == NOT_YET for part in parts(refusal))
        if order is None or order.entry != entry.entry or not early or now.graph_s >= self._until_s:
            return None
        self._again_s = now.graph_s + RETRY_S
        first = entry.status == "sent"
        changed = self._state.log.update(
            entry, status="accepted", reason=Message("bridge.reset_waits"), sent_s=now.graph_s
        )
        return [shown(changed)] if first else []

    def tick(self, now: Now) -> list[Effect]:
        """Return the next attempt when it is due, or the end of a reset that has become void."""
        order = self._order
        if order is None or now.graph_s < self._again_s:
            return []
        self._again_s = math.inf
        if self._wanted(order, now):
            return [RepeatOrder(order=order)]
        entry = self._state.log.open_entry(order.entry)
        if entry is None:
            return []
        stopped = Message("bridge.stopped_before_went_out")
        void = Message("bridge.reset_void", state=self._state.machine.text("driver"))
        reason = void if self._book.still_wanted(order, now) else stopped
        changed = self._state.log.update(entry, status="failed", reason=reason)
        return [shown(changed), result_record(changed, now)]

    def _wanted(self, order: CallService, now: Now) -> bool:
        return self._book.still_wanted(order, now) and self._state.machine.text("driver") == self._seen
