"""The whole robot on a virtual clock: whatever goes wrong in mid-gesture, it ends safely and says what it was."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator

import numpy as np
import pytest
from support.virtual_robot import VirtualRobot

from gantry_driver.core.job.goal_job import GoalPhase
from icu_common.core.goals.results import GoalResult, Outcome

pytestmark = pytest.mark.slow

LIFTED_M = -0.0006
"""Heights of the tip's ball above this count as up; the play of the stylus's axis is less."""


@pytest.fixture(scope="module")
def prepared() -> VirtualRobot:
    robot = VirtualRobot(3)
    robot.prepare(calibrate=False)
    return robot


@pytest.fixture
def robot(prepared: VirtualRobot) -> Iterator[VirtualRobot]:
    """The robot at rest, and at rest again afterwards."""
    prepared.watch_panel = True
    prepared.take_records()
    yield prepared
    prepared.heart, prepared.camera_on = True, True
    prepared.renderer.hide(None)
    prepared.renderer.relight(prepared.bench.config.light)
    prepared.watch_panel = False
    prepared.run_for(3.0)
    if prepared.driver.state == "stopped":
        prepared.until(lambda: not prepared.driver.reset(prepared.now), 10.0)
    prepared.look_at_panel()
    prepared.until(lambda: prepared.state == "ready", 10.0)


def hand(robot: VirtualRobot) -> None:
    robot.renderer.hide((190.0, 90.0, 80.0, 60.0))


def dark(robot: VirtualRobot) -> None:
    robot.renderer.relight(dataclasses.replace(robot.bench.config.light, level=0.02))


def push(robot: VirtualRobot) -> None:
    robot.bench.move_panel(0.004, 0.0, 0.0)
    robot.renderer.move_panel(robot.bench.panel_from)


def stall(robot: VirtualRobot) -> None:
    robot.camera_on = False


def leave(robot: VirtualRobot) -> None:
    robot.heart = False


def broken(robot: VirtualRobot, command: str, phase: GoalPhase, fault: Callable[[VirtualRobot], None]) -> GoalResult:
    """Give a command, make the fault happen in that phase, and return the final answer once the machine rests."""
    count = len(robot.results)
    robot.begin(command)
    robot.until(lambda: robot.controller.phase is phase, 30.0)
    fault(robot)
    result = robot.answer(count)
    robot.run_for(4.0)
    return result


@pytest.mark.parametrize(
    ("command", "phase", "fault", "words"),
    [
        ("press:RUN_STOP", GoalPhase.APPROACH, stall, "the camera has stalled: no image for 4.0 s"),
        ("hold:RUN_STOP:5", GoalPhase.CONTACT, stall, "the camera has stalled: no image for 1.0 s"),
        (
            "press:RUN_STOP",
            GoalPhase.APPROACH,
            hand,
            "has hidden RUN_STOP|no recognition of the panel|the cameras saw the tip",
        ),
        ("press:RUN_STOP", GoalPhase.APPROACH, dark, "no recognition of the panel|the cameras saw the tip"),
        ("press:RUN_STOP", GoalPhase.APPROACH, push, "the panel has moved by"),
        ("hold:RUN_STOP:5", GoalPhase.CONTACT, push, "the panel has moved by"),
        ("press:RUN_STOP", GoalPhase.APPROACH, leave, "heartbeat"),
        ("hold:RUN_STOP:5", GoalPhase.CONTACT, leave, "heartbeat"),
        ("turn:TIME_SCALE:120", GoalPhase.TURN, leave, "heartbeat"),
    ],
)
def test_ends_safely(
    robot: VirtualRobot, command: str, phase: GoalPhase, fault: Callable[[VirtualRobot], None], words: str
) -> None:
    result = broken(robot, command, phase, fault)
    print(f"{fault.__name__} while {phase.value}: {result.reason}")
    assert result.outcome is Outcome.ABORTED
    assert any(word in result.reason for word in words.split("|")), result.reason
    assert robot.bench.tip_base()[2] >= LIFTED_M, "the stylus is up"
    named = command.split(":")[1]
    touched = {r["control"] for r in robot.take_records() if r["event"] in ("contact", "press", "collision")}
    assert touched <= ({named} if phase in (GoalPhase.CONTACT, GoalPhase.TURN) else set())
    assert np.isfinite(result.duration_s)
