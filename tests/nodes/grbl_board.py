"""The program mock_grbl as a process, and a serial link on it without ROS; shared by the driver's tests."""

from __future__ import annotations

import math
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from line_socket import BoardSocket

from gantry_driver.adapters.serial_link import SerialLink
from gantry_driver.core.machine import Machine
from gantry_driver.core.machine_config import DriverConfig
from gantry_driver.core.machine_states import Answered, CloseRequested, Event, Note, Position, StateChanged
from gantry_driver.core.trajectory_gcode import Waypoint
from icu_common.core.frames import JOINTS
from icu_common.core.results import GoalResult


class GrblBoard(BoardSocket):
    """One mock_grbl process and its control socket; ``port`` is its link."""

    def __init__(self, folder: Path, *arguments: str, time_scale: float = 1.0) -> None:
        self.port = folder / "grbl"
        control = folder / "board"
        command = [sys.executable, "-m", "gantry_driver.mock.main", "--link", str(self.port)]
        command += ["--control-socket", str(control), "--time-scale", f"{time_scale:g}", *arguments]
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE)
        assert self.process.stdout is not None
        assert self.process.stdout.readline(), "mock_grbl did not start"
        super().__init__(control)

    def close(self) -> None:
        super().close()
        self.process.terminate()
        try:
            self.process.wait(5.0)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait(5.0)
        assert self.process.stdout is not None
        self.process.stdout.close()


class LinkRig:
    """A machine on a serial link, without ROS; everything it says is kept with its time."""

    def __init__(self, port: Path | str, config: DriverConfig | None = None) -> None:
        self.machine = Machine(config or DriverConfig(enabled_at_start=True))
        self.states: list[tuple[float, str]] = []
        self.results: list[GoalResult] = []
        self.positions: list[tuple[float, float, float]] = []
        self.notes: list[str] = []
        self.complaint: Callable[[], None] | None = None
        self.link = SerialLink(self.machine, str(port), 115200, self._collect)
        self.link.start()

    def _collect(self, events: list[Event]) -> None:
        if self.complaint is not None:
            self.complaint()
        now = time.monotonic()
        for event in events:
            if isinstance(event, StateChanged):
                self.states.append((now, event.text))
            elif isinstance(event, Answered):
                self.results.append(event.result)
            elif isinstance(event, Position):
                self.positions.append(event.reading_m)
            elif isinstance(event, Note):
                self.notes.append(event.text)
            else:
                assert isinstance(event, CloseRequested)

    @property
    def state(self) -> str:
        return self.machine.phase.state

    def until(self, condition: Callable[[], Any], within_s: float = 10.0) -> None:
        held = self.link.wait_for(lambda machine: bool(condition()), within_s)
        assert held, f"not within {within_s} s: {self.machine.state_text}, {self.results[-3:]}, {self.notes[-5:]}"

    def beat_forever(self) -> None:
        self.link.call(lambda machine, now: machine.heartbeat(math.inf))

    def home(self, within_s: float = 20.0) -> LinkRig:
        self.until(lambda: self.state == "unhomed")
        self.beat_forever()
        assert self.link.call(lambda machine, now: machine.home(now)) == ""
        self.until(lambda: self.state == "idle", within_s)
        return self

    def go(self, *points: tuple[float, float, float], goal_id: str = "goal") -> GoalResult:
        way = [Waypoint(positions_m=point) for point in points]
        return self.link.call(lambda machine, now: machine.run(goal_id, JOINTS, way, age_s=0.0, now=now))

    def outcomes(self) -> list[str]:
        return [result.outcome.value for result in list(self.results)]

    def close(self) -> None:
        self.link.close("the test has ended")
