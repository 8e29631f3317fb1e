"""The mock board's reactions to real-time bytes: holds, the door, overrides, and the status report for ``?``."""

from __future__ import annotations

import math
from collections.abc import Callable

from gantry_driver.mock.firmware import reports
from gantry_driver.mock.firmware.processor import Processor
from gantry_driver.mock.firmware.states import (
    ALARM_HARD,
    ALARM_SOFT,
    BUSY,
    Abort,
    Firmware,
    Flag,
    State,
    Suspend,
)

ALARM_DELAY_S = 0.5
DWELL_STEP_S = 0.05  # a dwell is a whole number of these, with real-time requests served in between
DOOR_SPINDLE_S, DOOR_COOLANT_S = 4.0, 1.0
WCO_IDLE, WCO_BUSY, OV_IDLE, OV_BUSY = 10, 30, 10, 20
_FEED_STEPS: dict[int, int | None] = {0x90: None, 0x91: 10, 0x92: -10, 0x93: 1, 0x94: -1}
_RAPID_VALUES = {0x95: 100, 0x96: 50, 0x97: 25}
_SPINDLE_STEPS: dict[int, int | None] = {0x99: None, 0x9A: 10, 0x9B: -10, 0x9C: 1, 0x9D: -1}


class RealTime(Processor):
    """Serves the requests that interrupts have left for the main loop."""

    # ---- real-time requests

    def _checkpoint(self) -> Firmware:
        """Serve real-time requests; while suspended, nothing else runs."""
        while self._alarm is not None or self._flags or self._override_bytes:
            yield from self._serve()
        while self._suspend:
            yield from self._suspended()
            yield None
            while self._alarm is not None or self._flags or self._override_bytes:
                yield from self._serve()

    def _until(self, condition: Callable[[], bool]) -> Firmware:
        while True:
            yield from self._checkpoint()
            if condition():
                return
            yield None

    def _buffer_sync(self) -> Firmware:
        """Wait until all planned moves are done."""
        self._auto_start()
        yield from self._until(lambda: not self.motion.blocks and self.state is not State.RUN)

    def _serve(self) -> Firmware:
        if self._alarm is not None:
            yield from self._serve_alarm()
        if Flag.RESET in self._flags:
            raise Abort
        flags, self._flags = self._flags, set()
        if Flag.STATUS in flags:
            self._say(self.status())
            self.journal.count("status_reports")
        if flags & {Flag.HOLD, Flag.CANCEL, Flag.DOOR, Flag.SLEEP}:
            self._serve_hold(flags)
        if Flag.START in flags and not flags & {Flag.HOLD, Flag.CANCEL, Flag.DOOR}:
            self._serve_start()
        if Flag.STOPPED in flags:
            self._serve_stopped()
        # Each is a flag: repeated requests count once, and flags are served in the order of their numbers.
        overrides, self._override_bytes = sorted(self._override_bytes), set()
        for byte in overrides:
            self._override(byte)

    def _serve_alarm(self) -> Firmware:
        number = self._alarm
        self.state = State.ALARM
        self._say(f"ALARM:{number}")
        self.journal.note(self.now, "alarm", number=number)
        self.journal.count("alarms")
        yield self.now + ALARM_DELAY_S
        if number in (ALARM_HARD, ALARM_SOFT):
            self._say(reports.RESET_HINT)
            self._flags.discard(Flag.RESET)  # a reset before the hint is ignored
            while Flag.RESET not in self._flags:
                yield None
        self._alarm = None

    def _serve_hold(self, flags: set[Flag]) -> None:
        suspend = self._suspend
        if self.state not in (State.ALARM, State.CHECK):
            if self.state in (State.RUN, State.JOG) and not suspend & {Suspend.CANCEL, Suspend.JOG_CANCEL}:
                self.motion.hold(self.now)
                if self.state is State.JOG and Flag.SLEEP not in flags:
                    suspend.add(Suspend.JOG_CANCEL)
            if self.state is State.IDLE:
                suspend.clear()
                suspend.add(Suspend.HELD)
            if Flag.CANCEL in flags and Suspend.JOG_CANCEL not in suspend:
                suspend.add(Suspend.CANCEL)
            if Flag.HOLD in flags and self.state not in (State.DOOR, State.JOG, State.SLEEP):
                self.state = State.HOLD
            if Flag.DOOR in flags:
                self._say(reports.CHECK_DOOR)
                if Suspend.JOG_CANCEL not in suspend and self.state is not State.SLEEP:
                    if self.state is State.DOOR and Suspend.RESTORE in suspend:
                        suspend -= {Suspend.RESTORE, Suspend.RESTORED}
                        self._stop_tools()  # those that already run again; the state to restore is kept
                    self.state = State.DOOR
                suspend.add(Suspend.AJAR)
        if Flag.SLEEP in flags:
            if self.state is State.ALARM:
                suspend |= {Suspend.RETRACTED, Suspend.HELD}
            self.state = State.SLEEP
            self._say(reports.SLEEPING)
            self._stop_tools()
            self._ov_wait = 0

    def _serve_start(self) -> None:
        suspend = self._suspend
        if self.state is State.DOOR and Suspend.AJAR not in suspend:
            if Suspend.RESTORED in suspend:
                self.state = State.IDLE
            elif Suspend.RETRACTED in suspend:
                suspend.add(Suspend.RESTORE)
        held = self.state is State.HOLD and Suspend.HELD in suspend
        if self.state is State.IDLE or held:
            go = bool(self.motion.blocks) and Suspend.CANCEL not in suspend
            if held and self._spindle_stopped:
                self._set_spindle(self.parser.modes.spindle)
                self._spindle_stopped = False
            suspend.clear()
            self.state = State.RUN if go else State.IDLE
            if go:
                self.motion.start(self.now)

    def _serve_stopped(self) -> None:
        suspend = self._suspend
        paused = self.state in (State.HOLD, State.DOOR, State.SLEEP)
        if paused and not self._soft_limit and Suspend.JOG_CANCEL not in suspend:
            suspend.add(Suspend.HELD)
            return
        if Suspend.JOG_CANCEL in suspend:
            self.motion.halt(self.now)
            self._sync_parser()
        if Suspend.AJAR in suspend:
            suspend.discard(Suspend.JOG_CANCEL)
            suspend.add(Suspend.HELD)
            self.state = State.DOOR
        else:
            suspend.clear()
            self.state = State.IDLE

    def _suspended(self) -> Firmware:
        """Run one turn of the suspended main loop: the door's sequence (without parking)."""
        suspend = self._suspend
        if self.state is State.DOOR and Suspend.HELD in suspend:
            m = self.mechanics
            if Suspend.RETRACTED not in suspend:
                self._tools_held = (m.spindle, m.spindle_rpm, m.flood, m.mist)
                self._stop_tools()
                self._ov_wait = 0
                suspend.add(Suspend.RETRACTED)
            if Suspend.AJAR in suspend and not m.door_open:
                suspend.discard(Suspend.AJAR)
            if Suspend.RESTORE in suspend and Suspend.RESTORED not in suspend:
                spindle, rpm, flood, mist = self._tools_held
                if spindle != 5:
                    m.spindle, m.spindle_rpm = spindle, rpm
                    yield from self._restore_wait(DOOR_SPINDLE_S)
                if (flood or mist) and Suspend.RESTORE in suspend:
                    m.flood, m.mist = flood, mist
                    yield from self._restore_wait(DOOR_COOLANT_S)
                if Suspend.RESTORE in suspend:
                    suspend.add(Suspend.RESTORED)
                    self._raise(Flag.START)

    def _restore_wait(self, seconds: float) -> Firmware:
        for _ in range(math.ceil(seconds / DWELL_STEP_S)):
            if Suspend.RESTORE not in self._suspend:
                return
            yield self.now + DWELL_STEP_S
            if self._alarm is not None or self._flags:
                yield from self._serve()

    # ---- overrides

    def _override(self, byte: int) -> None:
        o = self.overrides
        before = (o.feed, o.rapid, o.spindle)
        if byte in _FEED_STEPS:
            o.feed = _stepped(o.feed, _FEED_STEPS[byte])
        elif byte in _RAPID_VALUES:
            o.rapid = _RAPID_VALUES[byte]
        elif byte in _SPINDLE_STEPS:
            o.spindle = _stepped(o.spindle, _SPINDLE_STEPS[byte])
        elif byte == 0x9E:
            if self.state is State.HOLD and Suspend.HELD in self._suspend and self.parser.modes.spindle != 5:
                self._spindle_stopped = not self._spindle_stopped
                self._set_spindle(5 if self._spindle_stopped else self.parser.modes.spindle)
        elif byte in (0xA0, 0xA1) and self.state in (State.IDLE, State.RUN, State.HOLD, State.JOG):
            modes = self.parser.modes
            if byte == 0xA0:
                modes.flood = not modes.flood
            elif self.options.mist:
                modes.mist = not modes.mist
            self._set_coolant(modes.flood, modes.mist)
        if (o.feed, o.rapid, o.spindle) != before:
            self._ov_wait = 0
            self.motion.override(self.now, feed=o.feed / 100, rapid=o.rapid / 100)
            if self.mechanics.spindle != 5:
                self._set_spindle(self.mechanics.spindle)

    def _set_spindle(self, mode: int, speed: float | None = None) -> None:
        """Turn the spindle (or the servo on its pin) with M3 or M4, or stop it with M5."""
        rpm = self.parser.speed if speed is None else speed
        rpm *= self.overrides.spindle / 100
        least, most = self.eeprom.values[31], self.eeprom.values[30]
        self.mechanics.spindle = mode
        if mode == 5:
            rpm = 0.0
        elif least >= most or rpm >= most:
            rpm = most
        elif 0.0 < rpm < least:
            rpm = least
        self.mechanics.spindle_rpm = rpm
        self._ov_wait = 0

    def _set_coolant(self, flood: bool, mist: bool) -> None:
        self.mechanics.flood, self.mechanics.mist = flood, mist
        self._ov_wait = 0

    # ---- status report

    def state_text(self) -> str:
        """Return the state with its sub-state."""
        suspend = self._suspend
        if self.state is State.HOLD:
            return "Hold:0" if Suspend.HELD in suspend else "Hold:1"
        if self.state is State.DOOR:
            if Suspend.RESTORE in suspend:
                return "Door:3"
            if Suspend.RETRACTED in suspend:
                return "Door:1" if Suspend.AJAR in suspend else "Door:0"
            return "Door:2"
        return str(self.state.value)

    def _work_offset(self) -> list[float]:
        p = self.parser
        system = self.eeprom.systems[p.modes.system]
        return [system[i] + p.g92[i] + (p.tool_length if i == 2 else 0.0) for i in range(3)]

    def status(self) -> str:
        """Return the report for ``?``, and count down to the fields that it has only from time to time."""
        mask, inches = int(self.eeprom.values[10]), self.eeprom.flag(13)
        position = self._mm(self.motion.position(self.now))
        offset = self._work_offset()
        if mask & 1:
            fields = [self.state_text(), "MPos:" + reports.coordinates(position, inches)]
        else:
            work = [p - o for p, o in zip(position, offset)]
            fields = [self.state_text(), "WPos:" + reports.coordinates(work, inches)]
        if mask & 2:
            fields.append(f"Bf:{self.motion.room},{self.options.rx_bytes - len(self._ring)}")
        feed = self.motion.speed(self.now) * 60.0 if self.state in BUSY else 0.0
        fields.append(f"FS:{reports.rate(feed, inches)},{reports.speed(self.mechanics.spindle_rpm)}")
        pins = self.mechanics.pins(self._probe_triggered())
        if pins:
            fields.append("Pn:" + pins)
        busy = self.state in BUSY
        if self._wco_wait > 0:
            self._wco_wait -= 1
        else:
            self._wco_wait = (WCO_BUSY if busy else WCO_IDLE) - 1
            self._ov_wait = max(self._ov_wait, 1)
            fields.append("WCO:" + reports.coordinates(offset, inches))
        if self._ov_wait > 0:
            self._ov_wait -= 1
        else:
            self._ov_wait = (OV_BUSY if busy else OV_IDLE) - 1
            o, m = self.overrides, self.mechanics
            fields.append(f"Ov:{o.feed},{o.rapid},{o.spindle}")
            turning = {3: "S", 4: "C"}.get(m.spindle, "") if m.spindle_rpm else ""
            accessories = turning + "F" * m.flood + "M" * m.mist
            if accessories:
                fields.append("A:" + accessories)
        return f"<{'|'.join(fields)}>"


def _stepped(value: int, step: int | None) -> int:
    return 100 if step is None else min(max(value + step, 10), 200)
