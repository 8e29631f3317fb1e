"""The node's side of the guard: finds or starts it, asks it, and passes on what it says.

While there is no guard, a machine without a port answers in its place: it refuses what moves, and says why.
"""

from __future__ import annotations

import contextlib
import os
import select
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

from gantry_driver.adapters.guard.places import guard_path, peer_process, sample_threads
from gantry_driver.core.guard.commands import COMMANDS
from gantry_driver.core.guard.messages import (
    FrameError,
    FrameReader,
    config_values,
    event_of,
    frame,
    waypoint_values,
)
from gantry_driver.core.guard.silence import SilenceWatch
from gantry_driver.core.machine import Machine
from gantry_driver.core.machine_config import DriverConfig
from gantry_driver.core.machine_states import Answered, Event, Note, StateChanged
from gantry_driver.core.trajectory_gcode import Waypoint
from icu_common.adapters.real_time import steady_s
from icu_common.core.results import GoalResult, Outcome

BEAT_S = 0.02
"""Interval of the signs of life: five of them are within the shortest silence that stops the machine by default."""
ASK_S = 2.0
"""Seconds to wait for the guard's answer to a question."""
HUNG_S, LATE_S = 2.0, 10.0
"""Seconds without a sign of life of the guard, after which it is killed and started again: without an excuse, and with
the one that it waits for the processor."""
RETRY_S, LAST_RETRY_S = 0.02, 0.5
START_S = 5.0
"""Seconds in which a guard that was started must listen."""
WAY_OUT_S = 8.0
"""Seconds after ``hold_timeout_s`` in which a guard that is closed has lifted the stylus and ended."""
GUARD_ENDED = "the guard has ended"
NO_ANSWER = "the guard does not answer"
_SIGNALS = {int(number): number.name for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)}


