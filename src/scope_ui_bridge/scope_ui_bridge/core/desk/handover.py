"""Changes of control: taken, requested, handed over, released or lost; each has a line in the audit file."""

from __future__ import annotations

from scope_ui_bridge.core import wire
from scope_ui_bridge.core.access import Role
from scope_ui_bridge.core.desk.chosen import Chosen
from scope_ui_bridge.core.desk.state import DeskState
from scope_ui_bridge.core.desk.stops import WATCHDOG, Stops
from scope_ui_bridge.core.effects import Effect, Now, Record
from scope_ui_bridge.core.records import record
from scope_ui_bridge.core.wire import Refusal


class Handover:
    """Gives control to a page and takes it away; whoever loses control during a motion stops it."""

    def __init__(self, state: DeskState, stops: Stops, chosen: Chosen) -> None:
        self._state = state
        self._stops = stops
        self._chosen = chosen

    def step(self, viewer: str, message: wire.Lease, now: Now) -> list[Effect]:
        """Carry out a page's request about control."""
        state, lease, step = self._state, self._state.lease, message.step
        if step in ("take", "request"):
            if state.config.replay:
                raise Refusal("replay")
            state.pages[viewer].need(Role.OPERATOR)
        epoch = lease.epoch
        if step == "take":
            lease.take(viewer, now.mono_s)
        elif step == "request":
            lease.request(viewer, now.mono_s)
        elif step == "release":
            return self.lose(viewer, "stopped_released", now)
        elif step == "decline":
            lease.decline(viewer, message.to)
        else:
            if state.moving:
                raise Refusal("busy_moving")
            lease.grant(viewer, message.to, now.mono_s)
        if lease.epoch == epoch:
            return []
        state.pages.got_control(state.pages.name_of(lease.holder))
        given = step == "grant"
        command, target = "hand over control" if given else "take control", lease.holder if given else ""
        passed = self._passed(viewer, command, lease.holder, now, state.pages.name_of(target))
        return [passed, *self._chosen.clear()]

    def lose(self, viewer: str, code: str, now: Now, silence_s: float = 0.0, limit_s: float = 0.0) -> list[Effect]:
        """Take control from a page, if it has it, and stop what it moves; ``code`` is the cause."""
        moving = self._state.moving
        if not self._state.lease.release(viewer):
            return []
        effects: list[Effect] = []
        if moving:
            effects = self._stops.stop(WATCHDOG, now, code, silence_s=silence_s, limit_s=limit_s)
        own = code == "stopped_released"
        reason = {} if own else {"reason": code.removeprefix("stopped_").replace("_", " ")}
        passed = self._passed(viewer, "release control" if own else "lose control", viewer, now, **reason)
        return [*effects, passed, *self._chosen.clear()]

    def _passed(self, viewer: str, command: str, page: str, now: Now, target: str = "", **more: str) -> Record:
        """Return the line of the audit file; ``page`` is the page that got or had control."""
        who = self._state.pages.name_of(viewer)
        passed = {"result": "done", "page": page, "epoch": self._state.lease.epoch}
        return Record(record=record(who, command, target, now) | passed | more)
