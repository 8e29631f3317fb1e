"""The guard as a program: its socket and lock, the ways in which it ends, and a second one."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from support.deadlines import wait_until

from gantry_driver.adapters.guard.places import guard_path
from gantry_driver.cli.gantry_guard import parser
from gantry_driver.core.configuration.machine_config import DriverConfig
from gantry_driver.core.guard.messages import FrameReader, config_values, frame

WITHIN_S = 30.0
Start = Callable[..., "subprocess.Popen[str]"]


@pytest.fixture
def start() -> Iterator[Start]:
    started: list[subprocess.Popen[str]] = []

    def run(*options: str, **environment: str) -> subprocess.Popen[str]:
        command = [sys.executable, "-m", "gantry_driver.cli.gantry_guard", *options]
        paths = {"PYTHONPATH": os.pathsep.join(part for part in sys.path if part)}
        env = {**os.environ, **paths, **environment}
        started.append(subprocess.Popen(command, env=env, stderr=subprocess.PIPE, text=True))
        return started[-1]

    yield run
    for process in started:
        process.kill()
        process.communicate()


def connected(path: Path) -> socket.socket:
    node = socket.socket(socket.AF_UNIX)
    node.settimeout(WITHIN_S)

    def connects() -> bool:
        return node.connect_ex(bytes(path)) == 0

    wait_until(connects, "the guard listens", WITHIN_S)
    return node


def ended(process: subprocess.Popen[str]) -> tuple[int, str]:
    _, errors = process.communicate(timeout=WITHIN_S)
    return process.returncode, errors


def hello(folder: Path) -> dict[str, Any]:
    return {
        "do": "hello",
        "config": config_values(DriverConfig(port=str(folder / "none"))),
        "stop_path": str(folder / "stop"),
        "time_s": None,
        "enabled": True,
        "active": True,
        "left_down": False,
    }


def test_a_node_that_closes_its_guard_ends_it_and_nothing_is_left(start: Start, tmp_path: Path) -> None:
    path = tmp_path / "guard"
    path.with_name("guard.log").write_text("what a starting guard wrote")
    guard = start("--socket", str(path))
    with connected(path) as node:
        assert path.with_name("guard.lock").exists()
        node.sendall(frame(hello(tmp_path)) + frame({"do": "close", "reason": "the test is over"}))
        reader = FrameReader()
        messages: list[dict[str, Any]] = []
        while {"closed": True} not in messages:
            data = node.recv(65536)
            assert data, messages
            messages += list(reader.feed(data))
    assert ended(guard) == (0, "")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal_ends_a_guard_in_order(start: Start, tmp_path: Path, number: signal.Signals) -> None:
    path = tmp_path / "guard"
    guard = start("--socket", str(path), "--stay")
    with connected(path):
        guard.send_signal(signal.SIGTSTP)
        guard.send_signal(number)
        assert ended(guard) == (0, ""), "Ctrl-Z suspends no guard"
    assert list(tmp_path.iterdir()) == []


def test_a_second_guard_of_a_socket_says_so_and_leaves_the_first(start: Start, tmp_path: Path) -> None:
    path = tmp_path / "guard"
    first = start("--socket", str(path))
    with connected(path):
        second = start("--socket", str(path))
        assert ended(second) == (1, f"error: another guard listens at {path}\n")
    with connected(path):
        assert first.poll() is None and path.with_name("guard.lock").exists()


def test_a_port_names_the_socket(start: Start, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    path = guard_path("/dev/ttyNone")
    guard = start("--port", "/dev/ttyNone")
    with connected(path):
        assert path.parent.parent == tmp_path
        guard.terminate()
        assert ended(guard) == (0, "")


def test_a_file_in_the_socket_s_place_is_an_error_and_stays(start: Start, tmp_path: Path) -> None:
    path = tmp_path / "guard"
    path.write_text("a file")
    code, errors = ended(start("--socket", str(path)))
    assert code == 1 and f"{path} exists and is not a socket" in errors
    assert [entry.name for entry in tmp_path.iterdir()] == ["guard"]


@pytest.mark.parametrize("options", [[], ["--socket", "a", "--port", "b"]])
def test_a_guard_has_one_of_socket_and_port(options: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        parser().parse_args(options)
    errors = capsys.readouterr().err
    assert "--socket" in errors and "--port" in errors


def test_a_guard_ends_with_its_node_unless_it_is_told_to_stay() -> None:
    assert parser().parse_args(["--port", "b"]).stay is False
    assert parser().parse_args(["--port", "b", "--stay"]).stay is True