class GuardLink:
    """Reaches the machine through its guard.

    Parameters
    ----------
    config
        Of the driver; its port names the guard.
    on_events
        Called in the thread of this link, or before :meth:`start` in the caller's, with what has happened, in order.
    stop_path
        Where the guard takes stops that pass the graph by.
    time_s
        The machine's time, 0 while it is not known; None for the steady clock, which the guard has itself.
    on_turn
        Called in order with ``on_events``: how many of the :meth:`step` calls the guard has dealt with, and how many
        bytes it has read and written.
    """

    def __init__(
        self,
        config: DriverConfig,
        on_events: Callable[[list[Event]], None],
        *,
        stop_path: Path,
        time_s: Callable[[], float] | None = None,
        on_turn: Callable[[int, int, int], None] | None = None,
    ) -> None:
        self._config, self._on_events, self._on_turn = config, on_events, on_turn
        self._stop_path, self._time_s = stop_path, time_s
        self._machine = Machine(config, active=False)
        self._lock = threading.RLock()
        """Of the machine without a port."""
        self._sending = threading.Lock()
        self._socket: socket.socket | None = None
        self._answered = threading.Condition()
        self._answers: dict[int, Any] = {}
        self._asked: set[int] = set()
        self._number = 0
        self._goal: GoalResult | None = None
        self._rivals: dict[str, str] = {}
        self._down = False
        self._steps = 0
        """Steps that the guard has not dealt with."""
        self._started: subprocess.Popen[bytes] | None = None
        self._started_at = -START_S
        self._closing = self._closed = False
        self._wake_read, self._wake_write = os.pipe()
        os.set_blocking(self._wake_read, False)
        os.set_blocking(self._wake_write, False)
        self._thread = threading.Thread(target=self._run, name="guard-link", daemon=True)
        self._say(self._machine.take_events())

    # --- what the node does ------------------------------------------------------------------------------------------

    def start(self) -> None:
        """Find or start the guard, which opens the port."""
        self._thread.start()

    @property
    def alive(self) -> bool:
        """Whether the thread that hears the guard runs."""
        return self._thread.is_alive()

    @property
    def wakeup_fd(self) -> int:
        """For ``signal.set_wakeup_fd``: SIGINT, SIGTERM and SIGHUP then stop the machine at once."""
        return self._wake_write

    def ask(self, name: str, **values: Any) -> Any:
        """Return what a command of ``core.guard.commands`` answers; a refusal is a text."""
        with self._lock:
            if self._socket is None or name in ("enable", "activate", "configure"):
                value = COMMANDS[name](self._machine, steady_s(), values)
                events = self._machine.take_events()
                if self._socket is None:
                    self._say(events)
                    return value
        return self._ask_guard(name, values)

    def tell(self, name: str, **values: Any) -> None:
        """Give a command whose answer does not matter."""
        self._send({"do": name, **values})

    def rivals(self, topic: str, text: str) -> None:
        """Say which programs publish a topic that only one may, empty for one alone; each guard is told again."""
        self._rivals[topic] = text
        if text:
            self.stop(text)
        self.ask("rivals", topic=topic, text=text)

    def run(self, goal_id: str, names: list[str], points: list[Waypoint], **values: Any) -> None:
        """Start a trajectory with the ``values`` of :meth:`Machine.run`; the answers are events."""
        try:
            answer = self.ask("run", goal_id=goal_id, names=names, points=waypoint_values(points), **values)
            if answer == NO_ANSWER:
                raise FrameError(NO_ANSWER)
        except FrameError as error:
            text = f"{len(points)} points"
            self._say([Answered(result=_result(goal_id, text, Outcome.REJECTED, str(error)))])

    def stop(self, reason: str) -> None:
        """Stop the machine: the guard writes a hold past all queues."""
        self._send({"do": "stop", "reason": reason})

    def step(self, now_s: float) -> bool:
        """Pass a new time on; return whether the guard will count it."""
        with self._sending:
            if self._socket is None:
                return False
            self._steps += 1
        self._send({"do": "step", "time_s": now_s})
        return True

    def close(self, reason: str) -> None:
        """Let the guard bring the machine to rest with the stylus up, close the port, and end."""
        if self._closed:
            return
        self._closed = True
        self._send({"do": "close", "reason": reason})
        self._closing = True
        self._wake()
        if self._thread.ident is not None:
            within_s = self._config.hold_timeout_s + WAY_OUT_S
            self._thread.join(within_s)
            if self.alive:
                text = (
                    f"closed {within_s:g} s after the stop: what the machine does is not known, the stylus may be down"
                )
                self._say([Note(level="error", text=text)])
        self._drop()
        self._count(self._steps, 0, 0)
        if self._started is not None:
            with contextlib.suppress(subprocess.TimeoutExpired):
                self._started.wait(ASK_S)
        write, self._wake_write = self._wake_write, -1
        if not self.alive:
            os.close(write)
            os.close(self._wake_read)

    # --- the thread --------------------------------------------------------------------------------------------------

    def _run(self) -> None:
        retry_s = RETRY_S
        while not self._closing:
            try:
                reason = self._serve()
                retry_s = RETRY_S
            except (OSError, FrameError, KeyError, TypeError, ValueError) as error:
                reason = "" if isinstance(error, (FileNotFoundError, ConnectionRefusedError)) else f"the guard: {error}"
                retry_s = min(2.0 * retry_s, LAST_RETRY_S) if reason else RETRY_S
            self._lost(reason)
            self._wait(retry_s)

    def _serve(self) -> str:
        """Connect, and serve the connection until it ends; return why it has."""
        connection = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        try:
            connection.settimeout(2.0 * LATE_S)  # a guard that hangs is killed before that
            try:
                connection.connect(bytes(guard_path(self._config.port)))
            except (FileNotFoundError, ConnectionRefusedError):
                self._start_guard()
                raise
            self._begin(connection)
            return self._listen(connection)
        finally:
            self._drop()
            connection.close()

    def _begin(self, connection: socket.socket) -> None:
        with self._lock:
            machine = self._machine
            hello = {
                "do": "hello",
                "config": config_values(machine.config),
                "time_s": None if self._time_s is None else self._time_s(),
                "stop_path": str(self._stop_path),
                "enabled": machine.enabled,
                "active": machine.active,
                "left_down": self._down,
            }
            rivals = [frame({"do": "rivals", "topic": topic, "text": text}) for topic, text in self._rivals.items()]
            with contextlib.suppress(BrokenPipeError):  # a guard that refuses has closed already, and said why
                connection.sendall(frame(hello) + b"".join(rivals))
            self._socket = connection

    def _listen(self, connection: socket.socket) -> str:
        reader, beat_at, guard = FrameReader(), 0.0, peer_process(connection)
        watch = SilenceWatch(HUNG_S, steady_s(), LATE_S)
        poller = select.poll()
        poller.register(connection, select.POLLIN)
        poller.register(self._wake_read, select.POLLIN)
        while True:
            now = steady_s()
            if not self._closing and now >= beat_at:
                beat_at = now + BEAT_S
                self._beat()
            ready = dict(poller.poll(1000.0 * max(0.0, beat_at - now) if not self._closing else 100.0))
            if self._wake_read in ready:
                self._woken()
            if connection.fileno() in ready:
                data = _received(connection)
                if not data:
                    return GUARD_ENDED
                watch.beat(steady_s())
                for message in reader.feed(data):
                    if (reason := self._on_message(message)) is not None:
                        return reason
            elif watch.look(steady_s(), sample_threads(guard) if watch.wants_sample else None) and not self._closing:
                with contextlib.suppress(OSError):
                    os.kill(guard, signal.SIGKILL)
                return "the guard hangs, it is started again"

    def _on_message(self, message: dict[str, Any]) -> str | None:
        """Deal with a message; return why the connection ends, None where it goes on."""
        if "events" in message:
            self._down = bool(message["down"])
            if events := [event_of(values) for values in message["events"]]:
                self._note_goal(events)
                self._say(events)
        elif "turn" in message:
            self._count(*message["turn"])
        elif "id" in message:
            with self._answered:
                if message["id"] in self._asked:
                    self._answers[message["id"]] = message["value"]
                    self._answered.notify_all()
        elif "refused" in message:
            return f"{self._config.port}: {message['refused']}"
        elif "closed" in message:
            return ""
        return None

    def _note_goal(self, events: list[Event]) -> None:
        for event in events:
            if isinstance(event, Answered) and event.result.outcome is Outcome.ACCEPTED:
                self._goal = event.result
            elif isinstance(event, Answered) and self._goal and event.result.goal_id == self._goal.goal_id:
                self._goal = None if event.result.outcome is not Outcome.REJECTED else self._goal

    def _lost(self, reason: str) -> None:
        """Say that there is no guard; what was under way is aborted."""
        events: list[Event] = []
        steps = self._steps
        if goal := self._goal:
            self._goal = None
            events.append(Answered(result=_result(goal.goal_id, goal.goal, Outcome.ABORTED, f"link lost: {reason}")))
        if reason and not self._closing:
            with self._lock:
                before = self._machine
                self._machine = Machine(before.config, active=before.active, left_down=self._down)
                self._machine.enabled = before.config.enabled_at_start
                self._machine.closed(reason, steady_s())
                self._machine.take_events()
                events.append(StateChanged(text=self._machine.state_text))
        self._say(events)
        self._count(steps, 0, 0)
        with self._answered:
            self._answered.notify_all()

    def _start_guard(self) -> None:
        """Start a guard, unless one is on its way."""
        if self._started is not None and self._started.poll() is None and steady_s() - self._started_at < START_S:
            return
        self._started_at = steady_s()
        path = guard_path(self._config.port)
        command = [sys.executable, "-m", "gantry_driver.cli.gantry_guard", "--socket", str(path)]
        environment = {**os.environ, "PYTHONPATH": os.pathsep.join(part for part in sys.path if part)}
        with path.with_name(f"{path.name}.log").open("wb") as log:
            # A session of its own: a terminal's Ctrl-C ends the node, which closes the guard in order. No pipe of this
            # process stays open in it, so that nobody waits for the output of a node that has ended.
            self._started = subprocess.Popen(
                command,
                env=environment,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=log,
                start_new_session=True,
            )

    # --- small parts -------------------------------------------------------------------------------------------------

    def _ask_guard(self, name: str, values: dict[str, Any]) -> Any:
        with self._answered:
            self._number += 1
            number = self._number
            self._asked.add(number)
        connection = self._socket
        self._send({"do": name, "id": number, **values})
        with self._answered:
            self._answered.wait_for(lambda: number in self._answers or self._socket is not connection, ASK_S)
            self._asked.discard(number)
            return self._answers.pop(number, NO_ANSWER)

    def _send(self, message: dict[str, Any]) -> None:
        data = frame(message)
        with self._sending:
            connection = self._socket
            if connection is None:
                return
            try:
                connection.sendall(data)
            except OSError:  # also half a frame that the guard did not take in time
                with contextlib.suppress(OSError):
                    connection.shutdown(socket.SHUT_RDWR)

    def _beat(self) -> None:
        """Send a sign of life, unless the guard reads nothing: whether it hangs is judged by what it sends."""
        data = frame({"do": "beat"})
        if not self._sending.acquire(blocking=False):
            return  # something else is being sent, which is a sign of life as well
        try:
            # Python's own send waits for as long as the socket's time-out, although its descriptor blocks nobody.
            if self._socket is not None and (count := os.write(self._socket.fileno(), data)) < len(data):
                self._socket.sendall(data[count:])
        except OSError:
            pass
        finally:
            self._sending.release()

    def _say(self, events: list[Event]) -> None:
        if events:
            self._on_events(events)

    def _count(self, steps: int, read: int, written: int) -> None:
        with self._sending:
            self._steps -= steps
        if self._on_turn is not None and (steps or read or written):
            self._on_turn(steps, read, written)

    def _drop(self) -> None:
        with self._sending:
            self._socket = None

    def _wake(self) -> None:
        with contextlib.suppress(BlockingIOError, OSError):
            os.write(self._wake_write, b"\0")

    def _woken(self) -> None:
        for number in set(os.read(self._wake_read, 4096)) & _SIGNALS.keys():
            self.stop(_SIGNALS[number])

    def _wait(self, seconds: float) -> None:
        if not self._closing and select.select([self._wake_read], [], [], seconds)[0]:
            self._woken()


def _received(connection: socket.socket) -> bytes:
    """Return what has come, nothing where the other side has gone; a killed one leaves what it has not read."""
    try:
        return connection.recv(1024 * 1024)
    except ConnectionResetError:
        return b""


def _result(goal_id: str, goal: str, outcome: Outcome, reason: str) -> GoalResult:
    return GoalResult(goal_id=goal_id, goal=goal, outcome=outcome, reason=reason)
