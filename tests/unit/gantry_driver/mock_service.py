"""The mock board as a service in a thread of the test, and a port that keeps what it has received."""

from __future__ import annotations

import contextlib
import os
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import serial
from support.deadlines import wait_until
from support.line_socket import LineSocket

from gantry_driver.mock.machine import MockMachine
from gantry_driver.mock.service import Service
from gantry_driver.mock.settings import make_eeprom

DEADLINE_S = 30.0


class Port(serial.Serial):
    """A port that is opened as pyserial does it, but loses nothing that has come by then: not the banner either."""

    def _reset_input_buffer(self) -> None: ...


class Running:
    """A service in a thread, and what is connected to it."""

    def __init__(self, folder: Path, stack: contextlib.ExitStack, **options: Any) -> None:
        self.link, self.truth_path, self.control_path = folder / "port", folder / "truth", folder / "control"
        settings = options.pop("settings", {})
        self.service = Service(
            MockMachine(make_eeprom(settings)),
            link=self.link,
            truth_socket=self.truth_path,
            control_socket=self.control_path,
            **options,
        )
        self._stack = stack
        thread = threading.Thread(target=self.service.run)
        thread.start()
        stack.callback(thread.join, DEADLINE_S)
        stack.callback(self.service.stop)
        self.control = self.client(self.control_path)

    def client(self, path: Path) -> LineSocket:
        client = LineSocket(path)
        self._stack.callback(client.close)
        return client

    def open(self, **arguments: Any) -> Port:
        port = Port(os.fspath(self.link), 115200, timeout=DEADLINE_S, exclusive=True, **arguments)
        self._stack.callback(port.close)
        return port

    def fault(self, kind: str, **arguments: Any) -> None:
        assert self.control.ask(do="fault", kind=kind, **arguments)["ok"] is True


def wait_for(condition: Callable[[], bool]) -> None:
    wait_until(condition, "the condition", DEADLINE_S)


def expect(port: Port, ending: bytes) -> bytes:
    seen = port.read_until(ending)
    assert seen.endswith(ending), f"{ending!r} did not come; seen: {seen!r}"
    return seen
