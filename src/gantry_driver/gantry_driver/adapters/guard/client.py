"""The node's side of the guard: finds or starts the guard, sends it commands, and passes on its events.

Without a guard, a machine without a port answers in its place: it rejects every motion and gives the reason.
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

from gantry_driver.adapters.guard.places import guard_path, peer_process, received, sample_threads
from gantry_driver.adapters.wake_pipe import WakePipe
from gantry_driver.core.configuration.machine_config import DriverConfig
from gantry_driver.core.grbl.trajectory_gcode import Waypoint
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
from gantry_driver.core.machine.machine import Machine
from gantry_driver.core.states.machine_states import Answered, Event, Note, StateChanged
from gantry_driver.core.states.reasons import Why, code_of
from icu_common.adapters.real_time import steady_s
from icu_common.core.goals.results import GoalResult, Outcome
from icu_common.core.reasons.message import Message, decoded

BEAT_S = 0.02
"""Interval of the signs of life: a fifth of the default silence that stops the machine."""
ASK_S = 2.0
"""Maximum seconds to wait for the guard's answer to a request."""
HUNG_S, HUNG_DOWN_S, LATE_S = 2.0, 0.8, 10.0
"""Seconds of silence after which a guard is killed: if it could run; with the stylus down; if it waits for a core."""
RETRY_S, LAST_RETRY_S = 0.02, 0.5
START_S = 5.0
"""Maximum seconds from the start of a guard until it listens."""
WAY_OUT_S = 8.0
"""Maximum seconds after ``hold_timeout_s`` for a closed guard to lift the stylus and end."""
GUARD_ENDED = Message("guard.guard_ended")
NO_ANSWER = Message("guard.guard_not_answer")
_ABSENT = (FileNotFoundError, ConnectionRefusedError)


