"""A board with its faults, for the pseudo-terminal and the control socket.

:data:`FAULTS` has the names and arguments of the faults; invalid arguments are rejected with a message.
"""

from __future__ import annotations

import random
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from gantry_driver.mock.firmware.board import FirmwareBoard
from gantry_driver.mock.firmware.options import BoardOptions
from gantry_driver.mock.mechanics import Mechanics, MechanicsOptions
from gantry_driver.mock.serial_line import AnswerFault, Damage, Inbound, Outbound
from gantry_driver.mock.settings import Eeprom

MAX_SECONDS, MAX_COUNT, MAX_MM = 3600.0, 100_000, 10_000.0


class FaultError(ValueError):
    """A fault is unknown or its arguments are invalid; the message names the value and the limit."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PortFault:
    """A fault that the port carries out: ``unplug`` or ``stop_reading``, with its duration in board seconds."""

    kind: str
    seconds: float


def _seconds(arguments: Mapping[str, Any], name: str = "seconds", default: float | None = None) -> float:
    value = arguments.get(name, default)
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise FaultError(f"{name} = {value!r}; expected a number of seconds")
    if not 0 <= value <= MAX_SECONDS:
        raise FaultError(f"{name} = {value!r} is not within 0 to {MAX_SECONDS:g} s")
    return float(value)


def _count(arguments: Mapping[str, Any], name: str = "count", *, default: int | None = 1, least: int = 1) -> int:
    value = arguments.get(name, default)
    if isinstance(value, bool) or not isinstance(value, int):
        raise FaultError(f"{name} = {value!r}; expected a whole number")
    if not least <= value <= MAX_COUNT:
        raise FaultError(f"{name} = {value!r} is not within {least} to {MAX_COUNT}")
    return value


def _axis(arguments: Mapping[str, Any]) -> int:
    name = arguments.get("axis")
    if not isinstance(name, str) or len(name) != 1 or name.upper() not in "XYZ":
        raise FaultError(f"axis = {name!r} is none of X, Y, Z")
    return "XYZ".index(name.upper())


def _mm(arguments: Mapping[str, Any], name: str) -> float:
    value = arguments.get(name)
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise FaultError(f"{name} = {value!r}; expected a number of mm")
    if not -MAX_MM <= value <= MAX_MM:
        raise FaultError(f"{name} = {value!r} is not within -{MAX_MM:g} to {MAX_MM:g} mm")
    return float(value)


def _switch(arguments: Mapping[str, Any], name: str = "on") -> bool:
    value = arguments.get(name, True)
    if not isinstance(value, bool):
        raise FaultError(f"{name} = {value!r}; expected true or false")
    return value


class MockMachine:
    """The board, its mechanics, and their possible faults."""

    def __init__(
        self,
        eeprom: Eeprom,
        *,
        board: BoardOptions | None = None,
        mechanics: MechanicsOptions | None = None,
        seed: int = 0,
    ) -> None:
        self.rng = random.Random(seed)
        self.mechanics = Mechanics.build(eeprom, mechanics or MechanicsOptions(), self.rng)
        self.board = FirmwareBoard(eeprom, self.mechanics, self.rng, board or BoardOptions())

    def truth(self) -> dict[str, Any]:
        """Return the true positions of the motors and the states of the tool pins."""
        m = self.mechanics
        return {
            "mpos": [round(v, 5) for v in m.mpos_mm()],
            "spindle": round(m.spindle_rpm, 3),
            "coolant": m.flood or m.mist,
            "state": self.board.state_text() if self.board.powered else "Off",
        }

    def inject(self, kind: str, arguments: Mapping[str, Any]) -> PortFault | None:
        """Inject a fault now.

        Returns the part of the fault that the port must carry out, None if there is none.

        Raises
        ------
        FaultError
            If there is no such fault or an argument is invalid.
        """
        action = FAULTS.get(kind)
        if action is None:
            raise FaultError(f"fault {kind!r} is none of {', '.join(sorted(FAULTS))}")
        result = action(self, arguments)
        self.board.journal.note(self.board.now, "fault", fault=kind, arguments=dict(arguments))
        return result

    def _unplug(self, arguments: Mapping[str, Any]) -> PortFault:
        return PortFault(kind="unplug", seconds=_seconds(arguments, default=1.0))

    def _stop_reading(self, arguments: Mapping[str, Any]) -> PortFault:
        return PortFault(kind="stop_reading", seconds=_seconds(arguments, default=1.0))

    def _brown_out(self, arguments: Mapping[str, Any]) -> None:
        self.board.power_on(self.board.now)

    def _soft_reset(self, arguments: Mapping[str, Any]) -> None:
        self.board.soft_reset()

    def _hang(self, arguments: Mapping[str, Any]) -> None:
        self.board.stall(_seconds(arguments, default=1.0))

    def _error(self, arguments: Mapping[str, Any]) -> None:
        number = _count(arguments, "number", default=None)
        self.board.error_after = [_count(arguments, "after", default=0, least=0), number]

    def _garbage(self, arguments: Mapping[str, Any]) -> None:
        data = bytes(self.rng.randrange(256) for _ in range(_count(arguments, default=16)))
        self.board.outbound.send(data, self.board.now)

    def _stray_ok(self, arguments: Mapping[str, Any]) -> None:
        for _ in range(_count(arguments)):
            self.board.outbound.send(b"ok\r\n", self.board.now)

    def _answers(self, arguments: Mapping[str, Any]) -> None:
        how = arguments.get("how")
        if how not in Outbound.kinds:
            raise FaultError(f"how = {how!r} is none of {', '.join(Outbound.kinds)}")
        fault = AnswerFault(kind=how, count=_count(arguments), seconds=_seconds(arguments, default=0.1))
        self.board.outbound.faults.append(fault)

    def _damage(self, arguments: Mapping[str, Any]) -> None:
        lines: dict[Any, Inbound | Outbound] = {"to_board": self.board.inbound, "from_board": self.board.outbound}
        direction, how = arguments.get("direction"), arguments.get("how")
        if direction not in lines:
            raise FaultError(f"direction = {direction!r} is none of {', '.join(lines)}")
        if how not in Damage.kinds:
            raise FaultError(f"how = {how!r} is none of {', '.join(Damage.kinds)}")
        lines[direction].damage = Damage(how, _count(arguments, "after", default=0, least=0), self.rng)

    def _alarm(self, arguments: Mapping[str, Any]) -> None:
        self.board.raise_alarm(_count(arguments, "number", default=None))

    def _eeprom_pause(self, arguments: Mapping[str, Any]) -> None:
        self.board.eeprom_pause = (_seconds(arguments), _seconds(arguments, "tail_s", 0.0))

    def _limit(self, arguments: Mapping[str, Any]) -> None:
        self.board.hold_switch(_axis(arguments), _switch(arguments))

    def _broken_switch(self, arguments: Mapping[str, Any]) -> None:
        axis, broken = _axis(arguments), _switch(arguments)
        (self.mechanics.broken_switches.add if broken else self.mechanics.broken_switches.discard)(axis)

    def _stop_button(self, arguments: Mapping[str, Any]) -> None:
        self.board.press_stop(_switch(arguments))

    def _door(self, arguments: Mapping[str, Any]) -> None:
        self.board.set_door(_switch(arguments))

    def _lost_steps(self, arguments: Mapping[str, Any]) -> None:
        axis, mm = _axis(arguments), _mm(arguments, "mm")
        self.mechanics.lose_steps(axis, mm)

    def _probe_surface(self, arguments: Mapping[str, Any]) -> None:
        self.mechanics.probe_z_mm = None if arguments.get("z_mm") is None else _mm(arguments, "z_mm")


FAULTS: dict[str, Callable[[MockMachine, Mapping[str, Any]], PortFault | None]] = {
    "unplug": MockMachine._unplug,
    "stop_reading": MockMachine._stop_reading,
    "brown_out": MockMachine._brown_out,
    "soft_reset": MockMachine._soft_reset,
    "hang": MockMachine._hang,
    "error": MockMachine._error,
    "garbage": MockMachine._garbage,
    "stray_ok": MockMachine._stray_ok,
    "answers": MockMachine._answers,
    "damage": MockMachine._damage,
    "alarm": MockMachine._alarm,
    "eeprom_pause": MockMachine._eeprom_pause,
    "limit": MockMachine._limit,
    "broken_switch": MockMachine._broken_switch,
    "stop_button": MockMachine._stop_button,
    "door": MockMachine._door,
    "lost_steps": MockMachine._lost_steps,
    "probe_surface": MockMachine._probe_surface,
}
"""Faults by name.

- unplug(seconds), stop_reading(seconds), brown_out(), soft_reset()
- hang(seconds): the main loop does not run
- error(number, after: lines to pass before it)
- garbage(count: bytes), stray_ok(count)
- answers(how: lost, delayed, split or merged; count, seconds)
- damage(direction: to_board or from_board; how: flip, lost, doubled, swapped, replaced or burst; after: bytes to pass)
- alarm(number)
- eeprom_pause(seconds, tail_s: seconds without reception after the answer)
- limit(axis, on), broken_switch(axis, on), stop_button(on), door(on), probe_surface(z_mm)
- lost_steps(axis, mm: shift of the motor relative to the board's count); homing corrects it
"""
