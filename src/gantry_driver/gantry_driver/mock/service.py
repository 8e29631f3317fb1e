"""Runs a mock machine in real time: port, truth socket, control socket and log with one selector.

Truth socket: a line ``{"t": s on the monotonic clock, "mpos": [x, y, z] mm of the motors in the frame of a homed board,
"spindle": rpm, "coolant": bool, "state": as in the report, or Off}``, 200 per second while moving, else 20.

A stepped board has no clock: its time advances to the time that a client of the truth socket sends, ``{"until": s}``.
The client receives the samples up to that time, with board seconds as ``t``. Then it receives ``{"until": s, "sent": n,
"received": n}`` with the numbers of bytes that have passed the serial port since the start.

A line ``{"probe": true or false}`` on the truth socket connects the probe input with ground or disconnects it, until
its sender disconnects. A simulated switch in the stylus uses this.

Control socket: one JSON object per line, each answered by one line with ``ok`` and, if rejected, ``error``:
``{"do": "state"}``, ``{"do": "counters"}``, ``{"do": "log", "since": N, "kind": "line"}`` (both optional; kinds: rx,
realtime, line, alarm, eeprom, banner, fault, opened, power_on, power_off), ``{"do": "fault", "kind": K, ...}`` with the
faults and arguments of :data:`gantry_driver.mock.machine.FAULTS`. Times in answers are board seconds.
"""

from __future__ import annotations

import contextlib
import json
import os
import selectors
import socket
import time
from pathlib import Path
from typing import Any, TextIO

from gantry_driver.mock.journal import Entry
from gantry_driver.mock.line_socket import LineServer
from gantry_driver.mock.machine import FaultError, MockMachine, PortFault
from gantry_driver.mock.pty_port import OPEN_POLL_S, PtyPort

TRUTH_MOVING_S, TRUTH_REST_S = 0.005, 0.05
MAX_LOG_ENTRIES = 2000
MAX_WAIT_S = 3600.0
"""Maximum wait in seconds: a selector does not accept the duration of the slowest moves."""


