"""The node's side of the guard against a socket that the test serves: answers, ends, refusals, a guard that hangs."""

from __future__ import annotations

import contextlib
import os
import socket
import subprocess
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from support.deadlines import wait_until

from gantry_driver.adapters.guard import client as client_module
from gantry_driver.adapters.guard.client import NO_ANSWER, GuardLink
from gantry_driver.adapters.guard.places import guard_path
from gantry_driver.core.configuration.machine_config import DriverConfig
from gantry_driver.core.grbl.trajectory_gcode import Waypoint
from gantry_driver.core.guard.messages import FrameReader, event_values, frame
from gantry_driver.core.states.machine_states import Answered, Event, Note, StateChanged
from icu_common.adapters.unix_listener import listen_at
from icu_common.core.geometry.frames import JOINTS
from icu_common.core.goals.results import GoalResult, Outcome

pytestmark = pytest.mark.slow

WITHIN_S = 20.0
POINTS = [Waypoint(positions_m=(0.1, 0.1, 0.0))]


class Rig:
    """A link, and the guard's end of its socket."""

    def __init__(self, folder: Path, **values: Any) -> None:
        self.config = DriverConfig(port=str(folder / "port"), **values.pop("config", {}))
        self.events: list[Event] = []
        self.turns: list[tuple[int, int, int]] = []
        self.stop_path = folder / "stop"
        turn = {"on_turn": lambda *counts: self.turns.append(counts)} if values.pop("counts", True) else {}
        self.link = GuardLink(self.config, self.events.extend, stop_path=self.stop_path, **turn, **values)
        self.path = guard_path(self.config.port)
        self._listening = listen_at(self.path)
        self.listener = self._listening.__enter__()
        self.listener.setblocking(True)
        self.listener.settimeout(WITHIN_S)
        self.guard: socket.socket | None = None
        self._reader = FrameReader()
        self.messages: list[dict[str, Any]] = []

    def connect(self) -> dict[str, Any]:
        """Accept the link, and return its hello."""
        if not self.link.alive:
            self.link.start()
        self.guard, _ = self.listener.accept()
        self.guard.settimeout(WITHIN_S)
        self._reader, self.messages = FrameReader(), []
        hello = self.next("hello")
        hung = lambda: client_module.HUNG_S < 1.0  # noqa: E731
        wait_until(lambda: self.link._socket is not None or hung(), "the link may send", WITHIN_S)
        return hello

    def next(self, name: str) -> dict[str, Any]:
        """Return the next message of this name, and drop those before it."""
        assert self.guard is not None
        while True:
            while self.messages:
                if (message := self.messages.pop(0))["do"] == name:
                    return message
            data = self.guard.recv(65536)
            assert data, "the link has ended the connection"
            self.messages += self._reader.feed(data)

    def say(self, **message: Any) -> None:
        assert self.guard is not None
        self.guard.sendall(frame(message))

    def tell(self, *events: Event, down: bool = False) -> None:
        self.say(events=[event_values(event) for event in events], down=down)

    def answer(self, name: str, value: Any) -> dict[str, Any]:
        asked = self.next(name)
        self.say(id=asked["id"], value=value)
        return asked

    def drop(self) -> None:
        assert self.guard is not None
        self.guard.close()
        self.guard = None

    def states(self) -> list[str]:
        return [event.text for event in self.events if isinstance(event, StateChanged)]

    def close(self) -> None:
        self.link._closing = True
        self.link._wake_pipe.wake()
        if self.guard is not None:
            self.guard.close()
        with contextlib.suppress(OSError):
            self._listening.__exit__(None, None, None)
        self.link.close("the test has ended")


@pytest.fixture
def make(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[..., Rig]]:
    # The guard's end is in this process, which the link would kill if the guard seemed to hang.
    monkeypatch.setattr(client_module, "HUNG_S", 100.0)
    monkeypatch.setattr(client_module, "HUNG_DOWN_S", 100.0)
    made: list[Rig] = []

    def start(**values: Any) -> Rig:
        made.append(Rig(tmp_path, **values))
        return made[-1]

    yield start
    for rig in made:
        rig.close()


def elsewhere(action: Callable[[], Any]) -> tuple[threading.Thread, list[Any]]:
    """Run an action that waits for the guard in a thread; return it, and what will be its result."""
    result: list[Any] = []
    thread = threading.Thread(target=lambda: result.append(action()))
    thread.start()
    return thread, result


