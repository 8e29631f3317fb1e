"""The mock board: GRBL 1.1h. This is its top layer, the ``$`` commands."""

from __future__ import annotations

from gantry_driver.mock.firmware import reports
from gantry_driver.mock.firmware.execution import Execution
from gantry_driver.mock.firmware.floats import one_byte, read_number
from gantry_driver.mock.firmware.motion import MotionPlanner
from gantry_driver.mock.firmware.states import (
    ERROR_BAD_STATEMENT,
    ERROR_DOOR,
    ERROR_NOT_IDLE,
    ERROR_NUMBER,
    Answering,
    Firmware,
    Flag,
    State,
)

MAX_SETTING = 255
REPORT_INCHES = 13
"""Number of the setting for inches; even setting it to its old value adds the work offset to the next report."""


class FirmwareBoard(Execution):
    """One controller board with its motors; :class:`.interrupts.Interrupts` has the public methods."""

    # ---- $ commands

    def _system_command(self, line: str) -> Answering:
        rest = line[1:]
        if rest == "":
            self._say(reports.HELP)
        elif rest[0] == "J":
            return (yield from self._jog(rest))
        elif rest[0] in "$GCX":
            if len(rest) > 1:
                return ERROR_BAD_STATEMENT
            return self._simple_command(rest)
        elif self.options.dialect == "FluidNC" and rest in reports.MACROS:
            self._say(reports.MACROS[rest])
        elif self.state not in (State.IDLE, State.ALARM):
            return ERROR_NOT_IDLE
        elif rest[0] == "#":
            if rest != "#":
                return ERROR_BAD_STATEMENT
            probe = self._mm(self._probed_at)
            yield from self._print(
                reports.parameters(self.eeprom, self.parser, probe, self._probe_ok, self.eeprom.flag(13))
            )
        elif rest[0] == "H":
            return (yield from self._homing_command(rest))
        elif rest[0] == "S":
            if rest != "SLP":
                return ERROR_BAD_STATEMENT
            self._raise(Flag.SLEEP)
        elif rest[0] == "I":
            if rest == "I":
                o = self.options
                info = reports.build_info(self.eeprom, o.mist, MotionPlanner.capacity, o.rx_bytes, o.dialect)
                yield from self._print(info)
            elif rest[1] != "=":
                return ERROR_BAD_STATEMENT
            else:
                yield from self._write_eeprom(lambda: setattr(self.eeprom, "build_info", rest[2:]))
        elif rest[0] == "R":
            return (yield from self._restore(rest))
        else:
            return (yield from self._store(rest))
        return 0

    def _simple_command(self, rest: str) -> int:
        if rest == "$":
            if self.state in (State.RUN, State.HOLD):
                return ERROR_NOT_IDLE
            for text in reports.settings(self.eeprom, self.options.dialect):
                self._say(text)
        elif rest == "G":
            self._say(reports.modes(self.parser, self.eeprom.flag(13)))
        elif rest == "C":
            if self.state is State.CHECK:
                self.soft_reset()
                self._say(reports.CHECK_OFF)
            elif self.state is not State.IDLE:
                return ERROR_NOT_IDLE
            else:
                self.state = State.CHECK
                self._say(reports.CHECK_ON)
        elif self.state is State.ALARM:
            if self.mechanics.door_open:
                return ERROR_DOOR
            self._say(reports.UNLOCKED)
            self.state = State.IDLE
        return 0

    def _print(self, lines: list[str]) -> Firmware:
        """Send lines; the firmware waits while its transmit buffer is full."""
        for text in lines:
            self._say(text)
            wait = self.outbound.room_at()
            if wait > self.now:
                yield wait

    def _restore(self, rest: str) -> Answering:
        if rest not in ("RST=$", "RST=#", "RST=*"):
            return ERROR_BAD_STATEMENT

        def restore() -> None:
            if rest[-1] in "$*":
                self.eeprom.values = dict(self.eeprom.defaults)
            if rest[-1] in "#*":
                self.eeprom.clear_places()
            if rest[-1] == "*":
                self.eeprom.startup = ["", ""]
                self.eeprom.build_info = ""

        yield from self._write_eeprom(restore)
        self._say(reports.RESTORING)
        self.motion.limits = self._limits()
        self.soft_reset()
        return 0

    def _store(self, rest: str) -> Answering:
        if rest == "N":
            yield from self._print([f"$N{i}={text}" for i, text in enumerate(self.eeprom.startup)])
            return 0
        startup = rest[0] == "N"
        if startup and self.state is not State.IDLE:
            return ERROR_NOT_IDLE
        name = read_number(rest, int(startup))
        if name is None:
            return ERROR_NUMBER
        number, end = name
        if rest[end : end + 1] != "=":
            return ERROR_BAD_STATEMENT
        value = rest[end + 1 :]
        if startup:
            answer = yield from self._gcode(value)
            if answer:
                return answer
            yield from self._write_eeprom(lambda: self.eeprom.store_startup(one_byte(number), value))
            return 0
        parsed = read_number(value)
        if parsed is None:
            return ERROR_NUMBER
        wanted, end = parsed
        if end < len(value) or number > MAX_SETTING:
            return ERROR_BAD_STATEMENT
        result = 0

        def store() -> None:
            nonlocal result
            result = self.eeprom.store(one_byte(number), wanted)
            if not result and one_byte(number) == REPORT_INCHES:
                self._wco_wait = 0

        yield from self._write_eeprom(store)
        self.motion.limits = self._limits()
        return result

    def _jog(self, rest: str) -> Answering:
        if self.state not in (State.IDLE, State.JOG):
            return ERROR_NOT_IDLE
        if rest[1:2] != "=":
            return ERROR_BAD_STATEMENT
        return (yield from self._jog_words(rest[2:]))
