"""Queries a running graph for the types of its topics."""

from __future__ import annotations

import threading
import time
from collections.abc import Collection

import rclpy
from rclpy.context import Context

from icu_common.nodes.runtime import prepare_transport

_LONGEST_S, _LOOK_S = 60.0, 0.05


def types_of(topics: Collection[str], domain: int, stop: threading.Event) -> dict[str, str]:
    """Return the type (``package/msg/Name``) of each topic, once discovery has found all of them.

    Parameters
    ----------
    topics
        Absolute names.
    domain
        ROS domain of the graph.
    stop
        Ends the wait when it is set.

    Raises
    ------
    TimeoutError
        If a topic is not found.
    """
    prepare_transport()
    context = Context()
    rclpy.init(context=context, domain_id=domain)
    try:
        node = rclpy.create_node("bag_check", context=context, enable_rosout=False, start_parameter_services=False)
        end_s = time.monotonic() + _LONGEST_S
        while not stop.is_set():
            found = {name: kinds[0] for name, kinds in node.get_topic_names_and_types() if name in topics}
            if not (missing := set(topics) - set(found)):
                return found
            if time.monotonic() > end_s:
                raise TimeoutError(f"not found within {_LONGEST_S:g} s: {', '.join(sorted(missing))}")
            stop.wait(_LOOK_S)
        raise TimeoutError("interrupted")
    finally:
        context.try_shutdown()
