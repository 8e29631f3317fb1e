"""Asks a running graph which topics its nodes read and publish."""

from __future__ import annotations

import time
from collections.abc import Callable, Collection
from dataclasses import dataclass

import rclpy
from rclpy.context import Context
from rclpy.node import Node

from icu_common.nodes.runtime import prepare_transport

NOT_COMPARED = ("/rosout", "/parameter_events", "/diagnostics", "/clock")
"""Topics of every node, whose contents depend on the computer or come from the player."""
_UNCHANGED_S, _LONGEST_S, _LOOK_S = 1.0, 60.0, 0.1


@dataclass(frozen=True, slots=True)
class GraphTopics:
    """Topics of a graph's nodes.

    Attributes
    ----------
    read
        Absolute names, sorted.
    published
        Types (``package/msg/Name``) by absolute name.
    """

    read: tuple[str, ...]
    published: dict[str, str]


def topics_of(nodes: Collection[tuple[str, str]], domain: int, stopping: Callable[[], bool]) -> GraphTopics:
    """Return the topics of nodes once discovery has found all of them and nothing new.

    Parameters
    ----------
    nodes
        Name and namespace of each.
    domain
        ROS domain of the graph.
    stopping
        Ends the wait.

    Raises
    ------
    TimeoutError
        If a node is not found.
    """
    prepare_transport()
    context = Context()
    rclpy.init(context=context, domain_id=domain)
    try:
        node = rclpy.create_node("bag_check", context=context, enable_rosout=False, start_parameter_services=False)
        return _settled(node, nodes, stopping)
    finally:
        context.try_shutdown()


def _settled(node: Node, nodes: Collection[tuple[str, str]], stopping: Callable[[], bool]) -> GraphTopics:
    begun_s = changed_s = time.monotonic()
    found: GraphTopics | None = None
    while not stopping():
        time.sleep(_LOOK_S)
        now_s = time.monotonic()
        missing = set(nodes) - set(node.get_node_names_and_namespaces())
        if not missing and (new := _look(node, nodes)) != found:
            found, changed_s = new, now_s
        elif found is not None and not missing and now_s - changed_s > _UNCHANGED_S:
            return found
        if now_s - begun_s > _LONGEST_S:
            raise TimeoutError(f"not found within {_LONGEST_S:g} s: {', '.join(sorted(n for n, _ in missing))}")
    raise TimeoutError("interrupted")


def _look(node: Node, nodes: Collection[tuple[str, str]]) -> GraphTopics:
    read: set[str] = set()
    published: dict[str, str] = {}
    for name, namespace in nodes:
        read |= {topic for topic, _ in node.get_subscriber_names_and_types_by_node(name, namespace)}
        published |= {topic: kinds[0] for topic, kinds in node.get_publisher_names_and_types_by_node(name, namespace)}
    compared = {topic: kind for topic, kind in sorted(published.items()) if topic not in NOT_COMPARED}
    return GraphTopics(read=tuple(sorted(read)), published=compared)
