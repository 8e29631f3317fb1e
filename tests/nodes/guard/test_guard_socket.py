"""The guard's socket without ROS: a client that floods, sends garbage or reads nothing, and a guard that hangs."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from nodes.guard_client import Client
from nodes.guard_rig import guards_of

from gantry_driver.core.guard.messages import frame
from icu_common.adapters.direct_stop.line import received_stop, send_stop

pytestmark = [pytest.mark.long, pytest.mark.alone]  # the board and the driver keep real time

PRESSING_S = 2.0
"""Maximum seconds until the stylus leaves the panel, whatever the cause."""


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
    client.flood()
    client.until(client.lifted)
    client.until(lambda: "stopped: the driver's node sends too much" in client.states)


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
