"""A driver without ROS: a client of a guard process, and its board; shared by the guard's tests and its benchmark."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from nodes.grbl_board import GrblBoard
from nodes.guard_rig import HOMED

from gantry_driver.adapters.guard.client import GuardLink
from gantry_driver.core.configuration.envelope_config import EnvelopeConfig
from gantry_driver.core.configuration.machine_config import DriverConfig
from gantry_driver.core.grbl.trajectory_gcode import Waypoint
from gantry_driver.core.guard.messages import frame
from gantry_driver.core.states.machine_states import Answered, Event, StateChanged
from icu_common.adapters.direct_stop.line import guard_folder
from icu_common.core.geometry.frames import JOINTS

PRESSED_M = 0.02


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

    def flood(self) -> None:
        """Send far more frames than the guard allows a node, from another thread."""
        connection, frames = self.link._socket, 20_000 * frame({"do": "beat"})
        assert connection is not None
        threading.Thread(target=lambda: _send_all(connection.fileno(), frames), daemon=True).start()

    def close(self) -> None:
        self._ended.set()
        self.link.close("the test has ended")
        self.board.close()


def _send_all(descriptor: int, data: bytes) -> None:
    try:
        while data:
            data = data[os.write(descriptor, data) :]
    except OSError:
        pass
