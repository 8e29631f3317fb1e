"""The robot with ordinary cameras: MJPEG 4:2:0, Bayer with noise, and two cameras that run freely.

Calibration ends in the usual time with each, and presses are reached where the physical truth says so.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from support.camera_chain import CHAINS, Chain
from support.virtual_robot import VirtualRobot

from icu_common.core.goals.results import Outcome

pytestmark = pytest.mark.long

SEED = 3
PRESSED = ("RUN_STOP", "MENU", "AUTO_SET")
CALIBRATED_WITHIN_S = 75.0


class OrdinaryRobot(VirtualRobot):
    """A robot whose images go through a chain of a camera, the right ones exposed ``phase_ms`` before the left."""

    def __init__(self, seed: int, chain: Chain | None, phase_ms: float = 0.0) -> None:
        bench: dict[str, Any] = {"light.noise": 0.0} if chain is not None else {}
        if phase_ms:
            bench |= {"imaging.free_running.enabled": True, "imaging.free_running.phase_ms": phase_ms}
        super().__init__(seed, bench=bench)
        self._chain, self._rng = chain, np.random.default_rng(seed)

    def _pictures(self, due: Any) -> dict[int, Any]:
        images = super()._pictures(due)
        return images if self._chain is None else {k: self._chain(v, self._rng) for k, v in images.items()}


@pytest.mark.timeout(900)
@pytest.mark.parametrize(
    ("name", "phase_ms"),
    [("mjpeg420_80", 0.0), ("webcam", 0.0), ("ideal", 16.0)],
    ids=["MJPEG 80 4:2:0", "Bayer, MJPEG and noise", "free-running"],
)
def test_calibration_ends_in_the_usual_time_and_presses_are_reached(name: str, phase_ms: float) -> None:
    """Before: 1 of 3 reached, none and no end of the calibration, and no pair of images at all."""
    print(f"seed {SEED}")
    robot = OrdinaryRobot(SEED, CHAINS.get(name), phase_ms)
    robot.prepare()
    print(f"prepared at {robot.now:.1f} s")
    assert robot.now < CALIBRATED_WITHIN_S
    for control in PRESSED:
        robot.take_records()
        result = robot.command(f"press:{control}")
        print(control, result.outcome.value, result.reason, f"{result.error_m * 1e3:.3f} mm")
        assert result.outcome is Outcome.REACHED, result.reason
        assert any(record.get("control") == control for record in robot.take_records())


def test_recognition_knows_where_the_stylus_is_if_cameras_run_freely() -> None:
    """Before, recognition had no tip at 13 ms, and the robot's own arm counted as a hand over the controls."""
    robot = VirtualRobot(SEED, bench={"imaging.free_running.enabled": True, "imaging.free_running.phase_ms": 13.0})
    robot.prepare(calibrate=False)
    control = next(c for c in robot.layout.controls if c.name == "TRIG_MENU")
    # The raised stylus hides what is above it in the image.
    place = robot.bench.panel_from.apply(np.array([*control.position_mm, 0.0]) / 1000) - (0.0, 0.018, 0.0)
    assert robot.command("", place=(float(place[0]), float(place[1]))).outcome is Outcome.REACHED
    robot.look_at_panel()
    seen = robot.controller._world.seen
    assert seen is not None
    hidden = {c.name: c.hidden_by for c in seen.controls if c.hidden_by}
    print(hidden)
    assert hidden[control.name] == "stylus"
    assert "something" not in hidden.values()