def test_a_hello_has_all_that_a_new_guard_needs(make: Callable[..., Rig]) -> None:
    rig = make(time_s=lambda: 12.5)
    rig.link.rivals("panel/plane", "two programs publish panel/plane: a and b")
    rig.link.ask("activate", on=True)
    rig.link.ask("enable", on=True)
    hello = rig.connect()
    assert (hello["time_s"], hello["enabled"], hello["active"], hello["left_down"]) == (12.5, True, True, False)
    assert hello["stop_path"] == str(rig.stop_path) and hello["config"]["port"] == rig.config.port
    assert rig.next("rivals")["text"] == "two programs publish panel/plane: a and b"
    assert rig.next("beat") == {"do": "beat"}


def test_without_a_guard_the_machine_answers_and_counts_nothing(make: Callable[..., Rig]) -> None:
    rig = make()
    assert rig.link.ask("home") == "the driver is disconnected: not opened yet"
    rig.link.run("g", list(JOINTS), POINTS, age_s=0.0)
    answer = rig.events[-1]
    assert isinstance(answer, Answered) and answer.result.outcome is Outcome.REJECTED
    assert not rig.link.step(1.0) and not rig.link.alive
    rig.link.stop("there is nothing to stop")


def test_a_command_gets_its_answer_and_a_late_one_of_another_is_ignored(make: Callable[..., Rig]) -> None:
    rig = make()
    rig.connect()
    thread, result = elsewhere(lambda: rig.link.ask("reset"))
    asked = rig.next("reset")
    rig.say(id=asked["id"] + 40, value="an answer without a question")
    rig.say(id=asked["id"], value="nothing to reset")
    thread.join(WITHIN_S)
    assert result == ["nothing to reset"] and not rig.link._answers


def test_changes_are_kept_here_too_for_the_next_guard(make: Callable[..., Rig]) -> None:
    rig = make()
    rig.connect()
    thread, result = elsewhere(lambda: rig.link.ask("enable", on=True))
    assert rig.answer("enable", "")["on"] is True
    thread.join(WITHIN_S)
    assert result == [""]
    rig.drop()
    assert rig.connect()["enabled"] is False, "a person enables it after a lost guard"


