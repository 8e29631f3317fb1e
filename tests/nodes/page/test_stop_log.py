"""The bridge's log of a stop."""

from __future__ import annotations

from typing import Any

from rcl_interfaces.msg import Log

from icu_common.core.reasons.message import Message
from icu_common.nodes import qos
from scope_ui_bridge.nodes.bridge_node import BridgeNode

WITHIN_S = 20.0


def test_the_log_has_the_cause_of_a_stop_with_its_values(ros: Any) -> None:
    """It had the word "stop" only, and no log had the reason of the stop."""
    node = ros.node(BridgeNode, {"port": 0, "token_file": ""})
    heard: list[Log] = ros.collect(ros.plain("listener"), Log, "/rosout", qos.RESULTS)
    ros.spin_until(lambda: node.count_subscribers("/rosout"), WITHIN_S)
    cause = Message("bridge.stop_silent", cause="stopped_link_lost", silence_s=1.02, limit_s=1.0)
    node.outlets.stop(lambda done, text: None, cause)
    text = "stop: stopped_link_lost, silent for 1.02 s (limit 1.00 s)"
    ros.spin_until(lambda: any(line.msg == text for line in heard), WITHIN_S, lambda: [line.msg for line in heard])
