"""Extended limits for inputs that are only late; pure, no clock.

They end when the stylus begins to go down: from then on every limit applies as configured.
"""

from __future__ import annotations

import math

from gantry_driver.core.job.controller_config import ControllerConfig
from gantry_driver.core.job.goal_job import NANO
from icu_common.core.processes.delays import Delay, ResultCode
from icu_common.core.reasons.message import Message

CLICK_MAX_AGE_S = 2.0
"""Maximum age of a person's order, whatever delayed it: an older one must never move anything."""
HELD_UP_S = 0.2
"""Interval between two events, in seconds, above which the controller counts as blocked; it ticks every 0.05 s."""
BACKLOG_S = 0.25
"""Duration after a blockage for which messages of that time may still wait in the queue."""
_GROWTH = 2.0


def patient_limit_s(base_s: float, config: ControllerConfig) -> float:
    """Return the largest limit to which ``base_s`` grows while nothing has been touched."""
    grown_s = base_s * _GROWTH ** (config.slow_tries - 1)
    return max(base_s, min(grown_s, config.slow_limit_max_s))


def next_limit_s(limit_s: float, base_s: float, config: ControllerConfig) -> float | None:
    """Return the limit of the next try, None after the last one."""
    most_s = patient_limit_s(base_s, config)
    return min(_GROWTH * limit_s, most_s) if limit_s < most_s else None


class HoldUp:
    """Measures the time for which the controller itself could not handle events, and messages waited.

    Until the queue is empty, a message sent in this time looks old, and a stream looks silent.
    """

    def __init__(self) -> None:
        self._last_ns: int | None = None
        self._gap_ns = self._noticed_ns = 0

    def note(self, now_ns: int) -> float:
        """Take the time of an event; return the duration in seconds of a blockage that has just ended, 0 for none."""
        gap_ns = 0 if self._last_ns is None else now_ns - self._last_ns
        self._last_ns = now_ns
        if gap_ns <= HELD_UP_S * NANO:
            return 0.0
        # Soon after a longer blockage, messages of that time may still wait in the queue.
        before_ns = self._gap_ns if self._is_recent(now_ns - gap_ns) else 0
        self._gap_ns, self._noticed_ns = max(gap_ns, before_ns), now_ns
        return gap_ns / NANO

    def recent_s(self, now_ns: int) -> float:
        """Return the seconds by which messages may be older than they should be, 0 once the queue is empty."""
        return self._gap_ns / NANO if self._is_recent(now_ns) else 0.0

    def _is_recent(self, now_ns: int) -> bool:
        return self._gap_ns > 0 and 0 <= now_ns - self._noticed_ns <= BACKLOG_S * NANO


def goal_limit_s(held_up_s: float, config: ControllerConfig) -> float:
    """Return the maximum age of a stamped goal; a blockage of the controller itself does not count."""
    return max(config.goal_max_age_s, min(config.goal_max_age_s + held_up_s, CLICK_MAX_AGE_S))


def joints_delay(age_s: float, config: ControllerConfig) -> Delay | None:
    """Return the delay of a machine's position with this age in seconds, None within its limit."""
    return delay_beyond(ResultCode.SLOW, "joint_states", age_s, config.joints_timeout_s)


def camera_delay(age_s: float, config: ControllerConfig) -> Delay | None:
    """Return the delay of the left camera's images with this age in seconds, None within its limit."""
    return delay_beyond(ResultCode.LATE_IMAGE, Message("wait.image_left_camera"), age_s, config.camera_timeout_s)


def delay_beyond(code: ResultCode, what: str, age_s: float, limit_s: float) -> Delay | None:
    """Return a delay, None for an age within the limit and for an input that has never arrived."""
    late = limit_s < age_s < math.inf
    return Delay(code=code, what=what, measured_s=age_s, limit_s=limit_s) if late else None


def since(age_s: float) -> str:
    """Return an age as the end of "no image ...": ``for 1.2 s``, or ``yet`` if nothing has arrived."""
    return Message("wait.for_s", age_s=age_s) if math.isfinite(age_s) else "yet"
