"""Why the machine was stopped, as far as it was stopped from here: the driver only knows that somebody asked.

Causes are keys of the page's sentences, so that each page says them in its own language.
"""

from __future__ import annotations

import math
from typing import Any

PERSON = "stopped_by_person"
ELSEWHERE = "stopped_elsewhere"
BY_CONTROLLER = "stopped_by_controller"
HELD_UP_S = 0.4
"""A bridge that did nothing for so long blames itself, not the page or the camera that it could not hear."""
PING_S = 0.2
"""A page that is silent for so long is asked by a ping whether its browser still answers."""
_REQUESTED = "stop requested"
_REACHES_DRIVER_S = 2.0
_RECENT_S = 1.0


class StopCauses:
    """Remembers the first cause of the stop that is in force, and what helps to tell causes apart."""

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

    # --- what happens ----------------------------------------------------------------------------------------------

    def stopped(self, code: str, who: str, silence_s: float, now_s: float) -> None:
        """Note a stop from here; ``silence_s`` is for how long something was missing. The first cause explains."""
        if self._stopped or (self._cause is not None and now_s - self._noted_s < _REACHES_DRIVER_S):
            return
        self._cause = {"code": code or PERSON, "who": who, "silence_s": round(silence_s, 1)}
        self._noted_s = now_s

    def aborted(self, reason: str, now_s: float) -> None:
        """Note why the controller ended a goal: it may be what it asked the driver to stop for."""
        if _REQUESTED not in reason:
            self._abort, self._abort_s = reason, now_s

    def alive(self) -> None:
        """Note that the operator's page has spoken."""
        self._pinged = self._answered = self._hidden = False

    def hidden(self) -> None:
        """Note that the operator's page has said that it is hidden."""
        self._hidden = True

    def answered(self) -> None:
        """Note that the browser of the operator's page has answered the ping."""
        self._answered = self._pinged

    def tick(self, driver: str, now_s: float) -> None:
        """Call with the driver's state in every tick of the desk, before anything is judged."""
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

    # --- what is made of it ----------------------------------------------------------------------------------------

    def wants_ping(self, silence_s: float) -> bool:
        """Tell, once in each silence of the operator's page, that its browser should be pinged."""
        wanted = PING_S <= silence_s < math.inf and not self._pinged
        self._pinged = self._pinged or wanted
        return wanted

    def of_silence(self, now_s: float) -> str:
        """Return why the page is silent: the bridge was held up, the browser answers though the page does not, or not.

        A hidden page has said so itself.
        """
        if now_s < self._held_up_until_s:
            return "stopped_bridge_held_up"
        if self._hidden:
            return "stopped_page_hidden"
        return "stopped_page_frozen" if self._answered else "stopped_link_lost"

    def of_blindness(self, now_s: float) -> str:
        """Return why no picture came."""
        return "stopped_bridge_held_up" if now_s < self._held_up_until_s else "stopped_no_picture"

    def message(self, driver: str, reason: str) -> dict[str, Any] | None:
        """Return what the page says about the driver's state; None where the driver's own reason says it."""
        if driver != "stopped" or reason not in (_REQUESTED, ""):
            return None
        if self._cause is not None:
            return self._cause
        if self._abort:
            return {"code": BY_CONTROLLER, "who": self._abort, "silence_s": 0.0}
        return {"code": ELSEWHERE, "who": "", "silence_s": 0.0}
