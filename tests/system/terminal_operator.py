"""A user at a terminal of the whole graph, for tests: a heartbeat, goals, and the answers to them."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable, Iterator
from typing import Any

import pytest
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PointStamped
from rclpy.parameter import Parameter
from std_msgs.msg import Header, String
from std_srvs.srv import Trigger
from support.ros_rig import Ros, keeping_all, participant

from icu_common.core.goals.results import GoalResult, Outcome
from icu_common.nodes import qos
from icu_common.nodes.messages.heads import header
from icu_common.nodes.messages.places import point_message
from icu_common.nodes.messages.results import result_of_message


class Operator:
    """A user at a terminal: a heartbeat, goals, and the answers to them."""

    def __init__(self, ros: Ros) -> None:
        self.ros = ros
        self.node = ros.plain("operator")
        self._clients: dict[str, Any] = {}
        self.heartbeat = self.node.create_publisher(Header, "/operator/heartbeat", qos.COMMAND)
        self.command = self.node.create_publisher(String, "/gantry/command", qos.COMMAND)
        self.goal = self.node.create_publisher(PointStamped, "/gantry/goal", qos.COMMAND)
        self._stamp_ns = 0
        self.results: list[GoalResult] = []
        self.node.create_subscription(
            DiagnosticArray,
            "/gantry/result",
            self._take_result,
            keeping_all(qos.RESULTS),
        )
        self.states: list[String] = []
        self.driver_states: list[String] = []
        self._state_ends: list[Any] = []
        self.subscribe_states()
        self.told: dict[str, str] = {}
        """Last report of each program about itself."""
        self.node.create_subscription(DiagnosticArray, "/diagnostics", self._take_told, keeping_all(qos.RESULTS))
        self.beating = True
        self.beats_heard = 0
        # A thread of its own: a test that waits for something else must not look like an operator who has gone.
        self._ended = threading.Event()
        self._heart = threading.Thread(target=self._beat, daemon=True)
        self._heart.start()

    def subscribe_states(self) -> None:
        """Take the states from their present publishers: a foreign program may have left messages in the queues."""
        for end in self._state_ends:
            self.node.destroy_subscription(end)
        self.states, self.driver_states = [], []
        taken = {"/gantry/state": self.states, "/gantry/driver_state": self.driver_states}
        profile = keeping_all(qos.LATCHED)
        self._state_ends = [
            self.node.create_subscription(String, topic, states.append, profile) for topic, states in taken.items()
        ]

    def wait_until_ready(self, tail: Callable[[], str]) -> None:
        """Wait until goals are taken; ``tail`` returns the graph's output, for readers of a failure."""
        self.ros.spin_until(
            lambda: self.state == "ready" and self.goal.get_subscription_count() and self.heartbeat_heard(),
            60.0,
            lambda: f"state {self.state!r}, told {self.told}; {tail()}",
        )
        # The controller is known by now, its source of time perhaps not yet.
        if self.node.count_publishers("/clock") or self.node.count_subscribers("/clock"):
            self.node.set_parameters([Parameter("use_sim_time", value=True)])
            self.ros.spin_until(lambda: self.node.get_clock().now().nanoseconds > 0, 10.0)

    def _take_result(self, message: DiagnosticArray) -> None:
        with contextlib.suppress(ValueError):  # a foreign program of a test may publish here
            self.results.append(result_of_message(message))

    def _take_told(self, message: DiagnosticArray) -> None:
        for status in message.status:
            values = ", ".join(f"{v.key} {v.value}" for v in status.values)
            self.told[status.name] = f"{status.message} ({values})"

    @property
    def state(self) -> str:
        return self.states[-1].data if self.states else ""

    @property
    def driver_state(self) -> str:
        return self.driver_states[-1].data if self.driver_states else ""

    def heartbeat_heard(self) -> bool:
        return self.beats_heard >= 5

    def _beat(self) -> None:
        while not self._ended.wait(0.1):
            if self.beating:
                self.beats_heard += self.heartbeat.get_subscription_count() >= 2  # driver and controller
                self.heartbeat.publish(Header(stamp=self.node.get_clock().now().to_msg(), frame_id="/operator"))

    def close(self) -> None:
        """End the heartbeat."""
        self._ended.set()
        self._heart.join()

    def answer(self, goal_id: str, within_s: float = 60.0) -> GoalResult:
        """Wait for the final answer to a goal."""

        def final() -> GoalResult | None:
            mine = [r for r in self.results if r.goal_id == goal_id and r.outcome.final]
            return mine[0] if mine else None

        result = self.ros.spin_until(final, within_s, lambda: f"{self.results[-3:]}, state {self.state!r}")
        assert isinstance(result, GoalResult)
        return result

    def accepted(self, goal_id: str) -> None:
        self.ros.spin_until(lambda: [r for r in self.results if r.goal_id == goal_id], 10.0)

    def touch_panel(self, x_m: float, y_m: float) -> GoalResult:
        stamp = self._new_stamp_ns()
        self.goal.publish(point_message((x_m, y_m, 0.0), header(stamp, "panel_link")))
        return self.answer(str(stamp))

    def _new_stamp_ns(self) -> int:
        """Return a goal's stamp, which is its name: simulated time may be stopped between two goals."""
        self._stamp_ns = max(self._stamp_ns + 1, int(self.node.get_clock().now().nanoseconds))
        return self._stamp_ns

    def move(self, x_m: float, y_m: float) -> str:
        stamp = self._new_stamp_ns()
        self.goal.publish(point_message((x_m, y_m, 0.0), header(stamp, "base_link")))
        return str(stamp)

    def go(self, x_m: float, y_m: float) -> None:
        result = self.answer(self.move(x_m, y_m))
        assert result.outcome is Outcome.REACHED, result

    def start_long_move(self) -> str:
        """Start a move of about two seconds, and return its id once the machine moves."""
        self.go(0.01, 0.01)
        goal = self.move(0.34, 0.2)
        self.ros.spin_until(lambda: self.driver_state == "moving", 10.0, lambda: (self.driver_state, self.results[-2:]))
        return goal

    def reset(self) -> None:
        """Reset after a stop; it is refused while the hold and the lift are not complete."""
        self.ros.spin_until(lambda: self.call("/gantry/reset").success, 30.0, lambda: self.driver_state)
        self.ros.spin_until(lambda: self.state == "ready", 30.0, lambda: self.state)

    def call(self, name: str) -> Any:
        if name not in self._clients:
            self._clients[name] = self.node.create_client(Trigger, name)
        client = self._clients[name]
        self.ros.spin_until(client.service_is_ready, 30.0)
        future = client.call_async(Trigger.Request())
        self.ros.spin_until(future.done, 30.0)
        return future.result()


@pytest.fixture
def operator(running_graph: Any, monkeypatch: pytest.MonkeyPatch) -> Iterator[Operator]:
    monkeypatch.setenv("ROS_LOG_DIR", running_graph.environment["ROS_LOG_DIR"])
    with participant(int(running_graph.environment["ROS_DOMAIN_ID"])) as ros:
        operator = Operator(ros)
        with contextlib.closing(operator):
            operator.wait_until_ready(running_graph.tail)
            yield operator
