"""Plays a bag in step with a graph that was started with ``bring_up --in-step``.

The time stops until every process has processed a message and all messages that follow from it. Two parts of a
recording are adapted to the running graph:

- a message on ``bag/cue`` (std_msgs/String) names a Trigger service, which the player calls and which must succeed;
- the driver's answers get the names of the trajectories that the controller sends now, in their recorded order.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Collection, Sequence
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.srv import ListParameters
from rclpy.serialization import deserialize_message, serialize_message
from std_msgs.msg import String
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectory

from icu_bringup.adapters.bag.bag_reader import BagReader
from icu_bringup.adapters.bag.bags import BagError
from icu_bringup.nodes.bag_player import BagPlayer
from icu_common.adapters.steps.step_gate import StepGate
from icu_common.core.goals.intent import read_frame
from icu_common.nodes.graph_node import this_process
from icu_common.nodes.messages.answers import answer_of
from icu_common.nodes.messages.heads import stamp_ns
from icu_common.nodes.qos import RESULTS
from icu_common.nodes.runtime import RosSession

CUE, TRAJECTORY, ANSWER = "bag/cue", "gantry/trajectory", "gantry/trajectory_result"
SETTLED_S = 1.0
"""Seconds without a change before playback begins."""
_ASKED_AGAIN_S = 1.0
"""Seconds to wait for the answer of a service before it is called again."""
_LOOK_S = 0.0003
"""Seconds between two checks of the ledger while messages are being processed."""


class StepPlayer:
    """Publishes one message after the other through ``node``.

    Parameters
    ----------
    session, node
        Session that spins, and node that publishes.
    bag, topics
        The bag, and its played topics.
    patience_s
        Maximum seconds for a message to be processed, and for the graph to be complete.
    """

    def __init__(
        self, session: RosSession, node: BagPlayer, bag: BagReader, topics: Collection[str], patience_s: float
    ) -> None:
        self._session, self._node, self._patience_s = session, node, patience_s
        assert this_process.ledger is not None
        # This class has its own limit, which raises an error.
        self._gate = StepGate(this_process.ledger, patience_s=2 * patience_s, callback_patience_s=2 * patience_s)
        self._orders = _recorded_trajectories(bag)
        self._trajectories: list[str] = []
        self._shown_ns: int | None = None
        node.create_subscription(JointTrajectory, TRAJECTORY, self._on_trajectory, RESULTS)
        self._cues = {service: node.create_client(Trigger, service) for service in _cues(bag, topics)}

    def _on_trajectory(self, message: JointTrajectory) -> None:
        self._trajectories.append(read_frame(message.header.frame_id, stamp_ns(message.header.stamp))[0])

    def begin(self, processes: int) -> None:
        """Wait until this number of processes is present and matched.

        Raises
        ------
        BagError
            If they do not appear in time.
        """
        deadline_s, still_s = time.monotonic() + self._patience_s, time.monotonic()
        while self._session.goes_on and time.monotonic() - still_s < SETTLED_S:
            self._session.spin(0.05)
            if reason := self._missing(processes):
                if time.monotonic() > deadline_s:
                    raise BagError(reason)
                self._gate.restart()
                still_s = time.monotonic()
        for service in self._cues:
            self._reach(service)

    def _missing(self, processes: int) -> str:
        """Return the missing requirement of playback, "" if none is missing."""
        reasons = []
        if (found := self._gate.processes() - 1) < processes:  # minus the player itself
            reasons.append(f"{found} of {processes} processes play in step (was the graph started with --in-step?)")
        if topics := self._gate.unmatched():
            reasons.append(f"publishers and subscriptions have not all found each other on {', '.join(topics)}")
        if topics := self._gate.owed():
            reasons.append(f"messages are still being processed on {', '.join(topics)}")
        return "; ".join(reasons)

    def play(self, topic: str, stamp_ns: int, data: bytes) -> None:
        """Play one message at its time and wait until it has been processed.

        Raises
        ------
        BagError
            If that takes too long, or the service of a cue does not succeed.
        """
        if stamp_ns != self._shown_ns:
            self._node.show_time(stamp_ns)
            self._wait(f"the time of {topic}")
            self._shown_ns = stamp_ns
        if topic.endswith(CUE):
            self._call(deserialize_message(data, String).data)
        else:
            self._node.play(topic, self._answered(data) if topic.endswith(ANSWER) else data)
        self._wait(topic)

    def _wait(self, what: str) -> None:
        deadline_s = time.monotonic() + self._patience_s
        while self._session.goes_on and not self._gate.settled():
            self._session.spin(_LOOK_S)
            if time.monotonic() > deadline_s:
                owed = ", ".join(self._gate.owed())
                raise BagError(f"{what}: after {self._patience_s:g} s messages are still being processed on {owed}")

    def _answered(self, data: bytes) -> bytes:
        message: Any = deserialize_message(data, DiagnosticArray)
        for value in message.status[0].values:
            if value.key == "goal_id" and value.value in self._orders:
                number = self._orders.index(value.value)
                if number < len(self._trajectories):
                    value.value = self._trajectories[number]
        return bytes(serialize_message(message))

    def _reach(self, service: str) -> None:
        """Wait until the node of a service has discovered the receiver of its answers.

        A node that has not discovered it yet drops the answer, and only that node could detect it. Discovery announces
        the endpoints of a process in order (DDSI-RTPS 8.5.4, reliable), so a node that answers a client made now has
        discovered the earlier ones as well. Listing parameters may be repeated; a cue may not.
        """
        deadline_s = time.monotonic() + self._patience_s
        while (owner := self._owner(service)) is None:
            self._session.spin(0.05)
            if time.monotonic() > deadline_s or not self._session.goes_on:
                raise BagError(f"{service}: no node has this service")
        client = self._node.create_client(ListParameters, f"{owner}/list_parameters")
        try:
            while self._session.goes_on and time.monotonic() < deadline_s:
                future = client.call_async(ListParameters.Request()) if client.service_is_ready() else None
                again_s = time.monotonic() + _ASKED_AGAIN_S
                while self._session.goes_on and time.monotonic() < again_s:
                    self._session.spin(0.02)
                    if future is not None and future.done():
                        return
        finally:
            self._node.destroy_client(client)
        raise BagError(f"{service}: its node {owner} does not answer")

    def _owner(self, service: str) -> str | None:
        for name, namespace in self._node.get_node_names_and_namespaces():
            with contextlib.suppress(RuntimeError):  # rclpy's error for a node that has ended meanwhile
                offered = dict(self._node.get_service_names_and_types_by_node(name, namespace))
                if service in offered:
                    return f"{namespace.rstrip('/')}/{name}"
        return None

    def _call(self, service: str) -> None:
        client = self._cues[service]
        deadline_s = time.monotonic() + self._patience_s
        future = client.call_async(Trigger.Request())
        while self._session.goes_on and not future.done() and time.monotonic() < deadline_s:
            self._session.spin(0.02)
        answer = future.result() if future.done() else None
        if answer is None or not answer.success:
            raise BagError(f"{service}: {'no answer' if answer is None else answer_of(answer.message)}")
        print(f"{service}: {answer_of(answer.message)}")


def _cues(bag: BagReader, topics: Collection[str]) -> list[str]:
    """Return the services that the played messages on ``bag/cue`` name."""
    names = [name for name in topics if name.endswith(CUE)]
    return sorted({deserialize_message(data, String).data for _, _, data in bag.messages(names)})


def _recorded_trajectories(bag: BagReader) -> Sequence[str]:
    names = [topic.name for topic in bag.topics if topic.name.endswith(TRAJECTORY)]
    found = []
    for _, _, data in bag.messages(names):
        head = deserialize_message(data, JointTrajectory).header
        found.append(read_frame(head.frame_id, stamp_ns(head.stamp))[0])
    return found
