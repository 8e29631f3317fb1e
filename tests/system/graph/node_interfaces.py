"""Interfaces of each node of a running graph, in the form of `ros2 node info`, with its parameters.

`PYTHONPATH=tests python -m system.graph.node_interfaces /gantry/serial_driver ...` prints it for nodes in
ROS_DOMAIN_ID. To compare two versions of the project, print the interfaces of both and compare the texts.
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from rcl_interfaces.msg import ParameterDescriptor, ParameterType
from rcl_interfaces.srv import DescribeParameters, GetParameters, ListParameters
from rclpy.parameter import parameter_value_to_python
from support.ros_rig import Ros, participant

WITHIN_S = 60.0
KINDS = {
    getattr(ParameterType, f"PARAMETER_{name.upper()}"): name
    for name in ("bool", "integer", "double", "string", "bool_array", "integer_array", "double_array", "string_array")
}
PARTS: dict[str, str] = {
    "publishes": "get_publisher_names_and_types_by_node",
    "subscribes to": "get_subscriber_names_and_types_by_node",
    "serves": "get_service_names_and_types_by_node",
    "calls": "get_client_names_and_types_by_node",
}
"""Headings, and the methods of rclpy's Node with which `ros2 node info` asks for them."""
EVERY_NODE = "every node"
AT_TIMES = " (at times)"
"""Ends the line of an interface that a node has only on demand, such as a subscription to images."""

Interfaces = dict[str, dict[str, list[str]]]
"""Lines by heading by node."""


def interfaces_of(ros: Ros, nodes: Sequence[str], hide: Callable[[Any], Any] = lambda value: value) -> Interfaces:
    """Return the interfaces of nodes, given by their full names; ``hide`` replaces values that differ between runs.

    Interfaces that all of them have, such as the services for parameters, are listed once.
    """
    asking = ros.nodes[0]

    def missing() -> set[str]:
        present = asking.get_node_names_and_namespaces()
        return set(nodes) - {f"{space.rstrip('/')}/{name}" for name, space in present}

    ros.spin_until(lambda: not missing(), WITHIN_S, missing)
    parameters = {node: _parameters(ros, node, hide) for node in nodes}
    found: Interfaces = {}
    for node in nodes:
        space, _, name = node.rpartition("/")
        found[node] = {}
        for part, method in PARTS.items():
            topics = getattr(asking, method)(name, space or "/")
            found[node][part] = sorted(f"{_own(topic, node)}: {', '.join(types)}" for topic, types in topics)
        found[node]["parameters"] = parameters[node]
    if len(nodes) == 1:
        return found
    common = {part: set.intersection(*(set(one[part]) for one in found.values())) for part in found[nodes[0]]}
    for one in found.values():
        for part, lines in one.items():
            one[part] = [line for line in lines if line not in common[part]]
    return {EVERY_NODE: {part: sorted(lines) for part, lines in common.items()}, **found}


def seen_in(reads: Sequence[Interfaces]) -> Interfaces:
    """Return what several reads of the same nodes contain; what is not in each of them exists at times only."""
    return {
        node: {part: _marked([set(read[node][part]) for read in reads]) for part in parts}
        for node, parts in reads[0].items()
    }


def with_those_at_times(found: Interfaces, reference: Interfaces) -> Interfaces:
    """Return one read, with what the reference says to exist at times only, whether it exists now or not."""
    result = {node: dict(parts) for node, parts in found.items()}
    for node, parts in result.items():
        for part, lines in parts.items():
            at_times = {line for line in reference.get(node, {}).get(part, ()) if line.endswith(AT_TIMES)}
            now = {line.removesuffix(AT_TIMES) for line in at_times}
            parts[part] = sorted({*lines} - now | at_times)
    return result


def text_of(interfaces: Interfaces) -> str:
    """Return the interfaces as JSON with a line for each entry."""
    return json.dumps(interfaces, indent=1, sort_keys=True) + "\n"


def _marked(reads: Sequence[set[str]]) -> list[str]:
    always = set.intersection(*reads)
    return sorted(line if line in always else line + AT_TIMES for line in set.union(*reads))


def _own(name: str, node: str) -> str:
    return f"~{name.removeprefix(node)}" if name.startswith(f"{node}/") else name


def _parameters(ros: Ros, node: str, hide: Callable[[Any], Any]) -> list[str]:
    names = sorted(_ask(ros, node, ListParameters, "list_parameters").result.names)
    descriptors = _ask(ros, node, DescribeParameters, "describe_parameters", names=names).descriptors
    values = _ask(ros, node, GetParameters, "get_parameters", names=names).values
    return [
        f"{name}: {KINDS[value.type]} = {hide(parameter_value_to_python(value))!r}{_bounds(descriptor)}"
        for name, descriptor, value in zip(names, descriptors, values, strict=True)
    ]


def _bounds(descriptor: ParameterDescriptor) -> str:
    ranges = [f", {one.from_value:g} to {one.to_value:g}" for one in descriptor.floating_point_range]
    ranges += [f", {one.from_value} to {one.to_value}" for one in descriptor.integer_range]
    return "".join(ranges) + (", read only" if descriptor.read_only else "")


def _ask(ros: Ros, node: str, service: Any, name: str, **request: Any) -> Any:
    client = ros.nodes[0].create_client(service, f"{node}/{name}")
    try:
        return ros.ask(client, service.Request(**request))
    finally:
        ros.nodes[0].destroy_client(client)


def main(nodes: Sequence[str], environment: Mapping[str, str] = os.environ) -> None:
    with participant(int(environment.get("ROS_DOMAIN_ID", "0"))) as ros:
        ros.plain("node_interfaces")
        print(text_of(interfaces_of(ros, nodes)), end="")


if __name__ == "__main__":
    main(sys.argv[1:])
