"""The guard: owns the serial port, serves one node, and stops the machine when that node has ended or is silent."""

from __future__ import annotations

import contextlib
import select
import socket
import threading
from collections import deque
from pathlib import Path
from typing import Any

from gantry_driver.adapters.guard.clock import GuardClock, counts_of_environment
from gantry_driver.adapters.guard.places import guard_path, peer_process, sample_threads, stylus_path
from gantry_driver.adapters.guard.port_record import PortRecord, device_identity, record_path, write_record
from gantry_driver.adapters.serial_link import SerialLink
from gantry_driver.adapters.stylus_record import StylusRecord
from gantry_driver.core.configuration.machine_config import DriverConfig
from gantry_driver.core.guard.commands import COMMANDS
from gantry_driver.core.guard.messages import FrameError, FrameReader, config_of, event_values, frame
from gantry_driver.core.guard.silence import SilenceWatch
from gantry_driver.core.machine.machine import Machine
from gantry_driver.core.states.machine_states import Event, Note, Position, StateChanged
from gantry_driver.core.states.reasons import Reason, why_of
from icu_common.adapters.direct_stop.line import open_stop_socket, received_stop
from icu_common.adapters.real_time import steady_s
from icu_common.core.configuration.config import settings_of
from icu_common.core.reasons.codes import DriverCode
from icu_common.core.reasons.message import Message, decoded, encoded, quoted

PULSE_S = 0.1
"""Interval of the guard's own signs of life."""
LOOK_INTERVAL_S = 0.02
"""Interval of the checks of the node's silence."""
LINGER_S = 10.0
"""Seconds for which the guard keeps the port and the state for the next node."""
KEPT_EVENTS = 64
"""Maximum number of answers and notes kept for the next node."""
UNSENT_BYTES = 1024 * 1024
"""Maximum number of unsent bytes; a node that does not read is disconnected beyond it."""
FLOOD_FRAMES, FLOOD_BYTES, FLOOD_S = 2000, 32 * 1024 * 1024, 0.5
"""Maximum numbers of frames and of bytes from a node, and the seconds in which they are counted."""
IN_USE = Message("guard.use_another_program_while_driver")
ENDED = Message("guard.driver_node_ended")
FLOODS = Message("guard.driver_node_sends_too_much")


