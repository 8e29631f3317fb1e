"""The graph by simulated time: a busy computer makes it slow, and nothing else."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import CameraInfo
from std_msgs.msg import Float32, String
from system.terminal_operator import Operator

from icu_common.core.goals.results import Outcome
from icu_common.nodes import qos
from icu_common.nodes.messages.heads import stamp_ns

pytestmark = [pytest.mark.system, pytest.mark.alone, pytest.mark.timeout(300), pytest.mark.long]
BUSY_PROGRAMS = 16
WORSE_MM = 0.06
"""Difference of two touches of one place: each touch has images with noise of their own."""


@pytest.fixture
def busy_computer() -> Iterator[None]:
    """Programs that use all processor time that they get."""
    # Linux may divide the processor among sessions first: with one for all of them the graph would keep a half.
    command = [sys.executable, "-c", "while True: pass"]
    running = [subprocess.Popen(command, start_new_session=True) for _ in range(BUSY_PROGRAMS)]
    yield
    for process in running:
        process.kill()
        process.wait()


def press(running_graph: Any, operator: Operator, control: str) -> np.ndarray:
    """Press a control and return where the ball truly was, in mm of the panel."""
    seen = len(running_graph.truth_log())
    goal_id = f"press-{control}-{seen}"
    operator.command.publish(String(data=f"press:{control} id={goal_id}"))
    result = operator.answer(goal_id, within_s=200.0)
    assert result.outcome is Outcome.REACHED, result
    events = [e for e in running_graph.truth_log()[seen:] if e["event"] == "press"]
    assert [e["control"] for e in events] == [control]
    return np.array(events[0]["tip_panel_mm"][:2])


def test_clock_and_images_have_steps_of_their_own_whatever_the_wall_s(running_graph: Any, operator: Operator) -> None:
    ros = operator.ros
    node = ros.plain("watcher")
    clocks = ros.collect(node, Clock, "/clock", qos.RESULTS)
    infos = ros.collect(node, CameraInfo, "/stereo/left/camera_info", qos.IMAGES)
    ros.spin_until(lambda: len(infos) > 20 and len(clocks) > 60, 60.0)
    times = np.array([stamp_ns(message.clock) for message in clocks])
    assert set(np.diff(times)) == {round(1e9 / 15)}, "at rest a step lasts until the next image"
    stamps = np.array([stamp_ns(message.header.stamp) for message in infos])
    assert set(np.diff(stamps)) == {round(1e9 / 15)}
    press(running_graph, operator, "MATH")
    steps = np.diff([stamp_ns(message.clock) for message in clocks])
    assert np.sum(abs(steps - 1e9 / 60) < 2) > 60, "short steps while the machine moves"
    assert set(np.diff([stamp_ns(message.header.stamp) for message in infos])) == {round(1e9 / 15)}


def test_touches_on_a_busy_computer_are_as_precise(
    running_graph: Any, operator: Operator, request: pytest.FixtureRequest
) -> None:
    controls = ("CURSORS", "MATH")
    free = {control: press(running_graph, operator, control) for control in controls}
    request.getfixturevalue("busy_computer")
    factors = operator.ros.collect(operator.node, Float32, "/simulation_factor", qos.LATCHED)
    busy = {control: press(running_graph, operator, control) for control in controls}
    for control in controls:
        assert np.linalg.norm(busy[control] - free[control]) < WORSE_MM, (control, free, busy)
    assert min(message.data for message in factors) < 0.9, "the computer was not busy"