class Service:
    """The mock board in a process; :meth:`run` returns after :meth:`stop`."""

    def __init__(
        self,
        machine: MockMachine,
        *,
        link: Path | None = None,
        time_scale: float = 1.0,
        truth_socket: Path | None = None,
        control_socket: Path | None = None,
        log: TextIO | None = None,
        reset_on_open: bool = True,
        stepped: bool = False,
    ) -> None:
        if stepped and truth_socket is None:
            raise ValueError("a stepped board needs a truth socket, whose client advances its time")
        self.machine = machine
        self._board = machine.board
        self._scale = time_scale
        self._reset_on_open = reset_on_open
        self._stopping = False
        self._start_s = time.monotonic()
        self._stepped, self._until_s = stepped, 0.0
        self._sent = self._received_count = 0
        self._fault_ends_s: dict[str, float] = {}
        self._truth_s = 0.0
        self._was_moving = False
        self._probe_wire: socket.socket | None = None
        self._log = log
        self._log_dirty = False
        if log is not None:
            self._board.journal.sink = self._log_entry
        with contextlib.ExitStack() as stack:  # a failure closes everything that was opened before
            self._selector = stack.enter_context(selectors.DefaultSelector())
            self._wake_read, self._wake_write = socket.socketpair()
            for end in (self._wake_read, self._wake_write):
                stack.callback(end.close)
                end.setblocking(False)
            self._selector.register(self._wake_read, selectors.EVENT_READ, self._woken)
            self._truth = self._serve(truth_socket, stack)
            self._control = self._serve(control_socket, stack)
            self.port = PtyPort(self._selector, link, self._received, self._opened)
            stack.callback(self.port.unplug)
            self._closing = stack.pop_all()
        self._board.power_on(self._now())

    def _serve(self, path: Path | None, stack: contextlib.ExitStack) -> LineServer | None:
        if path is None:
            return None
        server = LineServer(path, self._selector)
        stack.callback(server.close)
        return server

    @property
    def wakeup_fd(self) -> int:
        """Descriptor for ``signal.set_wakeup_fd``, because a signal just before the wait does not interrupt it."""
        return self._wake_write.fileno()

    def stop(self) -> None:
        """Make :meth:`run` return; may be called from a signal handler or another thread."""
        self._stopping = True
        with contextlib.suppress(BlockingIOError, OSError):  # already full of wake-ups, or closed
            self._wake_write.send(b"\0")

    def run(self) -> None:
        """Serve until stopped, then close everything."""
        with self._closing:
            while not self._stopping:
                self._turn()

    def _now(self) -> float:
        """Return the board's time in seconds."""
        if self._stepped:
            return self._until_s
        return (time.monotonic() - self._start_s) * self._scale

    def _turn(self) -> None:
        for key, _ in self._selector.select(self._timeout()):
            if key.fileobj in self._selector.get_map():  # an earlier callback may have closed it
                key.data()
        self._end_faults()
        self.port.poll()
        if self._control is not None:
            for client, line in self._control.lines():
                self._control.send(client, json.dumps(self._command(line)).encode() + b"\n")
        self._take_requests()
        self._board.advance(self._now())
        self._send_output()
        if not self._stepped:
            self._tell_truth()
        if self._log is not None and self._log_dirty:
            self._log.flush()
            self._log_dirty = False

    def _send_output(self) -> None:
        data = b"".join(self._board.take_output())
        if data:
            dropped = self.port.write(data)
            self._sent += len(data) - dropped
            self._board.journal.count("bytes_unread", dropped)

    def _take_requests(self) -> None:
        """Carry out the requests on the truth socket: advance (a stepped board), set the probe input."""
        if self._truth is None:
            return
        for client, line in self._truth.lines():
            try:
                request = json.loads(line)
                if isinstance(request, dict) and isinstance(request.get("probe"), bool):
                    self._board.advance(self._now())
                    self._board.set_probe(request["probe"])
                    self._probe_wire = client if request["probe"] else None
                elif self._stepped:
                    self._advance_to(float(request["until"]), client)
            except (ValueError, KeyError, TypeError, RecursionError):
                continue
        if self._probe_wire is not None and not self._truth.connected(self._probe_wire):
            self._board.advance(self._now())
            self._board.set_probe(False)
            self._probe_wire = None

    def _advance_to(self, until_s: float, client: socket.socket) -> None:
        assert self._truth is not None
        self.port.drain()
        while self._board.now < until_s - 1e-9:
            period = TRUTH_MOVING_S if self._board.moving() else TRUTH_REST_S
            self._until_s = min(self._board.now + period, until_s)
            self._end_faults()
            self._board.advance(self._until_s)
            sample = json.dumps({"t": self._board.now, **self.machine.truth()})
            self._truth.send(client, sample.encode() + b"\n")
        self._send_output()
        answer = {"until": until_s, "sent": self._sent, "received": self._received_count}
        self._truth.send(client, json.dumps(answer).encode() + b"\n")

    def _timeout(self) -> float | None:
        now = time.monotonic()
        times = []
        if self.port.waiting:
            times.append(now + OPEN_POLL_S)
        if self._stepped:
            return min(times) - now if times else None
        due = self._board.next_due()
        if due is not None:
            times.append(self._start_s + due / self._scale)
        if self._truth is not None and self._truth.client_count:
            times.append(self._truth_s + (TRUTH_MOVING_S if self._board.moving() else TRUTH_REST_S))
        times.extend(self._start_s + end / self._scale for end in self._fault_ends_s.values())
        return min(max(min(times) - now, 0.0), MAX_WAIT_S) if times else None

    def _woken(self) -> None:
        self._wake_read.recv(4096)

    def _received(self, data: bytes) -> None:
        self._received_count += len(data)
        self._board.receive(data, self._now())

    def _opened(self) -> None:
        self._board.journal.note(self._board.now, "opened")
        if self._reset_on_open and self.port.dtr_rose:
            self._board.power_on(self._now())  # the edge of DTR resets an Arduino

    def _tell_truth(self) -> None:
        if self._truth is None or not self._truth.client_count:
            return
        now, moving = time.monotonic(), self._board.moving()
        period = TRUTH_MOVING_S if moving or self._was_moving else TRUTH_REST_S
        if now - self._truth_s < period - 0.0005 and moving == self._was_moving:
            return
        self._truth_s, self._was_moving = now, moving
        sampled = self._start_s + self._board.now / self._scale
        self._truth.broadcast(json.dumps({"t": sampled, **self.machine.truth()}).encode() + b"\n")

    def _command(self, line: bytes) -> dict[str, Any]:
        """Answer one line of the control socket; ``do`` is state, counters, log or fault."""
        try:
            request = json.loads(line)
        except (ValueError, RecursionError) as error:
            return {"ok": False, "error": f"not JSON: {error}"}
        if not isinstance(request, dict):
            return {"ok": False, "error": "a JSON object is needed"}
        board = self._board
        board.advance(self._now())
        what = request.pop("do", None)
        if what == "state":
            port = str(self.port.path) if self.port.plugged else None
            counters = board.motion.position(board.now)
            truth = self.machine.truth()
            return {"ok": True, "t": board.now, "port": port, "open": self.port.is_open, "steps": counters, **truth}
        if what == "counters":
            return {"ok": True, "t": board.now, "counters": dict(board.journal.counts)}
        if what == "log":
            since, kind = request.get("since", 0), request.get("kind")
            if not isinstance(since, int):
                return {"ok": False, "error": f"since = {since!r}; expected a whole number"}
            return {"ok": True, "entries": board.journal.since(since, kind)[:MAX_LOG_ENTRIES]}
        if what == "fault":
            kind = request.pop("kind", "")
            try:
                port_fault = self.machine.inject(str(kind), request)
            except FaultError as error:
                return {"ok": False, "error": str(error)}
            if port_fault is not None:
                self._begin_fault(port_fault)
            return {"ok": True, "t": board.now}
        return {"ok": False, "error": f"do = {what!r} is none of state, counters, log, fault"}

    def _begin_fault(self, fault: PortFault) -> None:
        if fault.kind == "unplug":
            self._board.power_off(self._now())
            self.port.unplug()
        else:
            self.port.set_reading(False)
        self._fault_ends_s[fault.kind] = self._now() + fault.seconds

    def _end_faults(self) -> None:
        now = self._now()
        for kind in [kind for kind, end in self._fault_ends_s.items() if end <= now]:
            del self._fault_ends_s[kind]
            if kind == "unplug":
                self.port.plug()
                self._board.power_on(self._now())
            else:
                self.port.set_reading(True)

    def _log_entry(self, entry: Entry) -> None:
        assert self._log is not None
        self._log.write(json.dumps(entry) + os.linesep)
        self._log_dirty = True
