"""Supervision of the operator's page: heartbeat to the driver while the page answers, a stop when it does not."""

from __future__ import annotations

import math

from scope_ui_bridge.core.desk.handover import Handover
from scope_ui_bridge.core.desk.state import DeskState
from scope_ui_bridge.core.desk.stops import Stops
from scope_ui_bridge.core.effects import Effect, Now, Ping, PublishHeartbeat

HEARTBEAT_PERIOD_S = 0.1
"""Seconds between heartbeats.

When the next beat arrives late, the driver's newest beat is at most that delay plus 0.1 s old. So 0.5 s of the driver's
timeout (0.6 s) remain for the delay of a bridge on a busy computer.
"""


class Supervision:
    """Watches for silence of the page in control, and for missing images during a motion."""

    def __init__(self, state: DeskState, stops: Stops, handover: Handover) -> None:
        self._state = state
        self._stops = stops
        self._handover = handover
        self._last_heartbeat_s = -math.inf

    def tick(self, now: Now) -> list[Effect]:
        """Return heartbeat, ping, and the stop for a page that is silent or shows no image."""
        state = self._state
        effects: list[Effect] = []
        state.causes.tick(state.machine.state("driver")[0], now.mono_s)
        silence_s = state.lease.silence_s(now.mono_s)
        due = now.mono_s - self._last_heartbeat_s >= HEARTBEAT_PERIOD_S - 0.01
        if silence_s <= state.config.keepalive_fresh_s and due:
            self._last_heartbeat_s = now.mono_s
            effects.append(PublishHeartbeat())
        if state.causes.wants_ping(silence_s):
            effects.append(Ping(viewer=state.lease.holder))
        return [*effects, *self._watch(silence_s, now)]

    def _watch(self, silence_s: float, now: Now) -> list[Effect]:
        state, config = self._state, self._state.config
        blind_s = state.machine.blind_s(now)
        if not state.lease.holder:
            return []
        if (silence_s >= config.silence_stop_s and state.moving) or silence_s >= config.lease_timeout_s:
            code = state.causes.of_silence(now.mono_s)
            return self._handover.lose(state.lease.holder, code, now, silence_s, config.silence_stop_s)
        if blind_s >= config.picture_stop_s:
            return self._stops.unseen(state.causes.of_blindness(now.mono_s), blind_s, config.picture_stop_s, now)
        return []