class GuardLink:
    """Reaches the machine through its guard.

    Parameters
    ----------
    config
        The driver's configuration; its port identifies the guard.
    on_events
        Called with the machine's events in order, in the thread of this link (before :meth:`start`: in the caller's).
    stop_path
        Path of the socket on which the guard receives stops that bypass the graph.
    time_s
        Returns the machine's time, 0 while it is unknown; None for the steady clock, which the guard reads itself.
    on_turn
        Called in order with ``on_events``: the numbers of :meth:`step` calls that the guard has processed, and of bytes
        that it has read and written.
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
        """The machine without a port."""
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
        """Number of steps that the guard has not processed yet."""
        self._started: subprocess.Popen[bytes] | None = None
        self._started_at = -START_S
        self._closing = self._closed = False
        self._wake_pipe = WakePipe()
        self._thread = threading.Thread(target=self._run, name="guard-link", daemon=True)
        self._say(self._machine.take_events())

    # --- interface of the node ---------------------------------------------------------------------------------------

    def start(self) -> None:
        """Find or start the guard, which opens the port."""
        self._thread.start()

    @property
    def alive(self) -> bool:
        """Whether the thread that reads from the guard runs."""
        return self._thread.is_alive()

    @property
    def wakeup_fd(self) -> int:
        """Descriptor for ``signal.set_wakeup_fd``: SIGINT, SIGTERM and SIGHUP then stop the machine at once."""
        return self._wake_pipe.write_fd

    def ask(self, name: str, **values: Any) -> Any:
        """Return the answer to a command of ``core.guard.commands``; a refusal is a text."""
        with self._lock:
            if self._socket is None or name in ("enable", "activate", "configure"):
                value = COMMANDS[name](self._machine, steady_s(), values)
                events = self._machine.take_events()
                if self._socket is None:
                    self._say(events)
                    return value
        return self._ask_guard(name, values)

    def tell(self, name: str, **values: Any) -> None:
        """Send a command without waiting for an answer."""
        self._send({"do": name, **values})

    def rivals(self, topic: str, text: str) -> None:
        """Report the programs that publish a topic for one source (empty: only one); each new guard gets it too."""
        self._rivals[topic] = text
        if text:
            self.stop(text)
        self.ask("rivals", topic=topic, text=text)

    def run(self, goal_id: str, names: list[str], points: list[Waypoint], **values: Any) -> None:
        """Start a trajectory with the ``values`` of :meth:`Machine.run`; the answers are events."""
        try:
            refusal = self.ask("run", goal_id=goal_id, names=names, points=waypoint_values(points), **values)
            if refusal is not None:
                raise FrameError(str(refusal))
        except FrameError as error:
            text = Message("guard.points", points=len(points))
            self._say([Answered(result=_result(goal_id, text, Outcome.REJECTED, str(error)))])

    def stop(self, reason: Why) -> None:
        """Stop the machine: the guard writes a hold ahead of all queues."""
        self._send({"do": "stop", "reason": str(reason), "code": code_of(reason)})

    def step(self, now_s: float) -> bool:
        """Pass a new time to the guard; return whether the guard will count it."""
        with self._sending:
            if self._socket is None:
                return False
            self._steps += 1
        self._send({"do": "step", "time_s": now_s})
        return True

    def close(self, reason: str) -> None:
        """Make the guard bring the machine to rest with the stylus up, close the port, and end."""
        if self._closed:
            return
        self._closed = True
        self._send({"do": "close", "reason": reason})
        self._closing = True
        self._wake_pipe.wake()
        if self._thread.ident is not None:
            within_s = self._config.hold_timeout_s + WAY_OUT_S
            self._thread.join(within_s)
            if self.alive:
                text = Message("guard.closed_after_stop_machine_state", within_s=within_s)
                self._say([Note(level="error", text=text)])
        self._drop()
        self._count(self._steps, 0, 0)
        if self._started is not None:
            with contextlib.suppress(subprocess.TimeoutExpired):
                self._started.wait(ASK_S)
        if not self.alive:
            self._wake_pipe.close()

    # --- the thread --------------------------------------------------------------------------------------------------

    def _run(self) -> None:
        retry_s = RETRY_S
        while not self._closing:
            try:
                reason = self._serve()
                retry_s = RETRY_S
            except (OSError, FrameError, KeyError, TypeError, ValueError) as error:
                reason = "" if isinstance(error, _ABSENT) else Message("guard.guard", error=error)
                retry_s = min(2.0 * retry_s, LAST_RETRY_S) if reason else RETRY_S
            self._lost(reason)
            self._wait(retry_s)

    def _serve(self) -> str:
        """Connect, and serve the connection until it ends; return the reason for its end."""
        connection = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        try:
            connection.settimeout(2.0 * LATE_S)  # a guard that hangs is killed sooner
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
            with contextlib.suppress(BrokenPipeError):  # a guard that rejects has already closed, and sent the reason
                connection.sendall(frame(hello) + b"".join(rivals))
            self._socket = connection

    def _listen(self, connection: socket.socket) -> str:
        reader, beat_at, guard = FrameReader(), 0.0, peer_process(connection)
        watch = SilenceWatch(HUNG_S, steady_s(), LATE_S)
        poller = select.poll()
        poller.register(connection, select.POLLIN)
        poller.register(self._wake_pipe.read_fd, select.POLLIN)
        while True:
            now = steady_s()
            if not self._closing and now >= beat_at:
                beat_at = now + BEAT_S
                self._beat()
            ready = dict(poller.poll(1000.0 * max(0.0, beat_at - now) if not self._closing else 100.0))
            if self._wake_pipe.read_fd in ready:
                self._stop_by_signals()
            if connection.fileno() in ready:
                data = received(connection)
                if not data:
                    return GUARD_ENDED
                watch.beat(steady_s())
                for message in reader.feed(data):
                    if (reason := self._on_message(message)) is not None:
                        return reason
                watch.limit_s = HUNG_DOWN_S if self._down else HUNG_S
            elif watch.look(steady_s(), sample_threads(guard) if watch.wants_sample else None) and not self._closing:
                with contextlib.suppress(OSError):
                    os.kill(guard, signal.SIGKILL)
                return Message("guard.guard_hangs_restarted")

    def _on_message(self, message: dict[str, Any]) -> str | None:
        """Process a message; return the reason to end the connection, None to keep it."""
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
                    self._answers[message["id"]] = decoded(message["value"])
                    self._answered.notify_all()
        elif "refused" in message:
            return Message("text.more", first=self._config.port, second=decoded(message["refused"]))
        return "" if "closed" in message else None

    def _note_goal(self, events: list[Event]) -> None:
        for event in events:
            if isinstance(event, Answered) and event.result.outcome is Outcome.ACCEPTED:
                self._goal = event.result
            elif isinstance(event, Answered) and self._goal and event.result.goal_id == self._goal.goal_id:
                self._goal = None if event.result.outcome is not Outcome.REJECTED else self._goal

    def _lost(self, reason: str) -> None:
        """Report that there is no guard, and abort the goal in progress."""
        events: list[Event] = []
        steps = self._steps
        if goal := self._goal:
            self._goal = None
            text = Message("guard.link_lost", reason=reason)
            events.append(Answered(result=_result(goal.goal_id, goal.goal, Outcome.ABORTED, text)))
        if reason and not self._closing:
            with self._lock:
                before = self._machine
                self._machine = Machine(before.config, active=before.active, left_down=self._down)
                self._machine.enabled = before.config.enabled_at_start
                self._machine.closed(reason, steady_s())
                self._machine.take_events()
                events.append(StateChanged(text=self._machine.state_text, codes=self._machine.codes()))
        self._say(events)
        self._count(steps, 0, 0)
        with self._answered:
            self._answered.notify_all()

    def _start_guard(self) -> None:
        """Start a guard, unless one is starting."""
        if self._started is not None and self._started.poll() is None and steady_s() - self._started_at < START_S:
            return
        self._started_at = steady_s()
        path = guard_path(self._config.port)
        command = [sys.executable, "-m", "gantry_driver.cli.gantry_guard", "--socket", str(path)]
        environment = {**os.environ, "PYTHONPATH": os.pathsep.join(part for part in sys.path if part)}
        with path.with_name(f"{path.name}.log").open("wb") as log:
            # A separate session: a terminal's Ctrl-C ends the node, which closes the guard in order. The guard keeps
            # no pipe of this process open, so a reader of the node's output sees its end when the node ends.
            self._started = subprocess.Popen(
                command,
                env=environment,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=log,
                start_new_session=True,
            )

    # --- details -----------------------------------------------------------------------------------------------------

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
            except OSError:  # also after half a frame, if the guard does not read the rest in time
                with contextlib.suppress(OSError):
                    connection.shutdown(socket.SHUT_RDWR)

    def _beat(self) -> None:
        """Send a sign of life, unless the guard does not read; only the guard's own messages show whether it hangs."""
        data = frame({"do": "beat"})
        if not self._sending.acquire(blocking=False):
            return  # another message is being sent, which is a sign of life as well
        try:
            # Python's own send would wait for the socket's time-out, although the descriptor does not block.
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

    def _stop_by_signals(self) -> None:
        for name in self._wake_pipe.drain():
            self.stop(name)

    def _wait(self, seconds: float) -> None:
        if not self._closing and select.select([self._wake_pipe.read_fd], [], [], seconds)[0]:
            self._stop_by_signals()


def _result(goal_id: str, goal: str, outcome: Outcome, reason: str) -> GoalResult:
    return GoalResult(goal_id=goal_id, goal=goal, outcome=outcome, reason=reason)
