"""The mock board's processor: power, reset and the main loop, on top of the interrupts.

The firmware's main loop is a generator. It yields None to wait for any event (a byte, a real-time flag, the end of a
move), or a time until which it is busy. So it blocks where the firmware blocks: a full planner, a dwell, half a second
after each alarm, an EEPROM write. Interrupts act at their own times in between.
"""

from __future__ import annotations

from abc import abstractmethod
from collections import deque

from gantry_driver.mock.firmware import reports
from gantry_driver.mock.firmware.interrupts import Interrupts
from gantry_driver.mock.firmware.motion import Limits, MotionPlanner, Triple, Vector
from gantry_driver.mock.firmware.parser_state import ParserState
from gantry_driver.mock.firmware.states import (
    ERROR_LOCKED,
    ERROR_OVERFLOW,
    Abort,
    Answering,
    Firmware,
    Flag,
    Overrides,
    State,
)

LINE_CHARACTERS = 79  # the line buffer has 80, one of them for the end
NEXT_TO_NOTHING = 1e-6
"""Value in steps per mm or mm/s^2 that replaces 0, by which the firmware would divide."""
MAX_STEPS = 2**31 - 1


class Processor(Interrupts):
    """The interrupts and the main loop of the board; :class:`Interrupts` has the public methods."""

    # ---- implemented in the layers above

    @abstractmethod
    def _checkpoint(self) -> Firmware:
        """Serve real-time requests; while suspended, nothing else runs."""

    @abstractmethod
    def _system_command(self, line: str) -> Answering:
        """Carry out a ``$`` line and return its error number, 0 for none."""

    @abstractmethod
    def _gcode(self, line: str) -> Answering:
        """Carry out a line of G-code and return its error number, 0 for none."""

    def power_on(self, now: float) -> None:
        """Start as after power-up or a reset by DTR: counters at zero, position unknown."""
        self._run_until(now)
        self._lose_power()
        self.powered = True
        self._start_firmware()
        self.journal.note(now, "power_on")

    def power_off(self, now: float) -> None:
        """Cut the power; a moving carriage overshoots."""
        self._run_until(now)
        self._lose_power()
        self.journal.note(now, "power_off")

    # ---- power and reset

    def _clear(self) -> None:
        """Clear all volatile state."""
        self._firmware = None
        self._resume_at = None
        self._stall_until = 0.0
        self._woken = False
        self._booting = False
        self._reading = False
        self._deaf_from = self._deaf_until = 0.0
        self._fifo_window, self._fifo_used = -1, 0
        self._ring = deque()
        self._alarm = None
        self.motion = MotionPlanner(self._limits())
        self.motion.watch = self._watch
        self._probing = None
        self.parser = ParserState()
        if self.options.dialect == "grblHAL":
            self.parser.g92 = list(self.eeprom.g92)
        self._reset_variables()

    def _reset_variables(self) -> None:
        """Reset the variables that a soft reset also resets."""
        self._flags = set()
        self._alarm = None
        self._suspend = set()
        self._override_bytes = set()
        self.overrides = Overrides()
        self._wco_wait = self._ov_wait = 0
        self._soft_limit = False
        self._tools_held = (5, 0.0, False, False)
        self._spindle_stopped = False
        self._line = ""
        self._line_flags: set[str] = set()
        self._ring.clear()
        self._probing, self._probe_away = None, False
        self._probed_at = (0, 0, 0)
        self._probe_ok = False
        kept = self.parser
        self.parser = ParserState()
        if self.options.dialect == "grblHAL":
            self.parser.g92, self.parser.tool_length = kept.g92, kept.tool_length
        self.motion.halt(self.now)
        self.motion.override(self.now, feed=1.0, rapid=1.0)
        self._sync_parser()

    def _lose_power(self) -> None:
        self._catch_up()
        if self.powered:
            self._halt(slips=True)
        self._stop_tools()
        self.powered = False
        self._lose(self.inbound.clear() + len(self._ring), "unpowered")
        self.outbound.clear()
        self._clear()
        self.mechanics.renumber((0, 0, 0))

    def _start_firmware(self) -> None:
        locks = self.eeprom.flag(22) and self.options.dialect != "grblHAL"  # its lock is a separate bit, 4
        self.state = State.ALARM if locks else State.IDLE
        self._booting = True
        self._firmware = self._main()
        self._woken = True

    def _limits(self) -> Limits:
        e = self.eeprom
        rate_x, rate_y, rate_z = e.axis_values(110)
        return Limits(
            steps_per_mm=self._steps_per_mm(),
            max_rate=(rate_x / 60.0, rate_y / 60.0, rate_z / 60.0),
            acceleration=_above_zero(e.axis_values(120)),
            junction_deviation=e.values[11],
        )

    def _steps_per_mm(self) -> Vector:
        return _above_zero(self.eeprom.axis_values(100))

    def _mm(self, steps: Triple) -> list[float]:
        return [n / s for n, s in zip(steps, self._steps_per_mm())]

    def _steps(self, target_mm: list[float]) -> Triple:
        # The counters have 32 bits.
        x, y, z = (min(max(round(t * s), -MAX_STEPS), MAX_STEPS) for t, s in zip(target_mm, self._steps_per_mm()))
        return x, y, z

    def _sync_parser(self) -> None:
        self.parser.position = self._mm(self.motion.position(self.now))

    # ---- main loop

    def _main(self) -> Firmware:
        yield self.now + self.options.boot_s
        self._booting = False
        while True:
            try:
                yield from self._session()
            except Abort:
                self._lose(len(self._ring), "reset")
                self._stop_tools()
                self._reset_variables()
                self.journal.count("resets")

    def _session(self) -> Firmware:
        self._say(reports.BANNERS[self.options.dialect])
        self.journal.note(self.now, "banner")
        if self.eeprom.flag(21) and any(self.mechanics.pressed(i) for i in range(3)):
            self.state = State.ALARM
            self._say(reports.CHECK_LIMITS)
        if self.state in (State.ALARM, State.SLEEP):
            self.state = State.ALARM
            self._say(reports.UNLOCK_HINT)
        else:
            self.state = State.IDLE
            if self.mechanics.door_open:
                self._raise(Flag.DOOR)
                yield from self._checkpoint()
            yield from self._run_startup()
        while True:
            while self._ring:
                byte = self._ring.popleft()
                if byte in b"\r\n":
                    yield from self._checkpoint()
                    yield from self._end_of_line()
                else:
                    self._collect(byte)
            self._auto_start()
            yield from self._checkpoint()
            if not self._ring:
                self._reading = True
                yield None
                self._reading = False

    def _collect(self, byte: int) -> None:
        """Remove blanks and comments while a line arrives."""
        if self._line_flags:
            if byte == ord(")"):
                self._line_flags.discard("parenthesis")
        elif byte <= 0x20 or byte == ord("/"):
            pass
        elif byte == ord("("):
            self._line_flags.add("parenthesis")
        elif byte == ord(";"):
            self._line_flags.add("semicolon")
        elif len(self._line) >= LINE_CHARACTERS:
            self._line_flags.add("overflow")
        else:
            self._line += chr(byte).upper()

    def _end_of_line(self) -> Firmware:
        line, self._line = self._line, ""
        overflow, self._line_flags = "overflow" in self._line_flags, set()
        started = self.now
        try:
            if self.options.line_s:
                yield self.now + self.options.line_s
            if overflow:
                answer = ERROR_OVERFLOW
            elif not line:
                answer = 0
            elif self.error_after and self._injected_error():
                answer = self.error_after.pop()
                self.error_after.clear()
            elif line[0] == "$":
                answer = yield from self._system_command(line)
            elif self.state in (State.ALARM, State.JOG):
                answer = ERROR_LOCKED
            else:
                answer = yield from self._gcode(line)
        except Abort:
            self._answer(line, 0, started)  # the aborted command still returns, and its ok precedes the banner
            raise
        self._answer(line, answer, started)
        wait = self.outbound.room_at()
        if wait > self.now:
            yield wait

    def _injected_error(self) -> bool:
        self.error_after[0] -= 1
        return self.error_after[0] < 0

    def _answer(self, line: str, number: int, started: float) -> None:
        text = f"error:{number}" if number else "ok"
        fault = self.outbound.answer((text + "\r\n").encode(), self.now)
        extra = {} if fault is None else {"fault": fault}
        self.journal.note(self.now, "line", text=line, answer=text, taken=round(started, 6), **extra)
        self.journal.count("lines")
        if number:
            self.journal.count("errors")

    def _say(self, text: str) -> None:
        self.outbound.send((text + "\r\n").encode(), self.now)

    def _run_startup(self) -> Firmware:
        for line in self.eeprom.startup:
            if line:
                answer = yield from self._gcode(line)
                self._say(f">{line}:" + (f"error:{answer}" if answer else "ok"))

    def _auto_start(self) -> None:
        if self.motion.blocks:
            self._flags.add(Flag.START)


def _above_zero(values: Vector) -> Vector:
    x, y, z = (max(value, NEXT_TO_NOTHING) for value in values)
    return x, y, z