class Guard:
    """One guard on its socket.

    Parameters
    ----------
    listener
        Non-blocking socket on which a node connects.
    wakeup_fd
        Read end of a pipe that gets the numbers of signals; each signal ends the guard.
    stays
        Whether the guard keeps running while no node connects, and after the last one has ended.
    """

    def __init__(self, listener: socket.socket, wakeup_fd: int, *, stays: bool = False) -> None:
        self._listener, self._signals, self._stays = listener, wakeup_fd, stays
        self._clock = GuardClock(counts_of_environment())
        self._link: SerialLink | None = None
        self._machine: Machine | None = None
        self._stops: socket.socket | None = None
        self._stop_path: Path | None = None
        self._own_record: StylusRecord | None = None
        """Record in the guard's folder, if no ``stylus_file`` is configured."""
        self._record_path: Path | None = None
        self._recorded: PortRecord | None = None
        self._lock = threading.Lock()
        self._unsent = bytearray()
        self._kept: deque[Event] = deque(maxlen=KEPT_EVENTS)
        self._node: socket.socket | None = None
        self._node_process = 0
        self._reader = FrameReader()
        self._watch = SilenceWatch(1.0, steady_s())
        self._hung = False
        self._steps_counted = 0
        self._window_s, self._frames, self._bytes = 0.0, 0, 0
        self._alone_since = steady_s()
        self._ends = False
        self._pulse_at = 0.0

    def recover(self, record: PortRecord) -> None:
        """Open the port that a killed guard has left: hold a moving machine, lift the stylus, make no other motion."""
        self._clock.begin(0.0 if record.simulated else None)
        self._clock.leave()
        self._bind_stops(str(record.stop_path))
        self._make_link(record.config, enabled=False, active=True, left_by=record)

    def run(self) -> None:
        """Serve until a node or a signal ends the guard, or no node connects for ``LINGER_S``."""
        try:
            while not self._ends:
                poller = select.poll()
                for fd, what in self._descriptors().items():
                    poller.register(fd, what)
                self._turn(dict(poller.poll(1000.0 * LOOK_INTERVAL_S)))
        finally:
            self._close(Message("guard.guard_ending"))

    def _descriptors(self) -> dict[int, int]:
        watched = {self._listener.fileno(): select.POLLIN, self._signals: select.POLLIN}
        if self._stops is not None:
            watched[self._stops.fileno()] = select.POLLIN
        if self._node is not None:
            watched[self._node.fileno()] = select.POLLIN | (select.POLLOUT if self._unsent else 0)
        return watched

    def _turn(self, ready: dict[int, int]) -> None:
        if self._stops is not None and self._stops.fileno() in ready:  # before everything else
            while (text := received_stop(self._stops)) is not None:
                if self._link is not None:
                    self._link.stop(Reason(code=DriverCode.STOP_REQUESTED, text=text) if text else text)
        if self._signals in ready:
            self._ends = True
        if self._node is not None and self._node.fileno() in ready:
            self._read()
            self._send(b"")
        if self._listener.fileno() in ready:
            self._accept()
        self._look()

    # --- the node ----------------------------------------------------------------------------------------------------

    def _accept(self) -> None:
        try:
            connection, _ = self._listener.accept()
        except BlockingIOError:
            return
        if self._node is not None and not self._hung:
            with contextlib.suppress(OSError), connection:
                connection.send(frame({"refused": IN_USE}))
            return
        if self._node is not None:
            self._lose(ENDED)
        connection.setblocking(False)
        self._node, self._node_process = connection, peer_process(connection)
        self._reader, self._hung = FrameReader(), False
        self._watch.beat(steady_s())

    def _read(self) -> None:
        node = self._node
        assert node is not None
        try:
            data = node.recv(1024 * 1024)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        if not data:
            self._lose(ENDED)
            return
        now = steady_s()
        self._watch.beat(now)
        if self._hung:
            self._hung = False
            self._clock.rejoin()
        if now - self._window_s > FLOOD_S:
            self._window_s, self._frames, self._bytes = now, 0, 0
        self._bytes += len(data)
        try:
            for message in self._reader.feed(data):
                self._frames += 1
                if self._frames > FLOOD_FRAMES or self._bytes > FLOOD_BYTES:
                    self._lose(FLOODS)
                    return
                self._on_message(message)
        except Exception as error:
            # No message of a node may end the guard.
            self._lose(Message("guard.driver_node_sent_unreadable_message", error=quoted(error)))

    def _on_message(self, message: dict[str, Any]) -> None:
        name = message["do"]
        if name == "beat":
            return
        message |= {key: decoded(message[key]) for key in ("reason", "text", "distrust") if key in message}
        if name == "hello":
            self._hello(message)
        elif self._link is None:
            raise FrameError(Message("guard.before_hello", name=quoted(name)))
        elif name == "stop":
            self._link.stop(why_of(str(message["reason"]), str(message.get("code", ""))))
        elif name == "step":
            self._clock.tell(message["time_s"])
            self._link.wake()
        elif name == "close":
            self._close(str(message["reason"]))
            self._ends = not self._stays
            if self._ends:
                self._listener.close()  # a node that connects now finds no guard and starts one
            self._send(frame({"closed": True}))
        else:
            action = COMMANDS[name]
            value = self._link.call(lambda machine, now: action(machine, now, message))
            if name == "configure":
                self._watch.limit_s = message["config"]["node_silence_s"]
            if "id" in message:
                self._send(frame({"id": message["id"], "value": encoded(value)}))

    def _hello(self, message: dict[str, Any]) -> None:
        config = config_of(message["config"])
        self._watch = SilenceWatch(config.node_silence_s, steady_s())
        self._clock.begin(message["time_s"])
        self._bind_stops(message["stop_path"])
        link, machine = self._link, self._machine
        if link is not None and machine is not None and _fixed(config) != _fixed(machine.config):
            self._close_link(link, Message("guard.another_configuration"))
            link = machine = None
        if link is None or machine is None:
            enabled, active, left_down = message["enabled"], message["active"], bool(message["left_down"])
            self._make_link(config, enabled=enabled, active=active, left_down=left_down)
            return
        with self._lock:
            kept, self._kept = list(self._kept), deque(maxlen=KEPT_EVENTS)
        link.call(lambda machine, now: machine.configure(config, now))
        link.call(lambda machine, now: machine.enable(message["enabled"], now))
        link.call(lambda machine, now: machine.activate(message["active"], now))
        # Under the machine's lock, so that no older state is sent after it.
        link.call(lambda machine, now: self._send(self._frame_of(kept + _snapshot(machine))))

    def _make_link(
        self,
        config: DriverConfig,
        *,
        enabled: bool,
        active: bool,
        left_down: bool = False,
        left_by: PortRecord | None = None,
    ) -> None:
        record = StylusRecord(Path(config.stylus_file).expanduser() if config.stylus_file else stylus_path(config.port))
        self._own_record = None if config.stylus_file else record
        machine = Machine(config, active=active, left_down=left_down or record.may_be_down())
        machine.enabled, machine.left_moving = enabled, left_by is not None
        self._steps_counted = 0
        link = SerialLink(
            machine,
            config.port,
            config.baud,
            self._on_events,
            clock=self._clock,
            on_turn=self._on_turn,
            record=record,
            hangs_up=None if left_by is None else left_by.hangs_up,
        )
        self._machine, self._link = machine, link
        self._record_path, self._recorded = record_path(guard_path(config.port)), None
        link.start()

    def _keep_record(self) -> None:
        """Write the record for the next guard whenever the device or the configuration has changed."""
        link, machine, path, stop_path = self._link, self._machine, self._record_path, self._stop_path
        if link is None or machine is None or path is None or stop_path is None or link.opened is None:
            return
        record = PortRecord(
            config=machine.config,
            device=device_identity(link.opened),
            stop_path=stop_path,
            simulated=self._clock.simulated,
            hangs_up=bool(link.hangs_up),
        )
        if record == self._recorded:
            return
        self._recorded = record
        try:
            write_record(path, record)
        except OSError as error:
            self._on_events([Note(level="error", text=f"the record of the open port cannot be written: {error}")])

    def _bind_stops(self, path: str) -> None:
        if self._stops is not None and self._stop_path == Path(path):
            return
        if self._stops is not None:
            self._stops.close()
        self._stop_path = Path(path)
        self._stops = open_stop_socket(self._stop_path)

    def _lose(self, reason: str) -> None:
        """Disconnect the node; stop the machine if it moves or presses."""
        with self._lock:
            node, self._node = self._node, None
            assert node is not None
            node.close()
            self._unsent.clear()
        self._clock.leave()
        self._alone_since = steady_s()
        self._stop_if_restless(reason)

    def _stop_if_restless(self, reason: str) -> None:
        if self._link is not None and self._machine is not None and self._machine.moves_or_presses:
            self._link.stop(reason)

    def _look(self) -> None:
        now = steady_s()
        if self._link is not None and not self._link.alive:
            self._ends = True  # the node then starts a new guard, which lifts first
        self._keep_record()
        if self._clock.wants_turns and self._link is not None:
            self._link.wake()
            self._steps_counted = self._link.wakes  # no node waits for these
        if self._node is None:
            late = now - self._alone_since > LINGER_S and not self._stays
            if late and (self._machine is None or self._machine.at_rest):
                self._ends = True
            return
        if now - self._pulse_at >= PULSE_S:
            self._pulse_at = now
            self._send(self._frame_of([]))
        threads = sample_threads(self._node_process) if self._watch.wants_sample and not self._hung else None
        if self._watch.look(now, threads) and not self._hung:
            self._hung = True
            self._clock.leave()
            self._stop_if_restless(Message("guard.driver_node_silent", silent_s=self._watch.silent_s))

    # --- to the node, from any thread --------------------------------------------------------------------------------

    def _on_events(self, events: list[Event]) -> None:
        lasting = [event for event in events if not isinstance(event, (Position, StateChanged))]
        if self._node is None:
            with self._lock:
                self._kept.extend(lasting)
            return
        self._send(self._frame_of(events))

    def _frame_of(self, events: list[Event]) -> bytes:
        down = self._machine is not None and self._machine.may_be_down
        return frame({"events": [event_values(event) for event in events], "down": down})

    def _on_turn(self, wakes: int, read: int, written: int) -> None:
        steps = max(0, wakes - self._steps_counted)
        self._steps_counted = max(self._steps_counted, wakes)
        if self._clock.count_alone(read, written):
            read = written = 0
        if self._node is not None and (steps or read or written):
            self._send(frame({"turn": [steps, read, written]}))

    def _send(self, data: bytes) -> None:
        """Send as much as the socket accepts and keep the rest; a node that does not read is disconnected."""
        with self._lock:
            node = self._node
            if node is None:
                return
            self._unsent += data
            try:
                while self._unsent:
                    del self._unsent[: node.send(self._unsent)]
            except BlockingIOError:
                pass
            except OSError:
                self._unsent.clear()  # the main loop reads the end of the connection
            if len(self._unsent) > UNSENT_BYTES:
                with contextlib.suppress(OSError):
                    node.shutdown(socket.SHUT_RDWR)
                self._unsent.clear()

    def _close_link(self, link: SerialLink, reason: str) -> None:
        """Close a link; no step of a node is read meanwhile, and the machine needs time to stop and to lift."""
        self._clock.leave()
        link.close(reason)
        self._clock.rejoin()

    def _close(self, reason: str) -> None:
        link, self._link, self._machine = self._link, None, None
        if link is not None:
            in_order = link.alive
            self._close_link(link, reason)
            if in_order and self._record_path is not None:
                self._record_path.unlink(missing_ok=True)
        if self._own_record is not None:
            self._own_record.remove_if_up()
        if self._stops is not None and self._stop_path is not None:
            self._stops.close()
            self._stops = None
            with contextlib.suppress(OSError):
                self._stop_path.unlink()


def _fixed(config: DriverConfig) -> list[object]:
    """Return the configuration values that cannot change while a link exists."""

    def value(name: str) -> object:
        found: object = config
        for part in name.split("."):
            found = getattr(found, part)
        return found

    return [value(item.name) for item in settings_of(DriverConfig) if item.setting.read_only]


def _snapshot(machine: Machine) -> list[Event]:
    """Return the events that report the machine's state to a new node."""
    events: list[Event] = [StateChanged(text=machine.state_text, codes=machine.codes())]
    if machine.reading_m is not None:
        events.append(Position(reading_m=machine.reading_m, probe=machine.probe))
    return events
