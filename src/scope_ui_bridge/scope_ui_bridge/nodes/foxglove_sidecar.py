"""Show the graph in Foxglove, read only and on this machine only, while this program runs.

It has no services, no parameters and no client publishing, so nothing can be sent into the graph. However, the server
of foxglove-sdk accepts any origin: while it runs, any web page open in a browser on this machine can read the images.
So it is not part of the graph.
"""

from __future__ import annotations

import argparse
import importlib
import sys
from collections.abc import Sequence
from functools import partial
from typing import Any

from rclpy.qos import DurabilityPolicy
from rosbags.typesys import Stores, TypesysError, get_typestore

from icu_common.adapters.processes.program_end import ends_quietly
from icu_common.core.configuration.config import ConfigError
from icu_common.core.configuration.option_bounds import check_bounds
from icu_common.nodes import qos
from icu_common.nodes.graph_node import GraphNode
from icu_common.nodes.runtime import own_arguments, run
from icu_common.nodes.timers import every

PORT = 8765


class FoxgloveSidecar(GraphNode):
    """Forwards every topic of the graph unchanged (CDR bytes with the message's definition)."""

    def __init__(self, port: int, **kwargs: Any) -> None:
        super().__init__("foxglove_sidecar", **kwargs)
        import foxglove

        self._foxglove = foxglove
        self._types = get_typestore(Stores.ROS2_JAZZY)
        self._channels: dict[str, Any] = {}
        self._kept: dict[str, bytes] = {}
        try:
            self._server = foxglove.start_server(name="icu_gantry", host="127.0.0.1", port=port, capabilities=[])
        except RuntimeError as error:
            raise ConfigError(f"--port {port}: {error}") from error
        self.port = int(self._server.port)
        print(f"Foxglove: open ws://127.0.0.1:{self.port} with config/foxglove_layout.json", flush=True)
        every(self, 1.0, self._look_for_topics)

    def close(self) -> None:
        """End the server."""
        self._server.stop()

    def _look_for_topics(self) -> None:
        for topic, kinds in self.get_topic_names_and_types():
            if topic not in self._channels and kinds and self.count_publishers(topic):
                self._channels[topic] = self._open(topic, kinds[0])
        # The server keeps no messages, so latched ones are repeated for clients that connect later.
        for topic, data in self._kept.items():
            self._pass_on(topic, data)

    def _open(self, topic: str, kind: str) -> Any:
        """Return the channel of a topic, or None for an unknown type."""
        try:
            text = self._types.generate_msgdef(kind, ros_version=2)[0]
            package, _, name = kind.split("/")
            message_type = getattr(importlib.import_module(f"{package}.msg"), name)
        except (KeyError, ImportError, AttributeError, ValueError, TypesysError) as error:
            self.get_logger().warning(f"{topic} is left out: {kind}: {error}")
            return None
        schema = self._foxglove.Schema(name=kind, encoding="ros2msg", data=text.encode())
        channel = self._foxglove.Channel(topic, schema=schema, message_encoding="cdr")
        # A transient-local reader receives nothing from a volatile publisher.
        offered = [publisher.qos_profile.durability for publisher in self.get_publishers_info_by_topic(topic)]
        latched = all(durability == DurabilityPolicy.TRANSIENT_LOCAL for durability in offered)
        profile = qos.LATCHED if latched else qos.SENSOR
        heard = self._keep if latched else self._pass_on
        self.create_subscription(message_type, topic, partial(heard, topic), profile, raw=True)
        return channel

    def _keep(self, topic: str, data: bytes) -> None:
        self._kept[topic] = data
        self._pass_on(topic, data)

    def _pass_on(self, topic: str, data: bytes) -> None:
        self._channels[topic].log(bytes(data), log_time=int(self.get_clock().now().nanoseconds))


@ends_quietly
def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--port", type=int, default=PORT, help="TCP port on loopback (%(default)s)")
    given = list(sys.argv if arguments is None else arguments)
    options = parser.parse_args(own_arguments(given))
    try:
        check_bounds(options, port=(0, 65535))
        import foxglove  # noqa: F401
    except ValueError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    except ImportError:
        advice = f"{sys.executable} -m pip install foxglove-sdk==0.30.3"
        print(f"foxglove_sidecar: foxglove-sdk is missing; {advice}", file=sys.stderr)
        return 1
    return run(lambda: FoxgloveSidecar(options.port), given)


if __name__ == "__main__":
    raise SystemExit(main())