def test_a_trajectory_without_an_answer_is_rejected(make: Callable[..., Rig], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(client_module, "ASK_S", 0.05)
    rig = make()
    rig.connect()
    rig.link.run("g", list(JOINTS), POINTS, age_s=0.0)
    answer = rig.events[-1]
    assert isinstance(answer, Answered) and answer.result.reason == NO_ANSWER
    assert answer.result.outcome is Outcome.REJECTED and answer.result.goal == "1 points"


def test_a_trajectory_that_fits_no_frame_is_rejected(make: Callable[..., Rig]) -> None:
    rig = make()
    rig.connect()
    rig.link.run("x" * 5_000_000, list(JOINTS), POINTS, age_s=0.0)
    answer = rig.events[-1]
    assert isinstance(answer, Answered) and "the frame has" in answer.result.reason


def test_a_message_that_needs_no_answer_and_one_that_is_not_known(make: Callable[..., Rig]) -> None:
    rig = make()
    rig.connect()
    rig.link.tell("heartbeat", age_s=0.25)
    assert rig.next("heartbeat") == {"do": "heartbeat", "age_s": 0.25}
    rig.say(news="of a later version")
    rig.tell(StateChanged(text="idle"))
    wait_until(lambda: "idle" in rig.states(), "the next message")


def test_a_guard_that_does_not_listen_is_started(make: Callable[..., Rig], monkeypatch: pytest.MonkeyPatch) -> None:
    started = threading.Event()
    monkeypatch.setattr(GuardLink, "_start_guard", lambda link: started.set())
    rig = make()
    rig.path.unlink()
    rig.link.start()
    assert started.wait(WITHIN_S)


def test_two_sources_stop_the_machine_and_one_again_does_not(make: Callable[..., Rig]) -> None:
    rig = make()
    rig.connect()
    for text in ("two programs", ""):
        thread, _ = elsewhere(lambda text=text: rig.link.rivals("heartbeat", text))
        if text:
            assert rig.next("stop")["reason"] == text
        assert rig.answer("rivals", "")["text"] == text
        thread.join(WITHIN_S)
    assert not [message for message in rig.messages if message["do"] == "stop"]


def test_steps_are_counted_by_the_guard_and_by_nobody_else(make: Callable[..., Rig]) -> None:
    rig = make()
    rig.connect()
    assert rig.link.step(3.5) and rig.link.step(3.6)
    assert rig.next("step")["time_s"] == 3.5
    rig.say(turn=[1, 10, 20])
    wait_until(lambda: rig.turns == [(1, 10, 20)], "a turn is counted")
    rig.drop()
    wait_until(lambda: (1, 0, 0) in rig.turns, "the step that the guard has not counted")


def test_a_link_that_counts_no_turns_ignores_them(make: Callable[..., Rig]) -> None:
    rig = make(counts=False)
    rig.connect()
    rig.say(turn=[1, 10, 20])
    rig.tell(StateChanged(text="idle"))
    wait_until(lambda: "idle" in rig.states(), "the next message")
    assert rig.turns == []


def test_a_goal_under_way_is_aborted_with_its_guard_and_the_next_one_knows_of_the_stylus(
    make: Callable[..., Rig],
) -> None:
    rig = make()
    rig.connect()
    accepted = GoalResult(goal_id="g", goal="2 points", outcome=Outcome.ACCEPTED)
    other = GoalResult(goal_id="h", goal="3 points", outcome=Outcome.REJECTED)
    same = GoalResult(goal_id="g", goal="2 points", outcome=Outcome.REJECTED, reason="a repeated order")
    rig.tell(Answered(result=accepted), Answered(result=other), Answered(result=same), down=True)
    rig.tell(down=True)
    wait_until(lambda: rig.link._down, "the guard's report")
    rig.drop()
    assert rig.connect()["left_down"] is True
    answers = [e.result for e in rig.events if isinstance(e, Answered)]
    assert answers[-1].outcome is Outcome.ABORTED and answers[-1].reason == "link lost: the guard has ended"
    assert rig.states()[-1].startswith("disconnected: the guard has ended")


def test_a_goal_that_has_its_answer_is_not_aborted(make: Callable[..., Rig]) -> None:
    rig = make()
    rig.connect()
    for outcome in (Outcome.ACCEPTED, Outcome.REACHED):
        rig.tell(Answered(result=GoalResult(goal_id="g", goal="2 points", outcome=outcome)))
    rig.tell(StateChanged(text="idle"))
    wait_until(lambda: "idle" in rig.states(), "the answers have arrived")
    rig.drop()
    rig.connect()
    outcomes = [e.result.outcome for e in rig.events if isinstance(e, Answered)]
    assert outcomes == [Outcome.ACCEPTED, Outcome.REACHED]


def test_a_refusal_names_the_port(make: Callable[..., Rig]) -> None:
    rig = make()
    rig.connect()
    rig.say(refused="in use by another program")
    rig.connect()
    assert f"disconnected: {rig.config.port}: in use by another program" in rig.states()


@pytest.mark.parametrize("data", [b"\xff" * 8, frame({"events": [["What", {}]], "down": False}), frame({"turn": [1]})])
def test_an_unreadable_message_ends_the_connection_and_is_reported(make: Callable[..., Rig], data: bytes) -> None:
    rig = make()
    rig.connect()
    assert rig.guard is not None
    rig.guard.sendall(data)
    rig.connect()
    assert any(text.startswith("disconnected: the guard: ") for text in rig.states())


def test_a_guard_that_ends_with_unread_bytes_has_ended(make: Callable[..., Rig]) -> None:
    rig = make()
    rig.connect()
    rig.link.stop("unread")
    wait_until(lambda: rig.link._socket is not None, "the link is connected")
    rig.drop()
    rig.connect()
    assert any("the guard has ended" in text for text in rig.states())


@pytest.mark.parametrize("gone", [True, False])
def test_a_guard_that_hangs_is_killed(make: Callable[..., Rig], monkeypatch: pytest.MonkeyPatch, gone: bool) -> None:
    killed: list[int] = []

    def kill(process: int, number: int) -> None:
        killed.append(process)
        if gone:
            raise ProcessLookupError

    monkeypatch.setattr(client_module, "HUNG_S", 0.05)
    monkeypatch.setattr(client_module.os, "kill", kill)
    monkeypatch.setattr(client_module, "sample_threads", lambda process: {})
    rig = make()
    rig.connect()
    wait_until(lambda: killed, "the guard is killed", WITHIN_S)
    monkeypatch.setattr(client_module, "HUNG_S", 100.0)
    monkeypatch.setattr(client_module, "HUNG_DOWN_S", 100.0)
    rig.connect()
    assert set(killed) == {os.getpid()}, "the process at the other end"
    assert any("the guard hangs; the driver restarts it" in text for text in rig.states())


def test_closing_waits_for_the_guard_and_may_be_repeated(make: Callable[..., Rig]) -> None:
    rig = make()
    rig.connect()
    thread, _ = elsewhere(lambda: rig.link.close("the driver is ending"))
    assert rig.next("close")["reason"] == "the driver is ending"
    rig.say(closed=True)
    thread.join(WITHIN_S)
    assert not rig.link.alive
    rig.link.close("again")


def test_a_guard_that_does_not_end_is_reported(make: Callable[..., Rig], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(client_module, "WAY_OUT_S", 0.1)
    rig = make(config={"hold_timeout_s": 0.5})
    rig.connect()
    rig.link.close("the driver is ending")
    (note,) = [event for event in rig.events if isinstance(event, Note)]
    assert note.level == "error" and note.text.startswith("closed 0.6 s after the stop: the machine's state is unknown")
    rig.say(closed=True)
    rig.link._thread.join(WITHIN_S)


def test_a_link_that_never_started_closes_at_once(make: Callable[..., Rig]) -> None:
    rig = make()
    rig.link.close("never started")
    assert not rig.link.alive


def test_a_started_guard_that_does_not_end_is_not_waited_for_longer(
    make: Callable[..., Rig], monkeypatch: pytest.MonkeyPatch
) -> None:
    class Stubborn:
        def wait(self, seconds: float) -> None:
            raise subprocess.TimeoutExpired("guard", seconds)

    rig = make()
    rig.link._started = Stubborn()  # type: ignore[assignment]
    rig.link.close("never started")


def test_a_guard_that_is_starting_is_not_started_again(
    make: Callable[..., Rig], monkeypatch: pytest.MonkeyPatch
) -> None:
    started: list[Any] = []

    class Starting:
        def __init__(self, command: list[str], **values: Any) -> None:
            started.append(command)

        def poll(self) -> None:
            return None

        def wait(self, seconds: float) -> int:
            return 0

    monkeypatch.setattr(client_module.subprocess, "Popen", Starting)
    rig = make()
    rig.link._start_guard()
    rig.link._start_guard()
    assert len(started) == 1 and started[0][1:3] == ["-m", "gantry_driver.cli.gantry_guard"]
    rig.link._started_at -= client_module.START_S
    rig.link._start_guard()
    assert len(started) == 2, "it has not begun to listen in time"


def test_signals_stop_the_machine_whether_a_guard_is_there_or_not(make: Callable[..., Rig]) -> None:
    rig = make()
    rig.connect()
    os.write(rig.link.wakeup_fd, bytes([15]))
    assert "SIGTERM" in rig.next("stop")["reason"]
    rig.link._drop()
    os.write(rig.link.wakeup_fd, bytes([15]))
    rig.link._wait(WITHIN_S)


def test_messages_to_a_guard_that_has_gone_are_lost_and_no_error(make: Callable[..., Rig]) -> None:
    rig = make()
    left, right = socket.socketpair()
    rig.link._socket = left
    right.close()
    rig.link.stop("x")
    rig.link._beat()
    rig.link._socket = None
    rig.link._beat()
    left.close()


def test_a_sign_of_life_that_was_sent_in_part_is_completed(
    make: Callable[..., Rig], monkeypatch: pytest.MonkeyPatch
) -> None:
    rig = make()
    left, right = socket.socketpair()
    rig.link._socket = left
    write = os.write
    monkeypatch.setattr(client_module.os, "write", lambda fd, data: write(fd, data[:3]))
    rig.link._beat()
    assert list(FrameReader().feed(right.recv(100))) == [{"do": "beat"}]
    rig.link._sending.acquire()
    rig.link._beat()
    rig.link._sending.release()
    right.setblocking(False)
    with pytest.raises(BlockingIOError):
        right.recv(100)
    rig.link._socket = None
    left.close()
    right.close()
