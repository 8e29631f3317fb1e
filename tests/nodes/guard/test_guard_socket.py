"""The guard's socket without ROS: a client that floods, sends garbage or reads nothing, and a guard that hangs."""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from nodes.grbl_board import GrblBoard
from nodes.guard_rig import HOMED, guards_of

from gantry_driver.adapters.guard.client import GuardLink
from gantry_driver.core.configuration.envelope_config import EnvelopeConfig
from gantry_driver.core.configuration.machine_config import DriverConfig
from gantry_driver.core.grbl.trajectory_gcode import Waypoint
from gantry_driver.core.guard.messages import frame
from gantry_driver.core.states.machine_states import Answered, Event, StateChanged
from icu_common.adapters.direct_stop.line import guard_folder, received_stop, send_stop
from icu_common.core.geometry.frames import JOINTS

pytestmark = [pytest.mark.long, pytest.mark.alone]  # the board and the driver keep real time

PRESSED_M = 0.02
PRESSING_S = 2.0
"""Maximum seconds until the stylus leaves the panel, whatever the cause."""


class Client:
    """A driver without ROS on a board in its own process."""

    def __init__(self, folder: Path, *board: str) -> None:
        self.board = GrblBoard(folder, *board)
        self.states: list[str] = []
        self.outcomes: list[str] = []
        self._news = threading.Event()
        self.stop_path = guard_folder() / f"stop_test_{os.getpid()}"
        config = DriverConfig(
            port=str(self.board.port),
            enabled_at_start=True,
            heartbeat_timeout_s=2.0,
            status_timeout_s=10.0,
            envelope=EnvelopeConfig(free_space_m=0.06, crossing_m=0.06),
        )
        self.link = GuardLink(config, self._collect, stop_path=self.stop_path)
        self.link.ask("activate", on=True)
        self.link.start()
        self._ended = threading.Event()
        threading.Thread(target=self._beat, daemon=True).start()

    def _beat(self) -> None:
        while not self._ended.wait(0.2):  # the interval of the heartbeat
            self.link.tell("heartbeat", age_s=0.0)

    def _collect(self, events: list[Event]) -> None:
        for event in events:
            if isinstance(event, StateChanged):
                self.states.append(event.text)
            elif isinstance(event, Answered):
                self.outcomes.append(event.result.outcome.value)
        self._news.set()

    def until(self, condition: Callable[[], object], within_s: float = 15.0) -> None:
        end = time.monotonic() + within_s
        while True:
            self._news.clear()
            if condition():
                return
            assert time.monotonic() < end, (self.states[-5:], self.outcomes[-3:], self.board.mpos())
            self._news.wait(0.01)  # a moving board causes no event: its position is read again

    def press(self) -> None:
        self.until(lambda: self.states[-1] == "unhomed")
        self.until(lambda: self.link.ask("home") == "")
        self.until(lambda: self.states[-1] == "idle")
        points = [Waypoint(positions_m=(0.1, 0.1, 0.0)), Waypoint(positions_m=(0.1, 0.1, PRESSED_M))]
        self.link.run("press", list(JOINTS), points, age_s=0.0)
        self.until(lambda: "reached" in self.outcomes)
        assert self.board.mpos()[2] == pytest.approx(HOMED[2] - 1000 * PRESSED_M, abs=0.05)

    def lifted(self) -> bool:
        return bool(self.board.mpos()[2] > HOMED[2] - 0.06)

    def close(self) -> None:
        self._ended.set()
        self.link.close("the test has ended")
        self.board.close()


@pytest.fixture
def start(tmp_path: Path) -> Iterator[Callable[..., Client]]:
    made: list[Client] = []

    def make(*board: str) -> Client:
        made.append(Client(tmp_path, *board))
        made[-1].press()
        return made[-1]

    yield make
    for client in made:
        client.close()


def test_a_client_that_floods_is_disconnected_and_the_stylus_lifted(start: Callable[..., Client]) -> None:
    client = start()
    flood = 20_000 * frame({"do": "beat"})
    connection = client.link._socket
    assert connection is not None
    threading.Thread(target=lambda: _send_all(connection.fileno(), flood), daemon=True).start()
    client.until(client.lifted)
    client.until(lambda: "stopped: the driver's node sends too much" in client.states)


def _send_all(descriptor: int, data: bytes) -> None:
    try:
        while data:
            data = data[os.write(descriptor, data) :]
    except OSError:
        pass


@pytest.mark.parametrize("garbage", [b"\xff" * 16, frame({"do": "nothing"}), frame({"do": "run"}), frame({"no": 1})])
def test_a_client_that_sends_garbage_is_disconnected_and_the_stylus_lifted(
    start: Callable[..., Client], garbage: bytes
) -> None:
    client = start()
    connection = client.link._socket
    assert connection is not None
    os.write(connection.fileno(), garbage)
    client.until(client.lifted)
    client.until(lambda: client.states[-1].startswith("stopped: the driver's node sent an unreadable message"))
    client.until(lambda: client.link.ask("reset") == "")
    client.until(lambda: client.states[-1] in ("idle", "disabled"))


def test_a_guard_that_hangs_is_killed_and_started_again_and_lifts(start: Callable[..., Client]) -> None:
    client = start("--keep-running")
    (guard,) = guards_of(client.board.port)
    at, begun_s = client.board.mpos(), float(client.board.ask("state")["t"])
    os.kill(guard, signal.SIGSTOP)
    client.until(lambda: client.board.mpos()[2] > at[2] + 1.0)
    assert float(client.board.ask("state")["t"]) - begun_s < PRESSING_S
    said = (
        "disconnected: the guard hangs; the driver restarts it; the board did not lift the stylus, it may still press"
    )
    client.until(lambda: said in client.states, 30.0)
    client.until(client.lifted, 30.0)
    client.until(lambda: client.states[-1] == "stopped: the stylus stayed down while no driver was connected")
    assert guards_of(client.board.port) != [guard]


def test_a_question_to_a_guard_that_hangs_is_refused_after_a_while(start: Callable[..., Client]) -> None:
    client = start("--keep-running")
    (guard,) = guards_of(client.board.port)
    os.kill(guard, signal.SIGSTOP)
    assert client.link.ask("reset") == "the guard does not answer"
    client.until(client.lifted, 30.0)


def test_a_datagram_stops_and_a_long_one_is_cut(start: Callable[..., Client]) -> None:
    client = start()
    assert send_stop(client.stop_path, "x" * 1000)
    client.until(client.lifted)
    client.until(lambda: client.states[-1] == f"stopped: {'x' * 200}")


def test_closing_lifts_and_frees_the_port_and_the_sockets(start: Callable[..., Client]) -> None:
    client = start()
    client.link.close("the test is over")
    assert client.lifted() and guards_of(client.board.port) == []
    assert client.states[-1] == "stopped: the test is over"
    assert not client.stop_path.exists() and not send_stop(client.stop_path, "nobody is there")


def test_a_socket_without_a_stop_has_none(tmp_path: Path) -> None:
    from icu_common.adapters.direct_stop.line import open_stop_socket

    with open_stop_socket(tmp_path / "stop") as stops:
        assert received_stop(stops) is None
