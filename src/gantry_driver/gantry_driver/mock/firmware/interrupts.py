"""The mock board's interrupts: bytes, limit switches, the step generator; bytes and time in, bytes out.

The caller has the clock: :meth:`Interrupts.advance` runs everything that becomes due.
"""

from __future__ import annotations

import random
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable

from gantry_driver.mock.firmware.motion import Block, MotionEvent, MotionPlanner, Triple
from gantry_driver.mock.firmware.options import BoardOptions
from gantry_driver.mock.firmware.parser_state import ParserState
from gantry_driver.mock.firmware.states import (
    ALARM_ABORT,
    ALARM_HARD,
    ALARM_HOME_RESET,
    Firmware,
    Flag,
    Overrides,
    State,
    Suspend,
)
from gantry_driver.mock.journal import Journal
from gantry_driver.mock.mechanics import Mechanics
from gantry_driver.mock.serial_line import BITS_PER_BYTE, Inbound, Outbound
from gantry_driver.mock.settings import Eeprom

EEPROM_BYTE_S = 0.0034  # ATmega328P datasheet, EEPROM write time (erase and write)
UART_FIFO_BYTES = 2


class Interrupts(ABC):
    """The interrupt layer of the board.

    Parameters
    ----------
    eeprom
        Settings and stored positions; the board writes to it.
    mechanics
        Devices on the pins.
    rng
        Source of all random numbers, so that a seed repeats a run.
    """

    motion: MotionPlanner
    parser: ParserState
    overrides: Overrides
    _firmware: Firmware | None
    _resume_at: float | None
    _woken: bool
    _booting: bool
    _reading: bool
    _ring: deque[int]
    _override_bytes: set[int]
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
    _probe_ok: bool
    _probe_away: bool

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
        """Injected fault: [number of lines to let pass, error number]."""
        self.eeprom_pause: tuple[float, float] | None = None
        """Injected fault: seconds of the next EEPROM write, and seconds without reception after its answer."""
        self._clear()

    @abstractmethod
    def _clear(self) -> None:
        """Clear all volatile state."""

    # ---- interface

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
        """Run everything that becomes due by ``now`` (s, never decreasing)."""
        self._run_until(now)

    def next_due(self) -> float | None:
        """Return the time of the next event without input, None if there is none."""
        times = [self.outbound.due(), self._internal_due()]
        known = [t for t in times if t is not None]
        return min(known) if known else None

    def take_output(self) -> list[bytes]:
        """Return the pieces that have arrived at the host."""
        return self.outbound.take(self.now)

    def moving(self) -> bool:
        """Return whether steps are being sent."""
        return self.motion.running

    def press_stop(self, pressed: bool) -> None:
        """Push or release the button on the reset pin, which acts like 0x18."""
        self.mechanics.stop_pressed = pressed
        if pressed:
            self.soft_reset()

    def set_door(self, is_open: bool) -> None:
        """Open or close the safety door's switch."""
        self.mechanics.door_open = is_open
        self._raise(Flag.DOOR if is_open else None)

    def hold_switch(self, axis: int, closed: bool) -> None:
        """Close an axis's limit switch by hand, or release it."""
        if not closed:
            self.mechanics.held_switches.discard(axis)
            return
        self.mechanics.held_switches.add(axis)
        if self.eeprom.flag(21) and self.state not in (State.ALARM, State.HOME):
            self.raise_alarm(ALARM_HARD)

    def set_probe(self, closed: bool) -> None:
        """Connect the probe input with ground, or disconnect it, at the time that :meth:`advance` has reached."""
        self._catch_up()
        self.mechanics.probe_contact = closed
        if self._probing is not None and not self._probe_ok and self.motion.running and self._probe_triggered():
            self._tripped()

    def _probe_triggered(self) -> bool:
        """Return whether the probe input has its active level: low, high with $6, the opposite in G38.4 and .5."""
        return (self.mechanics.probe_closed() != self.eeprom.flag(6)) != self._probe_away

    def soft_reset(self) -> None:
        """Act like the reset interrupt: stop the motors at once and make the main loop restart."""
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
        """Stop at once and enter an alarm, like a limit switch."""
        m = self.mechanics
        tools = m.spindle, m.spindle_rpm, m.flood, m.mist
        self.soft_reset()
        if self.options.dialect == "FluidNC":  # without off_on_alarm, tools run until the reset
            m.spindle, m.spindle_rpm, m.flood, m.mist = tools
        self._alarm = number
        self._woken = True

    def stall(self, seconds: float) -> None:
        """Keep the main loop from running; interrupts continue."""
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
        due, moved = self.inbound.due(), self.motion.due()
        if due is None or (moved is not None and moved < due):
            due = moved
        if self._resume_at is not None or self._woken:
            woken = max(self.now if self._resume_at is None else self._resume_at, self._stall_until)
            due = woken if due is None else min(due, woken)
        return due

    def _catch_up(self) -> None:
        """Move the motors to the current counters."""
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
        """Return the distance along a block at which a switch or the probe will act, in mm."""
        if self.state is State.HOME:
            stops = [s for s, u in zip(block.freeze, block.unit) if u]
            known = [s for s in stops if s is not None]
            return max(known) if len(known) == len(stops) else None
        if self._probing is not None:
            return self._probing(block)
        if not self.eeprom.flag(21):
            return None
        # The motors may lag behind, because their positions are updated only from time to time.
        self.mechanics.follow(block.position(self.motion.done))
        hits = [self._along(block, axis) for axis in range(3)]
        known = [hit for hit in hits if hit]  # a switch that is already closed gives no new edge
        return self.motion.done + min(known) if known else None

    def _along(self, block: Block, axis: int) -> float | None:
        """Return the remaining distance in mm along the block at which an axis's switch closes."""
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
                self._woken = True  # the main loop only waits for bytes and takes them now
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
        """Return whether the receiver keeps a byte: during an EEPROM write, without interrupts, it keeps two."""
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
            self._override_bytes.add(byte)
            self._woken = True

    def _raise(self, flag: Flag | None) -> None:
        if flag is not None:
            self._flags.add(flag)
        self._woken = True

    def _lose(self, count: int, why: str) -> None:
        self.journal.count("bytes_lost", count)
        self.journal.count(f"bytes_lost_{why}", count)

    def _halt(self, *, slips: bool) -> None:
        speeds = self.motion.axis_speeds(self.now)
        self.motion.halt(self.now)
        self._catch_up()
        if slips:
            self.mechanics.halt(speeds)

    def _stop_tools(self) -> None:
        m = self.mechanics
        m.spindle, m.spindle_rpm, m.flood, m.mist = 5, 0.0, False, False


_REALTIME: dict[int, Flag | None] = {
    0x18: None,
    ord("?"): Flag.STATUS,
    ord("~"): Flag.START,
    ord("!"): Flag.HOLD,
    0x84: Flag.DOOR,
}
_OVERRIDE_BYTES = frozenset([*range(0x90, 0x98), *range(0x99, 0x9F), 0xA0, 0xA1])
