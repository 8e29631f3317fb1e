"""The program mock_grbl as a process, and a serial link on it without ROS; shared by the driver's tests."""

from __future__ import annotations

import dataclasses
import math
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from support.line_socket import BoardSocket

from gantry_driver.adapters.serial_link import SerialLink
from gantry_driver.core.configuration.envelope_config import EnvelopeConfig
from gantry_driver.core.configuration.machine_config import DriverConfig
from gantry_driver.core.grbl.trajectory_gcode import Waypoint
from gantry_driver.core.machine.machine import Machine
from gantry_driver.core.states.machine_states import Answered, CloseRequested, Event, Note, Position, StateChanged
from icu_common.core.geometry.frames import JOINTS
from icu_common.core.goals.results import GoalResult


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


PATIENT = DriverConfig(enabled_at_start=True, status_timeout_s=10.0, hold_timeout_s=10.0)
"""On a busy machine a board may stop for seconds without having ended."""
SLOW_M_S = 0.03
"""Length of a path on which an event happens: it must not have ended, even if the program that causes the event is held
up."""


class AwakeClock:
    """Seconds in which this process was not held up, for bounds of its own actions; a context manager."""

    STEP_S, MOST_S = 0.005, 0.05

    def __init__(self) -> None:
        self._awake_s, self._ended = 0.0, threading.Event()
        self._thread = threading.Thread(target=self._tick, daemon=True)

    def _tick(self) -> None:
        before = time.monotonic()
        while not self._ended.wait(self.STEP_S):
            now = time.monotonic()
            self._awake_s += min(now - before, self.MOST_S)
            before = now

    def now(self) -> float:
        return self._awake_s

    def __enter__(self) -> AwakeClock:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        self._thread.join()


class LinkRig:
    """A machine on a serial link, without ROS; everything it says is kept with its time."""

    def __init__(self, port: Path | str, config: DriverConfig | None = None) -> None:
        free = EnvelopeConfig(free_space_m=0.2, crossing_m=0.2)  # no test on this rig is about the panel
        self.machine = Machine(dataclasses.replace(config or PATIENT, envelope=free))
        self.clock: Callable[[], float] = time.monotonic
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
        now = self.clock()
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

    def until(self, condition: Callable[[], Any], within_s: float = 15.0) -> None:
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

    def go(self, *points: tuple[float, float, float], goal_id: str = "goal", slow_after: int = 1000) -> GoalResult:
        """Order the path; after this number of points it is driven slowly."""
        way = [Waypoint(positions_m=point) for point in points[:slow_after]]
        way += [Waypoint(positions_m=point, velocities_m_s=(SLOW_M_S, 0.0, 0.0)) for point in points[slow_after:]]
        return self.link.call(lambda machine, now: machine.run(goal_id, JOINTS, way, age_s=0.0, now=now))

    def outcomes(self) -> list[str]:
        return [result.outcome.value for result in list(self.results)]

    def close(self) -> None:
        self.link.close("the test has ended")
