"""Ids, stamps and records of orders, and whether an order may still be sent."""

from __future__ import annotations

from typing import Any

from scope_ui_bridge.core.desk.state import DeskState
from scope_ui_bridge.core.effects import MachineOrder, Now, SendGoal
from scope_ui_bridge.core.records import LogEntry, record
from scope_ui_bridge.core.wire import Refusal

_CLOCK_JUMP_NS = 100_000_000


class OrderBook:
    """Enters each order in the command log before it is sent."""

    def __init__(self, state: DeskState) -> None:
        self._state = state
        self._last_goal_ns = 0

    def next_id(self, kind: str) -> str:
        """Return an id for the next entry that no other run of the server uses."""
        return f"{kind}-{self._state.boot_id[:6]}-{self._state.log.count + 1}"

    def enter(self, viewer: str, action: str, target: str, goal_id: str, now: Now) -> LogEntry:
        """Add an order of a page to the command log."""
        who = self._state.pages.name_of(viewer)
        return self._state.log.add(who, action, target, now, status="sent", goal_id=goal_id)

    def enter_goal(self, viewer: str, action: str, target: str, now: Now) -> LogEntry:
        """Add a goal to the command log; its id is its stamp."""
        return self.enter(viewer, action, target, str(self.new_stamp_ns(now)), now)

    def new_stamp_ns(self, now: Now) -> int:
        """Return a stamp later than the last one, unless the clock was set back: future stamps are refused."""
        later_ns = self._last_goal_ns + 1
        self._last_goal_ns = later_ns if 0 < later_ns - now.ros_ns < _CLOCK_JUMP_NS else now.ros_ns
        return self._last_goal_ns

    def goal(
        self, entry: LogEntry, frame: str, point: tuple[float, float], text: str, seen: dict[str, str], now: Now
    ) -> SendGoal:
        """Return the order for a goal that is in the command log; ``seen`` is the image it was based on."""
        return SendGoal(**self.marks(entry, text, seen, now), frame=frame, point=point, stamp_ns=int(entry.goal_id))

    def marks(self, entry: LogEntry, text: str, seen: dict[str, str], now: Now) -> dict[str, Any]:
        """Return the fields of every order: what makes it void, and its line of the audit file."""
        written = record(entry.who, text, entry.target, now) | seen | {"goal_id": entry.goal_id}
        return {"entry": entry.entry, "stops": self._state.stops, "epoch": self._state.lease.epoch, "record": written}

    def check_ready(self) -> None:
        """Refuse unless the robot accepts a gesture: ``sequence_runs``, ``not_ready``, ``busy_pending``."""
        self._state.sequence.check_idle()
        self._state.machine.check_ready()
        if self._state.log.waiting:
            raise Refusal("busy_pending")

    def still_wanted(self, order: MachineOrder, now: Now) -> bool:
        """Return whether an order may still be sent: no stop and no change of control since, and not given up.

        A jog step must also still be held, or recently requested. A bridge that was suspended sends nothing until its
        next tick has checked whether the page is still there.
        """
        state, jog = self._state, self._state.jog
        if now.mono_s - state.ticked_s > state.config.silence_stop_s:
            return False
        held = jog is not None and jog.entry == order.entry and now.mono_s <= jog.until_s
        if now.mono_s > order.until_s and not held:
            return False
        same_hands = order.epoch == state.lease.epoch and bool(state.lease.holder)
        return order.stops == state.stops and same_hands and state.log.open_entry(order.entry) is not None
