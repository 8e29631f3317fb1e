"""Moves with the stylus up: to a point, or on and on while an arrow is held."""

from __future__ import annotations

import math
from dataclasses import replace

from icu_common.core.geometry.frames import BASE
from icu_common.core.goals.results import GoalResult, Outcome
from icu_common.core.processes.delays import ResultCode
from scope_ui_bridge.core import wire
from scope_ui_bridge.core.control import HeldJog
from scope_ui_bridge.core.desk.order_book import OrderBook
from scope_ui_bridge.core.desk.state import DeskState
from scope_ui_bridge.core.effects import Effect, MachineOrder, Now
from scope_ui_bridge.core.records import LogEntry, shown
from scope_ui_bridge.core.wire import Refusal


class Motions:
    """Orders moves and the steps of a jog."""

    def __init__(self, state: DeskState, book: OrderBook) -> None:
        self._state = state
        self._book = book
        self._refused: tuple[HeldJog, str] | None = None

    def move(self, viewer: str, message: wire.MoveTo, now: Now) -> list[Effect]:
        """Order a move to a point."""
        self._check(message.camera, message.stamp_ns, now)
        place = f"({message.x_m * 1e3:.1f}, {message.y_m * 1e3:.1f}) mm"
        entry = self._book.enter_goal(viewer, "move", place, now)
        seen = {"camera": message.camera, "frame": str(message.stamp_ns)}
        goal = self._book.goal(entry, BASE, (message.x_m, message.y_m), f"move {place}", seen, now)
        return [goal, shown(entry)]

    def jog(self, viewer: str, message: wire.Jog, now: Now) -> list[Effect]:
        """Begin, renew or end a jog."""
        state = self._state
        if message.dx == message.dy == 0:
            state.jog = self._refused = None
            return []
        state.machine.check_frame(message.camera, message.stamp_ns, state.config, now)
        if self._refused is not None and self._refused[0].same(viewer, message):
            raise Refusal("jog_refused", what=self._refused[1])
        if state.jog is not None and state.jog.same(viewer, message):
            state.jog.until_s = now.mono_s + state.config.jog_hold_s
            return []
        self._check(message.camera, message.stamp_ns, now)
        if not 0 < message.step_m <= state.config.jog_step_max_m:
            limit_mm = round(state.config.jog_step_max_m * 1e3, 1)
            raise Refusal("jog_step", step_mm=round(message.step_m * 1e3, 3), limit_mm=limit_mm)
        position = state.machine.position
        if position is None or not all(math.isfinite(value) for value in position):
            raise Refusal("position_unknown")
        direction = " ".join(
            f"{'+' if sign > 0 else '-'}{axis}" for axis, sign in zip("xy", (message.dx, message.dy)) if sign
        )
        entry = self._book.enter_goal(viewer, "jog", direction, now)
        self._refused = None
        state.jog = HeldJog(
            viewer=viewer,
            entry=entry.entry,
            dx=message.dx,
            dy=message.dy,
            step_m=message.step_m,
            xy=position[:2],
            until_s=now.mono_s + state.config.jog_hold_s,
        )
        return [self._step(state.jog, entry, now), shown(entry)]

    def ended(self, entry: LogEntry, result: GoalResult, now: Now) -> list[Effect] | None:
        """Return the next step of a jog whose step has ended; None if no step follows."""
        state, jog = self._state, self._state.jog
        if jog is None or jog.entry != entry.entry or not result.outcome.final:
            return None
        # A step that reached the controller too late is sent again: the button is still held.
        late = result.outcome is Outcome.REJECTED and result.code == ResultCode.STALE
        goes_on = late or result.outcome is Outcome.REACHED
        if goes_on and now.mono_s < jog.until_s and state.lease.holder == jog.viewer:
            goal_id = str(self._book.new_stamp_ns(now))
            entry = state.log.update(entry, goal_id=goal_id, sent_s=now.graph_s, status="sent")
            return [self._step(jog, entry, now, again=late)]
        state.jog = None
        if result.outcome is not Outcome.REACHED:  # as at a limit: the same held direction is not tried again
            self._refused = (jog, result.reason)
        return None

    def not_sent(self, order: MachineOrder) -> None:
        """End the jog whose step could not be sent."""
        if self._state.jog is not None and self._state.jog.entry == order.entry:
            self._state.jog = None

    def _check(self, camera: str, stamp_ns: int, now: Now) -> None:
        state = self._state
        state.machine.check_frame(camera, stamp_ns, state.config, now)
        state.sequence.check_idle()
        if state.log.waiting:
            raise Refusal("busy_pending")
        state.machine.check_at_rest()

    def _step(self, jog: HeldJog, entry: LogEntry, now: Now, *, again: bool = False) -> MachineOrder:
        x, y = jog.xy if again else jog.advance()
        goal = self._book.goal(entry, BASE, (x, y), f"jog ({x * 1e3:.1f}, {y * 1e3:.1f}) mm", {}, now)
        return replace(goal, until_s=jog.until_s)
