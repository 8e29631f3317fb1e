"""The real link on a pseudo-terminal with the program mock_grbl behind it, as a rig of the campaign."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from nodes.grbl_board import GrblBoard, LinkRig

from gantry_driver.core.configuration.machine_config import DriverConfig
from gantry_driver.core.machine.machine import Machine
from icu_common.core.goals.results import GoalResult

SCALE = 3.0
"""Board seconds per second; the driver's own times stay as they are."""


class PortRig:
    """Closes board and link at the end of the ``with`` block."""

    def __init__(self, config: DriverConfig, seed: int, folder: Path) -> None:
        self._board = GrblBoard(folder, "--seed", str(seed), time_scale=SCALE)
        self._rig = LinkRig(self._board.port, config)
        self.machine, self.results = self._rig.machine, self._rig.results

    def __enter__(self) -> PortRig:
        return self

    def __exit__(self, *error: object) -> None:
        self._rig.close()
        self._board.close()

    def home(self) -> None:
        self._rig.home()

    def go(self, points: Sequence[tuple[float, float, float]], goal_id: str) -> GoalResult:
        return self._rig.go(*points, goal_id=goal_id)

    def call(self, action: Callable[[Machine, float], Any]) -> Any:
        return self._rig.link.call(action)

    def stop(self, reason: str) -> None:
        self._rig.link.stop(reason)

    def fault(self, kind: str, **arguments: Any) -> None:
        self._board.fault(kind, **arguments)

    def until(self, condition: Callable[[], Any], within_s: float) -> None:
        self._rig.until(condition, within_s)

    def run_for(self, seconds: float) -> None:
        end = time.monotonic() + seconds / SCALE
        while time.monotonic() < end:
            self._board.counters()

    def mpos(self) -> tuple[float, float, float]:
        return self._board.mpos()

    def servo(self) -> float:
        return float(self._board.ask("state")["spindle"])

    def counter(self, name: str) -> int:
        return self._board.counters().get(name, 0)

    def lines(self, since: int, kind: str = "line") -> list[dict[str, Any]]:
        return self._board.log(since, kind)

    @property
    def entry(self) -> int:
        return self._board.mark()
