"""DTR of a real terminal: a guard process that is killed leaves HUPCL off, and its successor opens the port so."""

from __future__ import annotations

import contextlib
import os
import pty
import signal
import socket
import subprocess
import sys
import termios
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from deadlines import wait_until

from gantry_driver.adapters.guard.places import guard_path
from gantry_driver.adapters.guard.port_record import record_path
from gantry_driver.adapters.serial_link import SerialLink
from gantry_driver.adapters.serial_port import hang_up
from gantry_driver.core.configuration.machine_config import DriverConfig
from gantry_driver.core.guard.messages import config_values, frame
from gantry_driver.core.machine.machine import Machine

pytestmark = pytest.mark.slow

WITHIN_S = 20.0


class Terminal:
    """A pseudo-terminal without a board; closed by all programs, it keeps its settings as a serial port does."""

    def __init__(self) -> None:
        self.master, slave = pty.openpty()
        self.path = os.ttyname(slave)
        hang_up(slave, True)  # the initial state of a serial port
        os.close(slave)
        self.guards: list[subprocess.Popen[bytes]] = []
        self.node: socket.socket | None = None

    @property
    def hangs_up(self) -> bool:
        return bool(termios.tcgetattr(self.master)[2] & termios.HUPCL)

    def guard(self, *options: str) -> subprocess.Popen[bytes]:
        command = [sys.executable, "-m", "gantry_driver.cli.gantry_guard", "--port", self.path, *options]
        self.guards.append(subprocess.Popen(command))
        return self.guards[-1]

    def connect(self, stop_path: Path) -> None:
        """Connect as a node, with the terminal as the port."""
        made = self.node = socket.socket(socket.AF_UNIX)
        wait_until(lambda: made.connect_ex(bytes(guard_path(self.path))) == 0, "the guard listens", WITHIN_S)
        values = {"time_s": None, "enabled": False, "active": True, "left_down": False, "stop_path": str(stop_path)}
        made.sendall(frame({"do": "hello", "config": config_values(DriverConfig(port=self.path)), **values}))

    def has_open(self, guard: subprocess.Popen[bytes]) -> bool:
        for fd in Path(f"/proc/{guard.pid}/fd").iterdir():
            with contextlib.suppress(FileNotFoundError):  # closed meanwhile
                if os.readlink(fd) == self.path:  # noqa: PTH115
                    return True
        return False

    def close(self) -> None:
        for guard in self.guards:
            guard.kill()
            guard.wait(WITHIN_S)
        if self.node is not None:
            self.node.close()
        record_path(guard_path(self.path)).unlink(missing_ok=True)
        os.close(self.master)


@pytest.fixture
def terminal() -> Iterator[Terminal]:
    made = Terminal()
    yield made
    made.close()


def test_a_killed_guard_leaves_dtr_high_and_the_next_one_opens_without_an_edge(
    terminal: Terminal, tmp_path: Path
) -> None:
    assert terminal.hangs_up
    first = terminal.guard()
    terminal.connect(tmp_path / "stop")
    wait_until(lambda: record_path(guard_path(terminal.path)).is_file(), "the record of the open port", WITHIN_S)
    assert terminal.has_open(first) and not terminal.hangs_up
    first.send_signal(signal.SIGKILL)
    first.wait(WITHIN_S)
    assert not terminal.hangs_up, "the kernel lowers DTR at the last close only with HUPCL"
    second = terminal.guard("--recover")
    wait_until(lambda: terminal.has_open(second), "the next guard has opened the port", WITHIN_S)
    assert not terminal.hangs_up
    second.send_signal(signal.SIGTERM)
    assert second.wait(WITHIN_S) == 0
    assert terminal.hangs_up, "a close in order restores what other programs expect"
    assert not record_path(guard_path(terminal.path)).exists()


def test_no_step_of_an_opening_sets_hupcl(terminal: Terminal, monkeypatch: pytest.MonkeyPatch) -> None:
    """pyserial writes the settings several times; a kill between two of them must find HUPCL off as well."""
    slave = os.open(terminal.path, os.O_RDWR | os.O_NOCTTY)
    hang_up(slave, False)  # by the guard that was killed
    os.close(slave)
    written: list[bool] = []
    real = termios.tcsetattr

    def noted(fd: int, when: int, modes: list[Any]) -> None:
        written.append(bool(modes[2] & termios.HUPCL))
        real(fd, when, modes)

    monkeypatch.setattr(termios, "tcsetattr", noted)
    machine = Machine(DriverConfig(port=terminal.path))
    link = SerialLink(machine, terminal.path, 115200, lambda _: None, hangs_up=True)
    link.start()
    wait_until(lambda: link.opened is not None, "the port is open", WITHIN_S)
    assert written and not any(written)
    link.close("the test has ended")
    assert written[-1] and terminal.hangs_up
