"""The serial port under a :class:`~gantry_driver.core.machine.machine.Machine`: one thread polls port and wake pipe.

A stop does not wait for that thread: it writes ``!`` to the port from the calling thread.
"""

from __future__ import annotations

import contextlib
import errno
import os
import select
import termios
import threading
from collections.abc import Callable
from typing import TypeVar

import serial

from gantry_driver.adapters.serial_port import hang_up, open_port
from gantry_driver.adapters.stylus_record import StylusRecord
from gantry_driver.adapters.wake_pipe import WakePipe
from gantry_driver.core.grbl.session import HOLD
from gantry_driver.core.machine.machine import Machine
from gantry_driver.core.states.machine_states import CloseRequested, Event, Note
from gantry_driver.core.states.reasons import Why
from icu_common.adapters.real_time import steady_s
from icu_common.core.reasons.message import Message, quoted

T = TypeVar("T")


FIRST_RETRY_S, LAST_RETRY_S = 0.1, 1.0
LONGEST_WAIT_S = 0.1
"""Maximum sleep of the thread in seconds of wall time."""
WAY_OUT_S = 6.0
"""Seconds that a closing link waits, after the hold, for the board's reset and the stylus's retreat."""


class SerialLink:
    """Runs a machine on a serial port: opens the port, exchanges bytes, and reopens a port that has disappeared.

    Parameters
    ----------
    machine
        Used only under this object's lock; see :meth:`call`.
    port, baud
        Device and baud rate; the port is locked for other programs (``exclusive``).
    on_events
        Called in the link's thread with the machine's events, in order and never concurrently.
    clock
        The machine's time in seconds: the steady clock, or that of a simulation, which is 0 until it is known.
    on_turn
        Called in the link's thread at the end of each turn. It gets the number of the newest :meth:`wake` that the turn
        has seen, and the numbers of bytes that it has read and written.
    record
        Records that the stylus may be down; written before the bytes that may lower it.
    hangs_up
        Whether closing the port lowers its DTR line; None for the port's setting when it is opened.
    """

    def __init__(
        self,
        machine: Machine,
        port: str,
        baud: int,
        on_events: Callable[[list[Event]], None],
        *,
        clock: Callable[[], float] = steady_s,
        on_turn: Callable[[int, int, int], None] | None = None,
        record: StylusRecord | None = None,
        hangs_up: bool | None = None,
    ) -> None:
        self.hangs_up = hangs_up
        self._record = record if record is not None else StylusRecord(None)
        self._recorded: bool | None = None
        self._clock, self._on_turn = clock, on_turn
        self._wakes = self._wakes_seen = self._read_bytes = self._written_bytes = 0
        self._machine = machine
        self._port_name = port
        self._baud = baud
        self._on_events = on_events
        self._changed = threading.Condition(threading.RLock())
        self._port: serial.Serial | None = None
        self._fd = -1
        self._pending = bytearray()
        self._closing = False
        self._closed = False
        self._retry_s, self._next_try = FIRST_RETRY_S, 0.0
        self._wake_pipe = WakePipe()
        self._poller = select.poll()
        self._poller.register(self._wake_pipe.read_fd, select.POLLIN)
        self._writing = False
        self._thread = threading.Thread(target=self._run, name="serial-link", daemon=True)
        self._stop_asked: Why = ""
        self.opened: os.stat_result | None = None
        """File status of the last opened device."""

    def start(self) -> None:
        """Start the thread; the port may appear later."""
        self._thread.start()

    @property
    def alive(self) -> bool:
        """Whether the thread that reads and writes the port runs; without it nothing stops the board."""
        return self._thread.is_alive()

    def call(self, action: Callable[[Machine, float], T]) -> T:
        """Run ``action(machine, now)`` under the lock, and let the thread send the resulting bytes.

        Before :meth:`start` there is no port, and the resulting events are passed on at once.
        """
        with self._changed:
            result = action(self._machine, self._now())
        if self._thread.ident is None:
            self._publish()
        self._wake_pipe.wake()
        return result

    def stop(self, reason: Why) -> None:
        """Write a feed hold to the port now, ahead of all queues, then let the machine carry out its stop sequence.

        A retreat of the stylus that is in progress is not held; it finishes.
        """
        # Read without the lock, which may be busy: in a race, the machine holds, resets and lifts once more.
        self._stop_asked = reason
        written = not self._machine.retreating and self._write_hold()
        self.call(lambda machine, now: self._take_stop(machine, now, hold_written=written))

    def wait_for(self, condition: Callable[[Machine], bool], within_s: float) -> bool:
        """Wait until ``condition(machine)`` holds; return whether it did in time."""
        with self._changed:
            return self._changed.wait_for(lambda: condition(self._machine), within_s)

    def close(self, reason: str) -> None:
        """Bring the machine to rest with the stylus up, then close the port; report if this takes too long."""
        if self._closed:
            return
        self._closed = True
        late: list[Event] = []
        with self._changed:
            restless = self._machine.needs_way_out
        if restless:
            self.stop(reason)
            within_s = self._machine.config.hold_timeout_s + WAY_OUT_S
            if self.alive and not self.wait_for(lambda machine: machine.at_rest, within_s):
                late.append(
                    Note(
                        level="error",
                        text=f"closed {within_s:g} s after the stop, while {self._machine.phase.name.lower()}: the "
                        "machine's state is unknown, the stylus may be down",
                    )
                )
        self._closing = True
        self._wake_pipe.wake()
        if self._thread.ident is not None:
            self._thread.join(2.0)
        self._close_port()
        if late:
            self._on_events(late)
        self._wake_pipe.close()

    @property
    def wakes(self) -> int:
        """Number of calls of :meth:`wake`."""
        return self._wakes

    def wake(self) -> None:
        """Make the thread read the clock and do what is due."""
        self._wakes += 1
        self._wake_pipe.wake()

    def _now(self) -> float:
        """Return the machine's time, and pass the wall time to the machine."""
        self._machine.wall_s = steady_s()
        return self._clock()

    def _take_stop(self, machine: Machine, now: float, *, hold_written: bool) -> None:
        reason, self._stop_asked = self._stop_asked, ""
        if reason:
            machine.stop(reason, now, hold_written=hold_written)

    def _write_hold(self) -> bool:
        fd = self._fd
        if fd < 0:
            return False
        try:
            # Lines up to the size of a receive buffer may wait in the kernel, 11 ms at 115200 baud; a reset follows.
            termios.tcflush(fd, termios.TCOFLUSH)
            self._written_bytes += os.write(fd, HOLD)
        except (OSError, termios.error):
            return False
        return True

    # --- the thread ------------------------------------------------------------------------------------------

    def _run(self) -> None:
        while not self._closing:
            try:
                self._step()
            except Exception as error:
                # Whatever the error, nothing would stop the board after the end of this thread.
                self._write_hold()
                self._lost(Message("link.error_driver", error=quoted(error)))
                # The receiver of the events may be the cause, and fail again.
                with contextlib.suppress(Exception):
                    self._publish()

    def _step(self) -> None:
        now = self._clock()
        if self._fd >= 0:
            self._turn()
            if self._machine.connected:
                self._retry_s = FIRST_RETRY_S
        elif not now or now < self._next_try:
            self._wait(LONGEST_WAIT_S if not now else self._next_try - now)
        else:
            # A board that resets at each opening must not be opened in a tight loop.
            self._next_try = now + self._retry_s
            self._retry_s = min(2.0 * self._retry_s, LAST_RETRY_S)
            self._open()
        self._publish()
        if self._on_turn is not None:
            read, written = self._read_bytes, self._written_bytes
            self._read_bytes = self._written_bytes = 0
            self._on_turn(self._wakes_seen, read, written)

    def _open(self) -> None:
        try:
            config = self._machine.config
            port = open_port(self._port_name, self._baud, dtr=config.dtr, rts=config.rts, timeout_s=0.0)
        except (serial.SerialException, OSError, ValueError) as error:
            self._lost(f"{self._port_name}: {_plain(error)}")
            return
        # A pseudo-terminal and many USB adapters have no low-latency mode, which only reduces the delay.
        with contextlib.suppress(ValueError, OSError, AttributeError):
            port.set_low_latency_mode(True)
        with self._changed:
            self._port, self._fd = port, port.fileno()
            self.opened = os.fstat(self._fd)
            # The kernel closes the port of a killed process. DTR stays high then, and a board that is reset by its edge
            # keeps its position until the next guard has lifted the stylus.
            before = hang_up(self._fd, False)
            self.hangs_up = before if self.hangs_up is None else self.hangs_up
            os.set_blocking(self._fd, False)
            self._poller.register(self._fd, select.POLLIN)
            self._writing = False
            self._pending.clear()
            self._machine.opened(self._now())
            self._changed.notify_all()

    def _turn(self) -> None:
        """Wait for bytes, a wake-up or a deadline, and do what is due."""
        with self._changed:
            now = self._now()
            wait_s = max(0.0, self._machine.deadline(now) - now)
        # The age of the heartbeat counts in wall time, also while simulated time is paused.
        readable = self._wait(min(wait_s, LONGEST_WAIT_S))
        try:
            data = self._read() if readable else b""
        except OSError as error:
            self._lost(f"{self._port_name}: {_plain(error)}")
            return
        with self._changed:
            now = self._now()
            self._read_bytes += len(data)
            if data:
                # The board may report the hold before the caller of stop() gets the lock; it is then not unrequested.
                self._take_stop(self._machine, now, hold_written=False)
                self._machine.receive(data, now)
            self._machine.tick(now)
            self._pending += self._machine.output(now)
            may_be_down = self._machine.may_be_down
            self._changed.notify_all()
        self._keep(may_be_down)
        try:
            self._write()
        except OSError as error:
            self._lost(f"{self._port_name}: {_plain(error)}")

    def _wait(self, seconds: float) -> bool:
        """Wait at most ``seconds``; return whether the port has bytes or has disappeared."""
        if self._fd >= 0 and self._writing is not bool(self._pending):
            self._writing = bool(self._pending)
            self._poller.modify(self._fd, select.POLLIN | (select.POLLOUT if self._writing else 0))
        ready = dict(self._poller.poll(1000.0 * seconds))
        if self._wake_pipe.read_fd in ready:
            self._wake_pipe.drain()
        self._wakes_seen = self._wakes
        return bool(ready.get(self._fd, 0) & ~select.POLLOUT)

    def _read(self) -> bytes:
        try:
            data = os.read(self._fd, 65536)
        except BlockingIOError:
            return b""
        # With VMIN = 0, as set, an empty answer alone would not mean that the device has disappeared.
        if not data:
            raise OSError(errno.EIO, Message("link.device_gone"))
        return data

    def _write(self) -> None:
        if self._pending:
            with contextlib.suppress(BlockingIOError):
                count = os.write(self._fd, self._pending)
                self._written_bytes += count
                del self._pending[:count]

    def _keep(self, may_be_down: bool) -> None:
        """Record whether the stylus may be down, before any byte is written that could lower it."""
        if may_be_down is self._recorded:
            return
        self._recorded = may_be_down
        try:
            self._record.write(may_be_down)
        except OSError as error:
            note = Note(level="error", text=f"the file of the stylus's state cannot be written: {_plain(error)}")
            self._on_events([note])

    def _lost(self, reason: str) -> None:
        self._close_port()
        with self._changed:
            self._machine.closed(reason, self._now())
            self._changed.notify_all()

    def _close_port(self) -> None:
        with self._changed:
            port, fd, self._port, self._fd = self._port, self._fd, None, -1
            self._pending.clear()
            if fd >= 0:
                self._poller.unregister(fd)
                if self.hangs_up:
                    hang_up(fd, True)
        if port is not None:
            with contextlib.suppress(OSError, serial.SerialException, termios.error):
                port.close()

    def _publish(self) -> None:
        with self._changed:
            events = self._machine.take_events()
        if events:
            self._on_events(events)
        if any(isinstance(event, CloseRequested) for event in events):
            self._close_port()  # last: Linux waits half a minute for a board that accepts no more bytes


def _plain(error: Exception) -> str:
    number = getattr(error, "errno", None)
    if number == errno.EAGAIN:  # another program has the lock
        return Message("guard.use_another_program_while_driver")
    return os.strerror(number) if number else str(error)
