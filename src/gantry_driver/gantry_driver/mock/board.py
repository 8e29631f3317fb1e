"""The mock board: GRBL 1.1h from the receive interrupt to the reports; bytes and time in, bytes out.

The firmware's main loop is a generator. It yields None to wait for anything to happen (a byte, a real-time flag, the
end of a move) or a time until which it is busy, so that what blocks in the firmware blocks here: a full planner, a
dwell, half a second after each alarm, an EEPROM write. Interrupts (bytes, limit switches, the step generator) act at
their own times in between. The clock is the caller's: :meth:`Board.advance` runs everything that falls due.
"""

from __future__ import annotations

import math
import random
from collections import deque
from collections.abc import Callable, Generator
from dataclasses import dataclass
from enum import Enum, auto

from gantry_driver.mock import reports
from gantry_driver.mock.gcode import PLANE_AXES, CheckedBlock, GcodeError, ParserState, check_line
from gantry_driver.mock.journal import Journal
from gantry_driver.mock.mechanics import Mechanics
from gantry_driver.mock.motion import Block, Limits, Motion, MotionEvent, Triple
from gantry_driver.mock.serial_line import BITS_PER_BYTE, Inbound, Outbound
from gantry_driver.mock.settings import Eeprom

RX_BYTES = 128
LINE_CHARACTERS = 79  # the line buffer has 80, one of them for the end
ALARM_DELAY_S = 0.5
EEPROM_BYTE_S = 0.0034  # ATmega328P datasheet, EEPROM write time (erase and write)
UART_FIFO_BYTES = 2
DWELL_STEP_S = 0.05  # a dwell is a whole number of these, with real-time requests served in between
DOOR_SPINDLE_S, DOOR_COOLANT_S = 4.0, 1.0
TRAVEL_TOLERANCE_MM = 1e-5
WCO_IDLE, WCO_BUSY, OV_IDLE, OV_BUSY = 10, 30, 10, 20

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

    HELD = auto()
    JOG_CANCEL = auto()
    CANCEL = auto()
    AJAR = auto()
    RETRACTED = auto()
    RESTORE = auto()
    RESTORED = auto()


class _Abort(Exception):
    """A reset has been asked for; the main loop starts anew."""


@dataclass(frozen=True, slots=True, kw_only=True)
class BoardOptions:
    """What does not depend on the settings."""

    baud: int = 115200
    """0 = bytes take no time."""
    latency_s: float = 0.0
    """What the host receives is this much later than the line alone makes it, as behind a USB adapter's timer."""
    line_s: float = 0.0005
    """Time the firmware takes for a line."""
    boot_s: float = 0.1
    """From power-up to the banner; bytes that arrive meanwhile are lost."""
    mist: bool = False
    """Built with M7."""


@dataclass(slots=True)
class Overrides:
    """Percentages of the programmed feed, rapid and spindle speeds."""

    feed: int = 100
    rapid: int = 100
    spindle: int = 100


