"""Stops: each press once, however often and by whichever path it arrives."""

from __future__ import annotations

import math
from collections import deque

from icu_common.core.reasons.message import Message
from scope_ui_bridge.core.desk.state import DeskState
from scope_ui_bridge.core.effects import Effect, Now, StopNow
from scope_ui_bridge.core.records import record, shown

WATCHDOG = "Watchdog"
_SAME_STOP_S = 0.5


class Stops:
    """Stops the machine, and ends a held jog."""

    def __init__(self, state: DeskState) -> None:
        self._state = state
        self._last = (-math.inf, "", 0)
        self._presses: deque[str] = deque(maxlen=64)

    def stop(
        self, who: str, now: Now, code: str = "", press: str = "", silence_s: float = 0.0, limit_s: float = 0.0
    ) -> list[Effect]:
        """Stop; ``code`` is the cause if it was not a person, ``silence_s`` how long a signal was missing.

        ``limit_s`` is the limit of this silence, 0 if none was exceeded.

        One press of the button arrives by two paths; ``press`` (or half a second) identifies it. The stop has already
        been sent then: a second stop would end the driver's lifting of the stylus (docs/decisions/stopping.md).
        """
        state = self._state
        state.stops += 1
        state.jog = None
        if press and press in self._presses:
            return []
        state.stop_wanted_s = now.mono_s
        self._presses.append(press)
        last_s, last_who, last_entry = self._last
        if who == last_who and now.mono_s - last_s < _SAME_STOP_S and last_entry == state.log.count:
            return []
        state.causes.stopped(code, who, silence_s, now.mono_s)
        goal_id = f"service-stop-{state.log.count + 1}"
        entry = state.log.add(who, "stop", code, now, status="sent", goal_id=goal_id)
        self._last = (now.mono_s, who, entry.entry)
        cause = _logged(who, code, silence_s, limit_s)
        return [StopNow(entry=entry.entry, cause=cause, record=record(who, "stop", code, now)), shown(entry)]

    def unseen(self, code: str, silence_s: float, limit_s: float, now: Now) -> list[Effect]:
        """Stop a motion without images, once: not again before something else was started."""
        if self._last[1:] == (WATCHDOG, self._state.log.count):
            return []
        return self.stop(WATCHDOG, now, code, silence_s=silence_s, limit_s=limit_s)


def _logged(who: str, code: str, silence_s: float, limit_s: float) -> Message:
    """Return the cause for the log, with its code and values."""
    if not code:
        return Message("bridge.stop_by_person", who=who)
    if limit_s > 0.0:
        return Message("bridge.stop_silent", cause=code, silence_s=silence_s, limit_s=limit_s)
    return Message("bridge.stop_cause", cause=code)
