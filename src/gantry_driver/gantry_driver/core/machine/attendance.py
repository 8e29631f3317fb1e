"""Signs of the controller that it still carries out a goal.

The operator's heartbeat comes from another program, and a guard sees only its own node. A controller that ends or hangs
while the stylus is down would leave it there until ``max_rest_extended_s`` has passed.
"""

from __future__ import annotations

from icu_common.core.reasons.message import Message

SIGN_S = 0.1
"""Interval of the signs, s."""


class Attendance:
    """Measures the time since the last sign of a controller that has not released the machine."""

    def __init__(self) -> None:
        self._seen_s: float | None = None

    def take(self, attends: bool, now_s: float) -> None:
        """Note a sign: the controller attends to a goal, or releases the machine."""
        self._seen_s = now_s if attends else None

    def silent_s(self, now_s: float) -> float:
        """Return the seconds since the last sign; 0 without a controller that attends."""
        return 0.0 if self._seen_s is None else max(0.0, now_s - self._seen_s)

    def forget(self) -> None:
        """Expect no sign until the next one: the machine is at rest, or stops."""
        self._seen_s = None


def silent_text(silent_s: float) -> str:
    """Return the reason of the stop."""
    return Message("operator.gantry_controller_sent_no_sign", silent_s=silent_s)
