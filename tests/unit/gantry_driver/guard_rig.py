"""The guard in one process with its test: its loop turns when the test says so, and its port does not exist."""

from __future__ import annotations

import contextlib
import os
import socket
from pathlib import Path
from typing import Any

from gantry_driver.adapters.guard import server as server_module
from gantry_driver.adapters.guard.server import Guard
from gantry_driver.core.configuration.machine_config import DriverConfig
from gantry_driver.core.guard.messages import FrameReader, config_values, frame
from gantry_driver.core.states.machine_states import StateChanged
from gantry_driver.core.states.reasons import Why
from icu_common.adapters.unix_listener import listen_at
from icu_common.core.reasons.message import decoded


class Rig:
    """A guard whose loop turns only when the test wants it to; its port does not exist."""

    def __init__(self, folder: Path, *, stays: bool = False) -> None:
        self.folder, self.path = folder, folder / "guard"
        self._listening = listen_at(self.path)
        self.listener = self._listening.__enter__()
        self.wake_read, self.wake_write = os.pipe()
        self.guard = Guard(self.listener, self.wake_read, stays=stays)
        self.nodes: list[socket.socket] = []

    def node(self) -> socket.socket:
        """Connect a node."""
        made = socket.socket(socket.AF_UNIX)
        made.settimeout(5.0)
        made.connect(bytes(self.path))
        self.nodes.append(made)
        return made

    def turn(self, count: int = 1) -> None:
        """Let the guard's loop turn with what is ready."""
        for _ in range(count):
            poller = server_module.select.poll()
            for fd, what in self.guard._descriptors().items():
                poller.register(fd, what)
            self.guard._turn(dict(poller.poll(50.0)))

    def hello(self, node: socket.socket, **values: Any) -> None:
        config = values.pop("config", DriverConfig(port=str(self.folder / "none")))
        stop_path = str(self.folder / values.pop("stop", "stop"))
        rest = {"time_s": None, "enabled": True, "active": True, "left_down": False, **values}
        node.sendall(frame({"do": "hello", "config": config_values(config), "stop_path": stop_path, **rest}))
        self.turn(2)

    def received(self, node: socket.socket) -> list[dict[str, Any]]:
        """Return what the guard has sent so far; an ended connection gives ``{"end": True}`` as its last message."""
        self.turn()
        node.setblocking(False)
        reader, found = FrameReader(), []
        with contextlib.suppress(BlockingIOError):
            while data := node.recv(65536):
                found += list(reader.feed(data))
            found.append({"end": True})
        return found

    def close(self) -> None:
        self.guard._close("the test has ended")
        for node in self.nodes:
            node.close()
        with contextlib.suppress(OSError):
            self._listening.__exit__(None, None, None)
        os.close(self.wake_write)
        os.close(self.wake_read)


class RestlessMachine:
    """Requirements of the guard for a machine that presses."""

    moves_or_presses = may_be_down = True
    at_rest = False


class NotedLink:
    """Keeps the reasons of stops."""

    def __init__(self) -> None:
        self.stops: list[Why] = []
        self.alive, self.wakes, self.closed = True, 0, ""
        self.opened: os.stat_result | None = None

    def stop(self, reason: Why) -> None:
        self.stops.append(reason)

    def wake(self) -> None:
        self.wakes += 1

    def close(self, reason: str) -> None:
        self.closed = reason


def pressing(rig: Rig) -> NotedLink:
    """Give the guard a link that notes, and a machine that presses."""
    link = NotedLink()
    rig.guard._link, rig.guard._machine = link, RestlessMachine()  # type: ignore[assignment]
    return link


def states(messages: list[dict[str, Any]]) -> list[str]:
    events = [event for message in messages for event in message.get("events", [])]
    return [decoded(content["text"]) for name, content in events if name == StateChanged.__name__]
