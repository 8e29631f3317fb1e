"""Causes of stops that the bridge requested: the driver's state only has that a stop was requested.

Causes are keys of the page's sentences, so that each page shows them in its language.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from icu_common.core.reasons.codes import CODE, REASON, DriverCode

PERSON = "stopped_by_person"
ELSEWHERE = "stopped_elsewhere"
BY_CONTROLLER = "stopped_by_controller"
HEARTBEAT = "stopped_heartbeat"
HELD_UP_S = 0.4
"""Seconds without a tick after which the bridge itself is the cause, not a page or camera that seemed silent."""
PING_S = 0.2
"""Silence in seconds after which the bridge pings the page's browser."""
_REACHES_DRIVER_S = 2.0
_RECENT_S = 1.0


class StopCauses:
    """First cause of the current stop, and the events that distinguish causes."""

    def __init__(self) -> None:
        self._cause: dict[str, Any] | None = None
        self._noted_s = -math.inf
        self._stopped = False
        self._abort = ""
        self._abort_s = -math.inf
        self._last_tick_s = math.inf
        self._held_up_until_s = -math.inf
        self._pinged = False
        self._answered = False
        self._hidden = False

    # --- events ------------------------------------------------------------------------------------------------------

    def stopped(self, code: str, who: str, silence_s: float, now_s: float) -> None:
        """Record a stop requested here; ``silence_s`` is how long a signal was missing. The first cause counts."""
        if self._stopped or (self._cause is not None and now_s - self._noted_s < _REACHES_DRIVER_S):
            return
        self._cause = {"code": code or PERSON, "who": who, "silence_s": round(silence_s, 1)}
        self._noted_s = now_s

    def aborted(self, reason: str, now_s: float) -> None:
        """Record why the controller has requested a stop."""
        self._abort, self._abort_s = reason, now_s

    def alive(self) -> None:
        """Record a keep-alive of the operator's page."""
        self._pinged = self._answered = self._hidden = False

    def hidden(self) -> None:
        """Record that the operator's page has reported that it is hidden."""
        self._hidden = True

    def answered(self) -> None:
        """Record that the browser of the operator's page has answered the ping."""
        self._answered = self._pinged

    def tick(self, driver: str, now_s: float) -> None:
        """Update with the driver's state; call first in every tick of the desk."""
        if now_s - self._last_tick_s > HELD_UP_S:
            self._held_up_until_s = now_s + _RECENT_S
        self._last_tick_s = now_s
        was, self._stopped = self._stopped, driver == "stopped"
        if self._stopped:
            return
        if was or now_s - self._noted_s > _REACHES_DRIVER_S:
            self._cause = None
        if was or now_s - self._abort_s > _REACHES_DRIVER_S:
            self._abort = ""

    # --- conclusions -------------------------------------------------------------------------------------------------

    def wants_ping(self, silence_s: float) -> bool:
        """Return whether to ping the browser of the operator's page: True once in each silence."""
        wanted = PING_S <= silence_s < math.inf and not self._pinged
        self._pinged = self._pinged or wanted
        return wanted

    def of_silence(self, now_s: float) -> str:
        """Return the cause of a page's silence: delayed bridge, hidden page, frozen page, or lost link.

        A page is frozen if its browser answers the ping. A hidden page has reported it.
        """
        if now_s < self._held_up_until_s:
            return "stopped_bridge_held_up"
        if self._hidden:
            return "stopped_page_hidden"
        return "stopped_page_frozen" if self._answered else "stopped_link_lost"

    def of_blindness(self, now_s: float) -> str:
        """Return the cause of missing images."""
        return "stopped_bridge_held_up" if now_s < self._held_up_until_s else "stopped_no_picture"

    def message(self, driver: str, reason: str, reported: Mapping[str, str]) -> dict[str, Any] | None:
        """Return the cause to show with the driver's state; None if the driver's own reason is enough.

        ``reported`` are the code and its values that the driver has reported with this state.
        """
        if driver != "stopped":
            return None
        code = reported.get(CODE, "")
        if code == DriverCode.HEARTBEAT_LOST:
            return {"code": HEARTBEAT, "who": "", "silence_s": 0.0}
        # A further clause, as on a stylus that was not lifted, must be seen.
        if reason and (code != DriverCode.STOP_REQUESTED or reason != reported.get(REASON)):
            return None
        if self._cause is not None:
            return self._cause
        if self._abort:
            return {"code": BY_CONTROLLER, "who": self._abort, "silence_s": 0.0}
        return {"code": ELSEWHERE, "who": "", "silence_s": 0.0}
