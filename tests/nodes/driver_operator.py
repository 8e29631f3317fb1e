"""The other side of the driver's topics, and parameters of a driver for tests in one process."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from nodes.grbl_board import GrblBoard
from sensor_msgs.msg import JointState
from std_msgs.msg import Empty, Header, String
from std_srvs.srv import SetBool, Trigger
from support.ros_rig import keeping_all
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from icu_common.core.geometry.frames import JOINTS
from icu_common.core.goals.results import GoalResult
from icu_common.nodes.messages.answers import answer_of
from icu_common.nodes.messages.results import result_of_message
from icu_common.nodes.qos import COMMAND, LATCHED, RESULTS, SENSOR

HOMED = (-359.0, -219.0, -1.0)
# On a busy machine the thread that waits and sends heartbeats, or the board, may be late without anybody being lost.
PATIENCE = {"heartbeat_timeout_s": 2.0, "goal_max_age_s": 4.0, "status_timeout_s": 10.0, "hold_timeout_s": 10.0}
# A node in this process does nothing while Python collects the garbage of all tests before it.
IN_PROCESS = {"node_silence_s": 0.5}
# Most tests are about something else than the panel: their whole travel is free space.
NO_PANEL = {"envelope.free_space_m": 0.06, "envelope.crossing_m": 0.06}


class Operator:
    """A client of the driver's topics: it sends goals and collects states and results."""

    def __init__(self, ros: Any, board: GrblBoard, name: str = "operator") -> None:
        self.ros, self.board = ros, board
        self.node = ros.plain(name)
        self.states: list[str] = []
        self.results: list[GoalResult] = []
        self.joints: list[JointState] = ros.collect(self.node, JointState, "joint_states", RESULTS)
        self.diagnostics: list[DiagnosticArray] = ros.collect(self.node, DiagnosticArray, "/diagnostics", RESULTS)
        self.node.create_subscription(
            String, "driver_state", lambda m: self.states.append(m.data), keeping_all(LATCHED)
        )
        self.node.create_subscription(
            DiagnosticArray,
            "trajectory_result",
            lambda m: self.results.append(result_of_message(m)),
            keeping_all(RESULTS),
        )
        self.heartbeat = self.node.create_publisher(Header, "heartbeat", SENSOR)
        self.trajectory = self.node.create_publisher(JointTrajectory, "trajectory", COMMAND)
        self.stop = self.node.create_publisher(Empty, "stop_request", RESULTS)
        self.beating = True
        self.node.create_timer(0.2, self._beat)

    def _beat(self) -> None:
        if self.beating:
            self.heartbeat.publish(Header(stamp=self.node.get_clock().now().to_msg()))

    def until(self, condition: Callable[[], Any], within_s: float = 15.0) -> Any:
        return self.ros.spin_until(condition, within_s, lambda: (self.states[-4:], self.results[-2:]))

    def state(self, text: str, within_s: float = 15.0) -> None:
        self.until(lambda: self.states and self.states[-1].startswith(text), within_s)

    def reported(self, text: str) -> dict[str, str]:
        """Return the values of the newest report on ``/diagnostics`` with this state, none before the first."""
        found = [m.status[0] for m in self.diagnostics if m.status and m.status[0].message == text]
        return {pair.key: pair.value for pair in found[-1].values} if found else {}

    def call(self, name: str, service: Any = Trigger, **fields: Any) -> Any:
        client = self.node.create_client(service, name)
        self.until(client.service_is_ready)
        future = client.call_async(service.Request(**fields))
        self.until(future.done)
        answer = future.result()
        if hasattr(answer, "message"):
            answer.message = str.__str__(answer_of(answer.message))
        return answer

    def go(
        self, *points: tuple[float, ...], names: tuple[str, ...] = JOINTS, last_m_s: float = 0.0, **head: Any
    ) -> None:
        message = JointTrajectory(joint_names=list(names), header=Header(**head))
        message.points = [JointTrajectoryPoint(positions=list(map(float, point))) for point in points]
        if last_m_s:
            message.points[-1].velocities = [last_m_s, 0.0, 0.0]
        self.until(lambda: self.trajectory.get_subscription_count() == 1)
        self.trajectory.publish(message)

    def ready(self) -> Operator:
        """Connect, enable, wait for the heartbeat to arrive, home."""
        self.state("unhomed")
        self.until(lambda: self.heartbeat.get_subscription_count() == 1)
        assert self.call("enable", SetBool, data=True).success
        self.until(lambda: self.call("home").success)
        self.state("idle")
        return self
