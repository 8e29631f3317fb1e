"""The mock board's processor: bytes, interrupts, power, the main loop; bytes and time in, bytes out.

The firmware's main loop is a generator. It yields None to wait for anything to happen (a byte, a real-time flag, the
end of a move) or a time until which it is busy, so that what blocks in the firmware blocks here: a full planner, a
dwell, half a second after each alarm, an EEPROM write. Interrupts (bytes, limit switches, the step generator) act at
their own times in between. The clock is the caller's: :meth:`Board.advance` runs everything that falls due.
"""

from __future__ import annotations

import random
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Generator
from dataclasses import dataclass
from enum import Enum, auto

from gantry_driver.mock import reports
from gantry_driver.mock.gcode import ParserState
from gantry_driver.mock.journal import Journal
from gantry_driver.mock.mechanics import Mechanics
from gantry_driver.mock.motion import Block, Limits, Motion, MotionEvent, Triple, Vector
from gantry_driver.mock.serial_line import BITS_PER_BYTE, Inbound, Outbound
from gantry_driver.mock.settings import Eeprom

RX_BYTES = {"GRBL": 128, "grblHAL": 1024, "FluidNC": 256}
"""Receive buffers of the dialects; FluidNC does not tell its size."""
LINE_CHARACTERS = 79  # the line buffer has 80, one of them for the end
ALARM_DELAY_S = 0.5
NEXT_TO_NOTHING = 1e-6
"""Steps per mm or mm/s^2 in place of 0, by which the firmware would divide."""
MAX_STEPS = 2**31 - 1
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


class Abort(Exception):
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
    dialect: str = "GRBL"
    """One of :data:`RX_BYTES`; of the others only banner, build information, buffer, what is told of settings, and what
    reset, homing and alarm do to offsets and tools (grblHAL's gcode.c, motion_control.c; FluidNC's Protocol.cpp)."""

    @property
    def rx_bytes(self) -> int:
        return RX_BYTES[self.dialect]


@dataclass(slots=True)
class Overrides:
    """Percentages of the programmed feed, rapid and spindle speeds."""

    feed: int = 100
    rapid: int = 100
    spindle: int = 100


class Processor(ABC):
    """The board as far as its interrupts and its main loop go.

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

    # ---- what the layers above do

    @abstractmethod
    def _checkpoint(self) -> Firmware:
        """Serve real-time requests; while suspended, nothing else runs."""

    @abstractmethod
    def _system_command(self, line: str) -> Answering:
        """Carry out a ``$`` line and return its error number, 0 for none."""

    @abstractmethod
    def _gcode(self, line: str) -> Answering:
        """Carry out a line of G-code and return its error number, 0 for none."""

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
        m = self.mechanics
        tools = m.spindle, m.spindle_rpm, m.flood, m.mist
        self.soft_reset()
        if self.options.dialect == "FluidNC":  # with off_on_alarm as it is, they run on until the reset
            m.spindle, m.spindle_rpm, m.flood, m.mist = tools
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
            if self._reading and len(self._ring) >= self.options.rx_bytes and self._stall_until <= self.now:
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
            elif len(self._ring) >= self.options.rx_bytes:
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
        elif byte in _OVERRIDE_BYTES:
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
        self.parser = ParserState()
        if self.options.dialect == "grblHAL":
            self.parser.g92 = list(self.eeprom.g92)
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
        locks = self.eeprom.flag(22) and self.options.dialect != "grblHAL"  # its lock is a bit of its own, 4
        self.state = State.ALARM if locks else State.IDLE
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


_REALTIME: dict[int, Flag | None] = {
    0x18: None,
    ord("?"): Flag.STATUS,
    ord("~"): Flag.START,
    ord("!"): Flag.HOLD,
    0x84: Flag.DOOR,
}
_OVERRIDE_BYTES = frozenset([*range(0x90, 0x98), *range(0x99, 0x9F), 0xA0, 0xA1])
