"""The states of the driver's machine, the transitions between them, and the events for its node."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

from icu_common.core.goals.results import GoalResult


class MachinePhase(Enum):
    """Phase of the driver; the value is the published state, but see :attr:`Machine.state`."""

    __hash__ = object.__hash__  # members are singletons; Enum's own hash is several times slower

    CLOSED = ("disconnected", 0)
    SYNCHRONISE = ("connecting", 1)
    IDENTIFY = ("connecting", 2)
    SETTINGS = ("connecting", 3)
    WRITING = ("connecting", 4)
    MISMATCH = ("mismatch", 0)
    UNHOMED = ("unhomed", 0)
    HOMING = ("homing", 0)
    IDLE = ("idle", 0)
    MOVING = ("moving", 0)
    HOLDING = ("stopped", 1)
    RESETTING = ("stopped", 2)
    LIFTING = ("stopped", 3)
    STOPPED = ("stopped", 4)
    ALARM = ("alarm", 0)
    ALARM_RESET = ("alarm", 1)

    @property
    def state(self) -> str:
        return self.value[0]


_P = MachinePhase
OPEN_ENDS = frozenset({_P.CLOSED, _P.SYNCHRONISE, _P.IDENTIFY, _P.ALARM})
"""Phases that every phase may enter: the port disappears, the board resets itself, an alarm."""
TRANSITIONS: dict[MachinePhase, frozenset[MachinePhase]] = {
    _P.CLOSED: frozenset({_P.SYNCHRONISE}),
    _P.SYNCHRONISE: frozenset(),
    _P.IDENTIFY: frozenset({_P.SETTINGS, _P.MISMATCH}),
    _P.SETTINGS: frozenset({_P.MISMATCH, _P.UNHOMED, _P.STOPPED, _P.LIFTING}),
    _P.WRITING: frozenset({_P.SETTINGS}),
    _P.MISMATCH: frozenset({_P.UNHOMED, _P.HOMING, _P.HOLDING, _P.WRITING}),
    _P.UNHOMED: frozenset({_P.HOMING, _P.HOLDING, _P.WRITING}),
    _P.HOMING: frozenset({_P.IDLE, _P.UNHOMED, _P.MISMATCH, _P.RESETTING}),
    _P.IDLE: frozenset({_P.MOVING, _P.HOMING, _P.HOLDING, _P.WRITING}),
    _P.MOVING: frozenset({_P.IDLE, _P.HOLDING}),
    _P.HOLDING: frozenset({_P.RESETTING}),
    _P.RESETTING: frozenset({_P.LIFTING, _P.STOPPED}),
    _P.LIFTING: frozenset({_P.STOPPED, _P.HOLDING}),
    _P.STOPPED: frozenset({_P.IDLE, _P.UNHOMED, _P.MISMATCH, _P.HOLDING}),
    _P.ALARM: frozenset({_P.ALARM_RESET}),
    _P.ALARM_RESET: frozenset(),
}
"""All other transitions; one that is neither here nor in the open ends is a bug and raises."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Event:
    """Base of the machine's events for the node."""


@dataclass(frozen=True, slots=True, kw_only=True)
class StateChanged(Event):
    """``state`` or ``state: reason``.

    ``logged`` is False if a board that resets itself repeatedly causes a state again, which needs no second log line.
    ``codes`` are the code of the reason and what belongs to it, by name.
    """

    text: str
    logged: bool = True
    codes: tuple[tuple[str, str], ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class Position(Event):
    """Readings in metres, at the time the report was received.

    ``probe`` is whether the stylus's switch is closed in the same report; None without such a switch.
    """

    reading_m: tuple[float, float, float]
    probe: bool | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Answered(Event):
    """A goal's answer."""

    result: GoalResult


@dataclass(frozen=True, slots=True, kw_only=True)
class Note(Event):
    """Something for the log; ``level`` is info, warn or error."""

    level: str
    text: str


@dataclass(frozen=True, slots=True, kw_only=True)
class CloseRequested(Event):
    """The port must be closed after the last output has been written, and reopened."""

    reason: str
