"""A second program on a topic for one source: the stylus never moves down at that program's position."""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped
from std_msgs.msg import Header, String
from support.ros_rig import Ros, participant
from system.terminal_operator import Operator
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from icu_common.core.geometry.frames import JOINTS
from icu_common.core.geometry.geometry import Transform
from icu_common.core.goals.results import Outcome
from icu_common.nodes import qos
from icu_common.nodes.messages.heads import header
from icu_common.nodes.messages.places import pose_message, transform_of_pose

pytestmark = [pytest.mark.system, pytest.mark.alone, pytest.mark.timeout(600), pytest.mark.long]

OFF_M = 0.010
DETECTED_WITHIN_S = 1.0
RESTS_AT_M = (0.01, 0.01)
UP_M = -0.001
"""Height of the tip above which the stylus is up; the panel's face is at -0.035 m."""


@pytest.fixture
def foreign(running_graph: Any) -> Iterator[Ros]:
    """Another participant of the graph, with a node ``foreign``."""
    with participant(int(running_graph.environment["ROS_DOMAIN_ID"])) as ros:
        ros.plain("foreign")
        yield ros


class ForeignPose:
    """Publishes the panel's pose 50 times a second, to the right of where it is."""

    def __init__(self, foreign: Ros, operator: Operator) -> None:
        self.node, self._foreign = foreign.nodes[0], foreign
        poses = operator.ros.collect(operator.node, PoseStamped, "/panel/pose", qos.LATCHED)
        operator.ros.spin_until(lambda: poses, 15.0)
        true = transform_of_pose(poses[-1].pose)
        self._pose = true @ Transform(np.eye(3), np.array([OFF_M, 0.0, 0.0]))
        self._clock = operator.node.get_clock()
        self.began_s = time.monotonic()
        self._outlet = self.node.create_publisher(PoseStamped, "/panel/pose", qos.LATCHED)
        self._timer = self.node.create_timer(0.02, self._publish)

    def _publish(self) -> None:
        stamp = self._clock.now().nanoseconds
        self._outlet.publish(pose_message(self._pose, header(stamp, "camera_left_optical_frame")))

    def leave(self) -> None:
        self.node.destroy_timer(self._timer)
        self.node.destroy_publisher(self._outlet)


def both(operator: Operator, foreign: Ros, condition: Any, within_s: float) -> float:
    """Spin both participants until the condition holds; return the elapsed seconds."""
    began_s = time.monotonic()

    def held() -> Any:
        foreign.executor.spin_once(timeout_sec=0.0)
        return condition()

    operator.ros.spin_until(held, within_s, lambda: (operator.state, operator.driver_state, operator.results[-2:]))
    return time.monotonic() - began_s


def contacts(graph: Any, since: int) -> list[dict[str, Any]]:
    return [event for event in graph.truth_log()[since:] if event["event"] == "contact"]


def tip_z_m(graph: Any) -> float:
    return float(graph.bench().ask(do="truth")["tip_base_m"][2])


def goes_on(operator: Operator, graph: Any) -> None:
    """Assert that the next press reaches its key after a person's reset."""
    operator.reset()
    start = len(graph.truth_log())
    operator.command.publish(String(data="press:SINGLE id=afterwards"))
    result = operator.answer("afterwards")
    assert result.outcome is Outcome.REACHED, result
    assert [e["control"] for e in graph.truth_log()[start:] if e["event"] == "press"] == ["SINGLE"]
    operator.results.clear()


POSES = "two programs publish panel/pose: /foreign and /panel/recognition"


@pytest.mark.parametrize("when", ["before", "moving", "looking"])
def test_second_pose_holds_a_press_above_the_panel(
    running_graph: Any, operator: Operator, foreign: Ros, when: str
) -> None:
    operator.go(*RESTS_AT_M)
    start = len(running_graph.truth_log())
    pose = ForeignPose(foreign, operator) if when == "before" else None
    operator.command.publish(String(data="press:RUN_STOP id=honest"))
    if pose is None:
        operator.ros.spin_until(lambda: operator.state.startswith(when), 20.0, lambda: operator.state)
        pose = ForeignPose(foreign, operator)

    both(operator, foreign, lambda: operator.driver_state.startswith("stopped"), 20.0)
    took_s = time.monotonic() - pose.began_s
    result = operator.answer("honest")
    assert result.outcome in (Outcome.ABORTED, Outcome.REJECTED) and POSES in result.reason, result
    assert contacts(running_graph, start) == []
    both(operator, foreign, lambda: operator.state == f"stopped: {POSES}", 10.0)
    both(operator, foreign, lambda: tip_z_m(running_graph) > UP_M, 10.0)
    print(f"\nheld {took_s:.3f} s after the second publisher of panel/pose was made ({when})")
    assert took_s < DETECTED_WITHIN_S

    pose.leave()
    both(operator, foreign, lambda: operator.state == f"stopped: stop requested; {POSES}", 10.0)
    goes_on(operator, running_graph)


def test_foreign_heartbeat_and_trajectory_move_nothing(running_graph: Any, operator: Operator, foreign: Ros) -> None:
    operator.go(*RESTS_AT_M)
    node = foreign.nodes[0]
    started_at = list(running_graph.bench().ask(do="truth")["tip_base_m"])
    start = len(running_graph.truth_log())
    outlet = node.create_publisher(JointTrajectory, "/gantry/trajectory", qos.COMMAND)
    beat = node.create_publisher(Header, "/operator/heartbeat", qos.RESULTS)
    deep = JointTrajectory(joint_names=list(JOINTS), points=[JointTrajectoryPoint(positions=[0.17, 0.01, 0.06])])
    both(operator, foreign, lambda: outlet.get_subscription_count() and beat.get_subscription_count(), 15.0)
    beat.publish(Header(frame_id="foreign"))
    outlet.publish(deep)
    both(operator, foreign, lambda: "two programs publish" in operator.driver_state, 10.0)
    text = "two programs publish gantry/trajectory: /foreign and /gantry/gantry_controller"
    assert text in operator.driver_state or "operator/heartbeat: /foreign and /operator" in operator.driver_state
    outlet.publish(deep)
    operator.ros.spin_until(lambda: operator.state.startswith("stopped"), 10.0)
    assert contacts(running_graph, start) == []
    assert running_graph.bench().ask(do="truth")["tip_base_m"] == pytest.approx(started_at, abs=2e-4)
    node.destroy_publisher(outlet)
    node.destroy_publisher(beat)
    goes_on(operator, running_graph)
