"""States, requests, error and alarm numbers of the firmware, and the types of its blocking calls."""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import dataclass
from enum import Enum, auto

ERROR_BAD_STATEMENT, ERROR_HOMING_OFF, ERROR_NOT_IDLE, ERROR_LOCKED = 3, 5, 8, 9
ERROR_OVERFLOW, ERROR_DOOR, ERROR_TRAVEL, ERROR_NUMBER = 11, 13, 15, 2
ALARM_HARD, ALARM_SOFT, ALARM_ABORT, ALARM_PROBE_START, ALARM_PROBE_END = 1, 2, 3, 4, 5
ALARM_HOME_RESET, ALARM_HOME_DOOR, ALARM_HOME_PULL_OFF, ALARM_HOME_SEARCH = 6, 7, 8, 9

Firmware = Generator[float | None, None, None]
Answering = Generator[float | None, None, int]


class State(Enum):
    """The states of the report."""

    IDLE = "Idle"
    RUN = "Run"
    HOLD = "Hold"
    JOG = "Jog"
    ALARM = "Alarm"
    DOOR = "Door"
    CHECK = "Check"
    HOME = "Home"
    SLEEP = "Sleep"


BUSY = frozenset({State.HOME, State.RUN, State.HOLD, State.JOG, State.DOOR})


class Flag(Enum):
    """Real-time requests that wait for the main loop."""

    __hash__ = object.__hash__  # members are singletons; Enum's own hash is several times slower

    RESET = auto()
    STATUS = auto()
    START = auto()
    STOPPED = auto()
    HOLD = auto()
    CANCEL = auto()
    DOOR = auto()
    SLEEP = auto()


class Suspend(Enum):
    """Why the main loop is suspended, and how far the door's sequence has come."""

    __hash__ = object.__hash__  # members are singletons; Enum's own hash is several times slower

    HELD = auto()
    JOG_CANCEL = auto()
    CANCEL = auto()
    AJAR = auto()
    RETRACTED = auto()
    RESTORE = auto()
    RESTORED = auto()


class Abort(Exception):
    """A reset was requested; the main loop restarts."""


@dataclass(slots=True)
class Overrides:
    """Percentages of the programmed feed, rapid and spindle speeds."""

    feed: int = 100
    rapid: int = 100
    spindle: int = 100