class Board:
    """One controller board with its motors.

    Parameters
    ----------
    eeprom
        Settings and stored positions; the board writes to it.
    mechanics
        What hangs on the pins.
    rng
        Source of all chance, so that a seed repeats a run.
    """

    motion: Motion
    parser: ParserState
    overrides: Overrides
    _firmware: Firmware | None
    _resume_at: float | None
    _stall_until: float
    _deaf_from: float
    _deaf_until: float
    _fifo_window: int
    _fifo_used: int
    _alarm: int | None
    _flags: set[Flag]
    _suspend: set[Suspend]
    _probing: Callable[[Block], float | None] | None
    _probed_at: Triple

    def __init__(self, eeprom: Eeprom, mechanics: Mechanics, rng: random.Random, options: BoardOptions) -> None:
        self.eeprom = eeprom
        self.mechanics = mechanics
        self.rng = rng
        self.options = options
        self.journal = Journal()
        byte_s = BITS_PER_BYTE / options.baud if options.baud else 0.0
        self.inbound = Inbound(byte_s)
        self.outbound = Outbound(byte_s, rng, options.latency_s)
        self.now = 0.0
        self.powered = False
        self.state = State.IDLE
        self.error_after: list[int] = []
        """Injected: [lines to let pass, error number]."""
        self.eeprom_pause: tuple[float, float] | None = None
        """Injected: the next EEPROM write takes this long, and stays deaf for that long after its answer."""
        self._clear()

    # ---- what the world calls

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

    def receive(self, data: bytes, now: float) -> None:
        """Put bytes from the host on the line."""
        self._run_until(now)
        self.journal.note(now, "rx", bytes=data.decode("latin-1"))
        self.journal.count("bytes_received", len(data))
        if self.powered:
            self.inbound.push(data, now)
            self._run_until(now)
        else:
            self._lose(len(data), "unpowered")

    def advance(self, now: float) -> None:
        """Run everything that falls due by ``now`` (s, never going back)."""
        self._run_until(now)

    def next_due(self) -> float | None:
        """Return when something will happen by itself next, None if nothing will."""
        times = [self.outbound.due(), self._internal_due()]
        known = [t for t in times if t is not None]
        return min(known) if known else None

    def take_output(self) -> list[bytes]:
        """Return what has arrived at the host, piece by piece."""
        return self.outbound.take(self.now)

    def moving(self) -> bool:
        """Tell whether steps are being sent."""
        return self.motion.running

    def press_stop(self, pressed: bool) -> None:
        """Push or release the button on the reset pin, which acts as 0x18 does."""
        self.mechanics.stop_pressed = pressed
        if pressed:
            self.soft_reset()

    def set_door(self, is_open: bool) -> None:
        """Open or close the safety door's switch."""
        self.mechanics.door_open = is_open
        self._raise(Flag.DOOR if is_open else None)

    def hold_switch(self, axis: int, closed: bool) -> None:
        """Close an axis's limit switch by hand, or let it go."""
        if not closed:
            self.mechanics.held_switches.discard(axis)
            return
        self.mechanics.held_switches.add(axis)
        if self.eeprom.flag(21) and self.state not in (State.ALARM, State.HOME):
            self.raise_alarm(ALARM_HARD)

    def soft_reset(self) -> None:
        """Do what the reset interrupt does: stop the motors at once and ask the main loop to start anew."""
        self._catch_up()
        if Flag.RESET in self._flags:
            return
        self._stop_tools()
        if self.state in (State.RUN, State.HOME, State.JOG) or self.motion.stopping:
            if self.state is State.HOME:
                self._alarm = self._alarm or ALARM_HOME_RESET
            else:
                self._alarm = ALARM_ABORT
            self._halt(slips=True)
        self._raise(Flag.RESET)

    def raise_alarm(self, number: int) -> None:
        """Stop at once and enter an alarm, as a limit switch does."""
        self.soft_reset()
        self._alarm = number
        self._woken = True

    def stall(self, seconds: float) -> None:
        """Keep the main loop from running; interrupts go on."""
        self._stall_until = max(self._stall_until, self.now + seconds)

    # ---- time

    def _run_until(self, now: float) -> None:
        while True:
            due = self._internal_due()
            if due is None or due > now:
                break
            self.now = max(self.now, due)
            self._motion_events()
            self._bytes_arrive()
            self._run_firmware()
        self.now = max(self.now, now)
        self._catch_up()

    def _internal_due(self) -> float | None:
        if not self.powered:
            return None
        times = [self.inbound.due(), self.motion.due()]
        if self._resume_at is not None:
            times.append(max(self._resume_at, self._stall_until))
        elif self._woken:
            times.append(max(self.now, self._stall_until))
        known = [t for t in times if t is not None]
        return min(known) if known else None

    def _catch_up(self) -> None:
        """Let the motors stand where the counters are now."""
        self.mechanics.follow(self.motion.position(self.now))

    def _run_firmware(self) -> None:
        while self._firmware is not None and self._stall_until <= self.now:
            if self._resume_at is None:
                if not self._woken:
                    return
            elif self._resume_at > self.now:
                return
            self._woken = False
            self._resume_at = next(self._firmware)

    # ---- interrupts

    def _motion_events(self) -> None:
        while True:
            due = self.motion.due()
            if due is None or due > self.now:
                return
            event = self.motion.step(due)
            self._catch_up()
            if event is MotionEvent.TRIGGER:
                self._tripped()
            elif event in (MotionEvent.ALL_DONE, MotionEvent.HELD):
                delay_ms = self.eeprom.values[1]
                if delay_ms < 255:
                    self.stall(delay_ms / 1000.0)  # the idle delay of the drivers is a busy wait
                self._raise(Flag.STOPPED)
            self._woken = True

    def _tripped(self) -> None:
        if self.state is State.HOME:
            self._halt(slips=False)
            self._raise(Flag.STOPPED)
        elif self._probing is not None:
            self._probed_at = self.motion.position(self.now)
            self._probe_ok = True
            self._raise(Flag.CANCEL)
        else:
            self.raise_alarm(ALARM_HARD)

    def _watch(self, block: Block) -> float | None:
        """Return where along a block a switch or the probe will act, in mm."""
        if self.state is State.HOME:
            stops = [s for s, u in zip(block.freeze, block.unit) if u]
            known = [s for s in stops if s is not None]
            return max(known) if len(known) == len(stops) else None
        if self._probing is not None:
            return self._probing(block)
        if not self.eeprom.flag(21):
            return None
        # The motors may lag behind: they are asked for their place only now and then.
        self.mechanics.follow(block.position(self.motion.done))
        hits = [self._along(block, axis) for axis in range(3)]
        known = [hit for hit in hits if hit]  # a switch that is closed already gives no new edge
        return self.motion.done + min(known) if known else None

    def _along(self, block: Block, axis: int) -> float | None:
        """Return after how many more mm of the block an axis's switch closes."""
        if not block.steps[axis]:
            return None
        steps = self.mechanics.steps_to_switch(axis, 1 if block.steps[axis] > 0 else -1)
        if steps is None:
            return None
        distance = steps / abs(block.steps[axis]) * block.length
        return distance if self.motion.done + distance <= block.length else None

    def _bytes_arrive(self) -> None:
        while True:
            if self._reading and len(self._ring) >= RX_BYTES and self._stall_until <= self.now:
                self._woken = True  # the main loop is only waiting for bytes and takes them now
                return
            arrived = self.inbound.take(self.now)
            if arrived is None:
                return
            at, byte = arrived
            if self._booting:
                self._lose(1, "booting")
            elif at < self._deaf_until and not self._fifo_catches(at):
                self._lose(1, "eeprom")
            elif byte in _REALTIME or byte >= 0x80:
                self._realtime(byte)
                return
            elif len(self._ring) >= RX_BYTES:
                self._lose(1, "overflow")
            else:
                self._ring.append(byte)
                if byte in b"\r\n":
                    self._woken = True
                    return

    def _fifo_catches(self, at: float) -> bool:
        """While an EEPROM byte is written the interrupts are off and the receiver keeps two bytes."""
        window = int((at - self._deaf_from) / EEPROM_BYTE_S)
        if window != self._fifo_window:
            self._fifo_window, self._fifo_used = window, 0
        self._fifo_used += 1
        return self._fifo_used <= UART_FIFO_BYTES

    def _realtime(self, byte: int) -> None:
        self.journal.note(self.now, "realtime", byte=byte)
        self.journal.count("realtime_bytes")
        flag = _REALTIME.get(byte)
        if byte == 0x18:
            self.soft_reset()
        elif byte == 0x85:
            if self.state is State.JOG:
                self._raise(Flag.CANCEL)
        elif flag is not None:
            self._raise(flag)
        elif byte in _OVERRIDES:
            self._override_bytes.append(byte)
            self._woken = True

    def _raise(self, flag: Flag | None) -> None:
        if flag is not None:
            self._flags.add(flag)
        self._woken = True

    def _lose(self, count: int, why: str) -> None:
        self.journal.count("bytes_lost", count)
        self.journal.count(f"bytes_lost_{why}", count)

    # ---- power and reset

    def _clear(self) -> None:
        """Forget everything volatile."""
        self._firmware = None
        self._resume_at = None
        self._stall_until = 0.0
        self._woken = False
        self._booting = False
        self._reading = False
        self._deaf_from = self._deaf_until = 0.0
        self._fifo_window, self._fifo_used = -1, 0
        self._ring: deque[int] = deque()
        self._alarm = None
        self.motion = Motion(self._limits())
        self.motion.watch = self._watch
        self._probing = None
        self._reset_variables()

    def _reset_variables(self) -> None:
        """What a soft reset sets back as well."""
        self._flags = set()
        self._alarm = None
        self._suspend = set()
        self._override_bytes: deque[int] = deque()
        self.overrides = Overrides()
        self._wco_wait = self._ov_wait = 0
        self._soft_limit = False
        self._tools_held = (5, 0.0, False, False)
        self._spindle_stopped = False
        self._line = ""
        self._line_flags: set[str] = set()
        self._ring.clear()
        self._probing = None
        self._probed_at = (0, 0, 0)
        self._probe_ok = False
        self.parser = ParserState()
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
        self.state = State.ALARM if self.eeprom.flag(22) else State.IDLE
        self._booting = True
        self._firmware = self._main()
        self._woken = True

    def _halt(self, *, slips: bool) -> None:
        speeds = self.motion.axis_speeds(self.now)
        self.motion.halt(self.now)
        self._catch_up()
        if slips:
            self.mechanics.halt(speeds)

    def _stop_tools(self) -> None:
        m = self.mechanics
        m.spindle, m.spindle_rpm, m.flood, m.mist = 5, 0.0, False, False

    def _limits(self) -> Limits:
        e = self.eeprom
        rate_x, rate_y, rate_z = e.axis_values(110)
        return Limits(
            steps_per_mm=e.axis_values(100),
            max_rate=(rate_x / 60.0, rate_y / 60.0, rate_z / 60.0),
            acceleration=e.axis_values(120),
            junction_deviation=e.values[11],
        )

    def _mm(self, steps: Triple) -> list[float]:
        return [n / s for n, s in zip(steps, self.eeprom.axis_values(100))]

    def _steps(self, target_mm: list[float]) -> Triple:
        x, y, z = (round(t * s) for t, s in zip(target_mm, self.eeprom.axis_values(100)))
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
            except _Abort:
                self._lose(len(self._ring), "reset")
                self._reset_variables()
                self.journal.count("resets")

    def _session(self) -> Firmware:
        self._say(reports.BANNER)
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
        """Strip blanks and comments while a line comes in."""
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
        except _Abort:
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
            raise _Abort
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
        while self._override_bytes:
            self._override(self._override_bytes.popleft())

    def _serve_alarm(self) -> Firmware:
        number = self._alarm
        self.state = State.ALARM
        self._say(f"ALARM:{number}")
        self.journal.note(self.now, "alarm", number=number)
        self.journal.count("alarms")
        yield self.now + ALARM_DELAY_S
        if number in (ALARM_HARD, ALARM_SOFT):
            self._say(reports.RESET_HINT)
            self._flags.discard(Flag.RESET)  # what came before the hint is swallowed
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
                    if self.state is State.DOOR:
                        suspend -= {Suspend.RESTORE, Suspend.RESTORED}
                    self.state = State.DOOR
                suspend.add(Suspend.AJAR)
        if Flag.SLEEP in flags:
            if self.state is State.ALARM:
                suspend |= {Suspend.RETRACTED, Suspend.HELD}
            self.state = State.SLEEP
            self._say(reports.SLEEPING)
            self._stop_tools()

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
        """One turn of the suspended main loop: the door's sequence (without parking)."""
        suspend = self._suspend
        if self.state is State.DOOR and Suspend.HELD in suspend:
            m = self.mechanics
            if Suspend.RETRACTED not in suspend:
                self._tools_held = (m.spindle, m.spindle_rpm, m.flood, m.mist)
                self._stop_tools()
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
        elif byte in (0xA0, 0xA1) and self.state in (State.IDLE, State.RUN, State.HOLD):
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
        self.mechanics.spindle = mode
        self.mechanics.spindle_rpm = 0.0
        if mode != 5 and rpm > 0:
            self.mechanics.spindle_rpm = min(max(rpm, self.eeprom.values[31]), self.eeprom.values[30])
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
        """Return the report that ``?`` asks for, and count down to the fields that come now and then."""
        mask, inches = int(self.eeprom.values[10]), self.eeprom.flag(13)
        position = self._mm(self.motion.position(self.now))
        offset = self._work_offset()
        if mask & 1:
            fields = [self.state_text(), "MPos:" + reports.coordinates(position, inches)]
        else:
            work = [p - o for p, o in zip(position, offset)]
            fields = [self.state_text(), "WPos:" + reports.coordinates(work, inches)]
        if mask & 2:
            fields.append(f"Bf:{self.motion.room},{RX_BYTES - len(self._ring)}")
        feed = self.motion.speed(self.now) * 60.0 if self.state in BUSY else 0.0
        fields.append(f"FS:{reports.rate(feed, inches)},{self.mechanics.spindle_rpm:.0f}")
        pins = self.mechanics.pins()
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
            accessories = {3: "S", 4: "C"}.get(m.spindle, "") + "F" * m.flood + "M" * m.mist
            if accessories:
                fields.append("A:" + accessories)
        return f"<{'|'.join(fields)}>"

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
                info = reports.build_info(self.eeprom, self.options.mist, Motion.capacity, RX_BYTES)
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
            for text in reports.settings(self.eeprom):
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
        name, equals, value = rest[int(startup) :].partition("=")
        number = _number(name)
        if number is None:
            return ERROR_NUMBER
        if not equals:
            return ERROR_BAD_STATEMENT
        if startup:
            answer = yield from self._gcode(value)
            if answer:
                return answer
            index = int(number)
            if not 0 <= index < len(self.eeprom.startup):
                return ERROR_BAD_STATEMENT
            yield from self._write_eeprom(lambda: self.eeprom.startup.__setitem__(index, value))
            return 0
        parsed = _number(value)
        if parsed is None:
            return ERROR_NUMBER
        result = 0

        def store() -> None:
            nonlocal result
            result = self.eeprom.store(int(number), parsed)

        yield from self._write_eeprom(store)
        self.motion.limits = self._limits()
        return result

    def _write_eeprom(self, change: Callable[[], None]) -> Firmware:
        """Change what is stored; each changed byte takes a write during which the board is deaf."""
        yield from self._buffer_sync()
        before = self.eeprom.image()
        change()
        changed = sum(a != b for a, b in zip(before, self.eeprom.image()))
        if changed == 0 and self.eeprom_pause is None:
            return
        busy_s = (changed + 1) * EEPROM_BYTE_S  # one more for the checksum
        tail_s = 0.0
        if self.eeprom_pause is not None:
            (busy_s, tail_s), self.eeprom_pause = self.eeprom_pause, None
        self._deaf_from, self._deaf_until = self.now, self.now + busy_s + tail_s
        self.journal.note(self.now, "eeprom", bytes=changed, deaf_s=round(busy_s + tail_s, 6))
        yield self.now + busy_s

    # ---- moves

    def _beyond(self, target: list[float]) -> bool:
        travel = self.eeprom.axis_values(130)
        return any(t > TRAVEL_TOLERANCE_MM or t < -m - TRAVEL_TOLERANCE_MM for t, m in zip(target, travel))

    def _jog(self, rest: str) -> Answering:
        if self.state not in (State.IDLE, State.JOG):
            return ERROR_NOT_IDLE
        if rest[1:2] != "=":
            return ERROR_BAD_STATEMENT
        try:
            block = check_line(rest[2:], self.parser, self.eeprom.systems, jog=True)
        except GcodeError as error:
            return error.number
        if self.eeprom.flag(20) and self._beyond(block.target):
            return ERROR_TRAVEL
        yield from self._line_to(block.target, block.feed / 60.0, fixed_rate=True, checked=True)
        self.parser.position = list(block.target)
        if self.state is State.IDLE and self.motion.blocks:
            self.state = State.JOG
            self.motion.start(self.now)
        return 0

    def _line_to(
        self,
        target: list[float],
        rate: float,
        *,
        rapid: bool = False,
        inverse_time: bool = False,
        fixed_rate: bool = False,
        checked: bool = False,
    ) -> Firmware:
        """Plan a straight move, waiting for room."""
        if not checked and self.eeprom.flag(20) and self._beyond(target):
            yield from self._soft_limit_alarm()
        if self.state is State.CHECK:
            return
        while True:
            yield from self._checkpoint()
            if self.motion.room:
                break
            if self.state is State.IDLE:
                self._auto_start()
            else:
                yield None
        self.motion.add(
            self._steps(target), self.now, rate=rate, rapid=rapid, inverse_time=inverse_time, fixed_rate=fixed_rate
        )

    def _soft_limit_alarm(self) -> Firmware:
        self._soft_limit = True
        if self.state is State.RUN:
            self._flags.add(Flag.HOLD)
            yield from self._until(lambda: self.state is State.IDLE)
        self.raise_alarm(ALARM_SOFT)
        yield from self._checkpoint()

    def _gcode(self, line: str) -> Answering:
        try:
            block = check_line(line, self.parser, self.eeprom.systems, mist=self.options.mist)
        except GcodeError as error:
            return error.number
        yield from self._execute(block)
        return 0

    def _execute(self, block: CheckedBlock) -> Firmware:
        """Carry out a checked block in the order of RS274/NGC."""
        p, new = self.parser, block.modes
        p.modes.feed_mode, p.feed = new.feed_mode, block.feed
        active = self.state is not State.CHECK
        if p.speed != block.speed:
            if p.modes.spindle != 5 and active:
                yield from self._buffer_sync()
                self._set_spindle(p.modes.spindle, block.speed)
            p.speed = block.speed
        p.tool = block.tool
        if p.modes.spindle != new.spindle:
            if active:
                yield from self._buffer_sync()
                self._set_spindle(new.spindle)
            p.modes.spindle = new.spindle
        if (p.modes.flood, p.modes.mist) != (new.flood, new.mist):
            if active:
                yield from self._buffer_sync()
                self._set_coolant(new.flood, new.mist)
            p.modes.flood, p.modes.mist = new.flood, new.mist
        if block.action == 4 and active:
            yield from self._dwell(block.dwell_s)
        p.modes.plane, p.modes.units = new.plane, new.units
        if block.tool_length is not None and block.tool_length != p.tool_length:
            p.tool_length = block.tool_length
            yield from self._offset_changed()
        if p.modes.system != new.system:
            p.modes.system = new.system
            yield from self._offset_changed()
        p.modes.distance = new.distance
        yield from self._act(block)
        p.modes.motion = new.motion
        if block.moves and new.motion != 80:
            yield from self._move(block)
        if block.program is not None:
            yield from self._program(block.program)

    def _offset_changed(self) -> Firmware:
        yield from self._buffer_sync()
        self._wco_wait = 0

    def _dwell(self, seconds: float) -> Firmware:
        yield from self._buffer_sync()
        for _ in range(math.ceil(seconds / DWELL_STEP_S - 1e-9)):
            yield from self._checkpoint()
            yield self.now + DWELL_STEP_S

    def _act(self, block: CheckedBlock) -> Firmware:
        p, places = self.parser, self.eeprom.systems
        if block.action == 10:
            yield from self._write_eeprom(lambda: places.__setitem__(block.place_index, list(block.place)))
            if block.place_index == p.modes.system:
                yield from self._offset_changed()
        elif block.action in (28, 30):
            if block.target != p.position:
                yield from self._line_to(block.target, 0.0, rapid=True)
            yield from self._line_to(block.place, 0.0, rapid=True)
            p.position = list(block.place)
        elif block.action in (28.1, 30.1):
            index = len(places) - (2 if block.action == 28.1 else 1)
            here = list(p.position)
            yield from self._write_eeprom(lambda: places.__setitem__(index, here))
        elif block.action == 92:
            p.g92 = list(block.place)
            yield from self._offset_changed()
        elif block.action == 92.1:
            p.g92 = [0.0, 0.0, 0.0]
            yield from self._offset_changed()

    def _move(self, block: CheckedBlock) -> Firmware:
        motion = block.modes.motion
        inverse = block.modes.feed_mode == 93
        if motion == 0:
            yield from self._line_to(block.target, 0.0, rapid=True)
        elif motion == 1:
            yield from self._line_to(block.target, block.feed / 60.0, inverse_time=inverse)
        elif motion in (2, 3):
            yield from self._arc(block, inverse)
        else:
            yield from self._probe(block)
            return
        self.parser.position = list(block.target)

    def _arc(self, block: CheckedBlock, inverse: bool) -> Firmware:
        """Trace an arc by chords that stay within the arc tolerance $12."""
        first, second, normal = PLANE_AXES[block.modes.plane]
        start = list(self.parser.position)
        center = (start[first] + block.center[0], start[second] + block.center[1])
        begin = math.atan2(start[second] - center[1], start[first] - center[0])
        end = math.atan2(block.target[second] - center[1], block.target[first] - center[0])
        sweep = end - begin
        clockwise = block.modes.motion == 2
        if clockwise and sweep >= -5e-7:
            sweep -= 2 * math.pi
        elif not clockwise and sweep <= 5e-7:
            sweep += 2 * math.pi
        tolerance = self.eeprom.values[12]
        chord = 2 * math.sqrt(max(tolerance * (2 * block.radius - tolerance), 1e-12))
        count = max(int(abs(sweep) * block.radius / chord), 1)
        rate = block.feed / 60.0 * (count if inverse else 1)
        for i in range(1, count):
            angle = begin + sweep * i / count
            point = list(start)
            point[first] = center[0] + block.radius * math.cos(angle)
            point[second] = center[1] + block.radius * math.sin(angle)
            point[normal] += (block.target[normal] - start[normal]) * i / count
            yield from self._line_to(point, rate, inverse_time=inverse)
        yield from self._line_to(block.target, rate, inverse_time=inverse)

    def _program(self, number: int) -> Firmware:
        yield from self._buffer_sync()
        if number == 0:
            if self.state is not State.CHECK:
                self._flags.add(Flag.HOLD)
                yield from self._checkpoint()
            return
        modes = self.parser.modes
        modes.motion, modes.plane, modes.distance, modes.feed_mode, modes.system = 1, 17, 90, 94, 0
        modes.spindle, modes.flood, modes.mist = 5, False, False
        self.overrides = Overrides()
        self.motion.override(self.now, feed=1.0, rapid=1.0)
        if self.state is not State.CHECK:
            self._wco_wait = 0
            self._set_spindle(5)
            self._set_coolant(False, False)
        self._say(reports.PROGRAM_END)

    def _probe(self, block: CheckedBlock) -> Firmware:
        """G38.2 to G38.5: move until the probe closes (or opens), then decelerate."""
        if self.state is State.CHECK:
            self.parser.position = list(block.target)
            return
        yield from self._buffer_sync()
        away = block.modes.motion in (38.4, 38.5)
        must = block.modes.motion in (38.2, 38.4)
        self._probe_ok = False
        if self.mechanics.probe_closed() != away:
            self._halt(slips=False)
            self._alarm = ALARM_PROBE_START
            yield from self._checkpoint()
            return
        self._probing = lambda b: self._probe_along(b, away)
        yield from self._line_to(block.target, block.feed / 60.0, fixed_rate=True)
        self._auto_start()
        yield from self._until(lambda: self.state is State.IDLE)
        self._probing = None
        if not self._probe_ok:
            self._probed_at = self.motion.position(self.now)
            if must:
                self._alarm = ALARM_PROBE_END
        yield from self._checkpoint()
        self.motion.halt(self.now)
        self._sync_parser()
        self._say(reports.probe(self._mm(self._probed_at), self._probe_ok, self.eeprom.flag(13)))

    def _probe_along(self, block: Block, away: bool) -> float | None:
        surface, n = self.mechanics.probe_z_mm, block.steps[2]
        if surface is None or not n or (n > 0) != away:
            return None
        steps = abs(self.mechanics.motor[2] - surface * self.mechanics.steps_per_mm[2])
        distance = self.motion.done + steps / abs(n) * block.length
        return distance if distance <= block.length else None

    # ---- homing

    def _homing_command(self, rest: str) -> Answering:
        if not self.eeprom.flag(22):
            return ERROR_HOMING_OFF
        if self.mechanics.door_open:
            return ERROR_DOOR
        if rest != "H":
            return ERROR_BAD_STATEMENT
        self.state = State.HOME
        for axes in ((2,), (0, 1)):  # the stylus is lifted before the carriage moves
            yield from self._home_axes(axes)
        self._flags.discard(Flag.STOPPED)
        self._flags.discard(Flag.HOLD)
        while self._alarm is not None or self._flags:
            yield from self._serve()
        self._sync_parser()
        self.state = State.IDLE
        self.journal.count("homings")
        yield from self._run_startup()
        return 0

    def _home_axes(self, axes: tuple[int, ...]) -> Firmware:
        e = self.eeprom
        seek, locate, pull_off = e.values[25], e.values[24], e.values[27]
        search = 1.5 * max(e.values[130 + i] for i in axes)
        self.mechanics.draw_trips()
        phases = ((True, search, seek), (False, pull_off, seek), (True, 5 * pull_off, locate), (False, pull_off, seek))
        for approach, distance, rate in phases:
            yield from self._home_move(axes, approach, distance, rate / 60.0 * math.sqrt(len(axes)))
            if approach and not all(self.mechanics.pressed(i) for i in axes):
                yield from self._homing_failed(ALARM_HOME_SEARCH)
            if not approach and any(self.mechanics.pressed(i) for i in axes):
                yield from self._homing_failed(ALARM_HOME_PULL_OFF)
            yield self.now + e.values[26] / 1000.0
        here = self._mm(self.motion.position(self.now))
        for i in axes:
            here[i] = -e.values[130 + i] + pull_off if self._home_sign(i) < 0 else -pull_off
        steps = self._steps(here)
        self.motion.set_position(steps)
        self.mechanics.renumber(steps)

    def _home_sign(self, axis: int) -> int:
        return -1 if int(self.eeprom.values[23]) >> axis & 1 else 1

    def _home_move(self, axes: tuple[int, ...], approach: bool, distance: float, rate: float) -> Firmware:
        """Move until each axis has met its switch (approach) or by ``distance``; the report stays unanswered."""
        here = self.motion.position(self.now)
        target = list(here)
        scale = self.eeprom.axis_values(100)
        for i in axes:
            target[i] += round(distance * scale[i]) * self._home_sign(i) * (1 if approach else -1)
        self._flags.discard(Flag.STOPPED)
        block = self.motion.add((target[0], target[1], target[2]), self.now, rate=rate, fixed_rate=True)
        if block is None:
            return
        if approach:
            x, y, z = (self._along(block, i) for i in range(3))
            block.freeze = (x, y, z)
        self.motion.start(self.now)
        while Flag.STOPPED not in self._flags:
            if Flag.RESET in self._flags:
                yield from self._serve()
            if Flag.DOOR in self._flags:
                yield from self._homing_failed(ALARM_HOME_DOOR)
            yield None

    def _homing_failed(self, number: int) -> Firmware:
        self._alarm = number
        self.soft_reset()
        yield from self._serve()


_REALTIME: dict[int, Flag | None] = {
    0x18: None,
    ord("?"): Flag.STATUS,
    ord("~"): Flag.START,
    ord("!"): Flag.HOLD,
    0x84: Flag.DOOR,
}
_FEED_STEPS: dict[int, int | None] = {0x90: None, 0x91: 10, 0x92: -10, 0x93: 1, 0x94: -1}
_RAPID_VALUES = {0x95: 100, 0x96: 50, 0x97: 25}
_SPINDLE_STEPS: dict[int, int | None] = {0x99: None, 0x9A: 10, 0x9B: -10, 0x9C: 1, 0x9D: -1}
_OVERRIDES = {*_FEED_STEPS, *_RAPID_VALUES, *_SPINDLE_STEPS, 0x9E, 0xA0, 0xA1}


def _stepped(value: int, step: int | None) -> int:
    return 100 if step is None else min(max(value + step, 10), 200)


def _number(text: str) -> float | None:
    try:
        return float(text) if text and "e" not in text.lower() else None
    except ValueError:
        return None
