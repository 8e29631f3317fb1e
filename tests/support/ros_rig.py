"""A private rclpy context for tests, and waiting on conditions instead of sleeping."""

from __future__ import annotations

import functools
import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, TypeVar

import pytest
import rclpy
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile

from icu_bringup.adapters.graph_names import hold, is_held
from icu_common.nodes.graph_node import GraphNode
from icu_common.nodes.runtime import prepare_transport

T = TypeVar("T", bound=Node)
Describe = Callable[[], Any]
LONGEST_TURN_S = 0.5
"""No more of a deadline passes between two looks: the test may have been held up, and what has come waits."""


@functools.cache
def domain_of_worker(base: int = 100, count: int = 100) -> int:
    """Return one of ``count`` ROS domains that no other test run, worker, graph or replay here uses until this ends.

    Up to 232 are valid. By process numbers alone two test runs met on a domain, and each received the other's messages.
    """
    name = os.environ.get("PYTEST_XDIST_WORKER")
    first = os.getpid() if name is None else os.getppid() * 16 + int(name[2:])
    for step in range(count):
        domain = base + (first + step) % count
        if not is_held(f"{domain}/") and not is_held(f"replay/{domain}") and hold(f"test/{domain}"):
            return domain
    raise RuntimeError(f"tests use all ROS domains from {base} to {base + count - 1}")


def keeping_all(profile: QoSProfile | int) -> QoSProfile:
    """Return what a reader asks for that misses nothing of such a publisher, however long it is held up."""
    if isinstance(profile, int):
        return QoSProfile(depth=1000)
    return QoSProfile(depth=1000, reliability=profile.reliability, durability=profile.durability)


class Ros:
    """Makes nodes in a private context and spins them until a condition holds."""

    def __init__(self, context: Context) -> None:
        self.context = context
        self.executor = SingleThreadedExecutor(context=context)
        self.nodes: list[Node] = []

    def node(self, make: Callable[..., T], parameters: dict[str, Any] | None = None, **kwargs: Any) -> T:
        """Make a node of a class whose constructor passes ``**kwargs`` on to ``rclpy.node.Node``."""
        overrides = [Parameter(name, value=value) for name, value in (parameters or {}).items()]
        node = make(context=self.context, parameter_overrides=overrides, **kwargs)
        self.executor.add_node(node)
        self.nodes.append(node)
        return node

    def plain(self, name: str = "probe") -> GraphNode:
        """Make a bare node for publishers and subscriptions of the test."""
        node = GraphNode(name, context=self.context)
        self.executor.add_node(node)
        self.nodes.append(node)
        return node

    def collect(self, node: Node, message_type: Any, topic: str, qos: Any = 10) -> list[Any]:
        """Subscribe and return the list that all messages will be appended to."""
        received: list[Any] = []
        node.create_subscription(message_type, topic, received.append, keeping_all(qos))
        return received

    def spin_until(self, condition: Callable[[], Any], within_s: float, describe: Describe | None = None) -> Any:
        """Spin until ``condition()`` is true and return its value; fail with what was seen after ``within_s``."""
        left_s, since_s = within_s, time.monotonic()
        while not (value := condition()):
            if left_s < 0:
                seen = f": {describe()}" if describe else ""
                pytest.fail(f"the condition did not hold within {within_s} s{seen}")
            self.executor.spin_once(timeout_sec=0.02)
            now_s = time.monotonic()
            left_s -= min(now_s - since_s, LONGEST_TURN_S)
            since_s = now_s
        return value

    def ask(self, client: Any, request: Any, within_s: float = 40.0) -> Any:
        """Return a service's answer; ask again, as one is lost where the server does not know of its client yet."""
        asked: list[tuple[float, Any]] = []

        def answered() -> Any:
            if not asked or time.monotonic() > asked[-1][0] + 4.0:
                asked.append((time.monotonic(), client.call_async(request)))
            return next((future for _, future in asked if future.done()), None)

        return self.spin_until(answered, within_s, lambda: f"{client.srv_name} asked {len(asked)} times").result()

    def close(self) -> None:
        """Close and destroy all nodes, then end the executor."""
        for node in self.nodes:
            self.executor.remove_node(node)
            close = getattr(node, "close", None)
            if close is not None:
                close()
            node.destroy_node()
        self.executor.shutdown()


@contextmanager
def participant(domain: int) -> Iterator[Ros]:
    """Take part in a domain by a context of its own, with discovery on this host only."""
    prepare_transport()
    context = Context()
    rclpy.init(context=context, domain_id=domain)
    rig = Ros(context)
    try:
        yield rig
    finally:
        rig.close()
        rclpy.shutdown(context=context)
