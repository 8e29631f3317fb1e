"""Codes of a state topic, which its program reports on ``/diagnostics`` with the text.

The value ``topic`` of such a status is the full name of the state topic, and its message is the same text. It also has
the code and the values of this text (:data:`icu_common.core.reasons.message.MESSAGE`), and the code by which programs
decide.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node

from icu_common.core.configuration.text_bounds import plain
from icu_common.core.reasons.codes import TOPIC, StateReports
from icu_common.nodes import qos
from icu_common.nodes.messages.results import message_of, pairs_of


def code_values(topic: str, values: Mapping[str, str]) -> list[tuple[str, str]]:
    """Return the code and its values as values of a status whose message is the state on a topic, by its full name."""
    return [(TOPIC, topic), *values.items()]


class StateCodes:
    """Follows the reports of the state on one topic.

    Parameters
    ----------
    node
        The node that subscribes.
    topic
        The state topic, as the node subscribes to it.
    heard
        Called after each report of this state.
    """

    def __init__(self, node: Node, topic: str, heard: Callable[[], object] = lambda: None) -> None:
        self._node, self._topic, self._heard, self._reports = (
            node,
            node.resolve_topic_name(topic),
            heard,
            StateReports(),
        )
        self._others: dict[str, StateReports] = {}
        node.create_subscription(DiagnosticArray, "/diagnostics", self._on_report, qos.REPORTS)

    def values_of(self, text: str) -> Mapping[str, str] | None:
        """Return the code and its values that were reported with the text of a state; None if none were yet."""
        return self._reports.values_of(text)

    def message_of(self, text: str) -> str:
        """Return the message that was reported with the text of a state; the text alone if none was yet."""
        return self._reports.message_of(text)

    def of_another(self, topic: str) -> StateReports:
        """Follow the reports of one more state topic with the same subscription."""
        return self._others.setdefault(self._node.resolve_topic_name(topic), StateReports())

    def _on_report(self, message: DiagnosticArray) -> None:
        for status in message.status:
            values = pairs_of(status)
            if (other := self._others.get(values.get(TOPIC, ""))) is not None:
                other.take(plain(status.message), values, message_of(status))
            if values.get(TOPIC) == self._topic:
                self._reports.take(plain(status.message), values, message_of(status))
                self._heard()
