"""Sources of the operator's heartbeat; pure, no clock.

The page and the command-line programs may send heartbeats at the same time: a person presses from a terminal while the
page is open. Their heartbeats name the sender in ``frame_id``. A page on which no operator has control sends none and
does not count. Any other program is a stranger and must be the only sender.
"""

from __future__ import annotations

import math
from collections.abc import Collection

from icu_common.core.admission.sources import base_name, rivals_text

PROGRAMS = "ui_bridge gantry_goal gantry_sequence gantry_prepare gantry_accept"
"""Names of this project's nodes that send heartbeats: the default of the parameter ``heartbeat_programs``."""
HEARD_S = 1.0
"""Seconds after its last heartbeat for which a program counts as a sender."""


class HeartbeatSources:
    """Judges the sources of the heartbeat.

    Attributes
    ----------
    programs
        Names of nodes, without namespace, separated by spaces, that may send heartbeats at the same time.
    """

    def __init__(self, programs: str) -> None:
        self.programs = programs
        self._heard_s: dict[str, float] = {}
        self._now_s = -math.inf

    def heard(self, sender: str, now_s: float) -> bool:
        """Record a heartbeat; return whether its sender is one of the programs and has just started to send."""
        self._now_s = now_s
        if not self._is_own(sender):
            return False
        begins = now_s - self._heard_s.get(sender, -math.inf) > HEARD_S
        self._heard_s[sender] = now_s
        return begins

    def senders(self, names: Collection[str]) -> list[str]:
        """Return the topic's sources that are known to send heartbeats."""
        return [name for name in names if not self._is_own(name) or self._sends(name)]

    def judge(self, topic: str, names: Collection[str]) -> str:
        """Return the fault of the sources: a stranger among others; empty if there is none."""
        senders = self.senders(names)
        return "" if all(self._is_own(name) for name in senders) else rivals_text(topic, senders)

    def _is_own(self, name: str) -> bool:
        return base_name(name) in self.programs.split()

    def _sends(self, name: str) -> bool:
        return self._now_s - self._heard_s.get(name, -math.inf) <= HEARD_S
