"""Show the gantry in the terminal: state, position, counts of lines and throughput. It moves nothing.

Names are relative, so ``--ros-args -r __ns:=/bed_1`` shows another robot, and ``-r gantry/driver_state:=driver_state``
a driver without the rest of the graph. Without a terminal it prints a line a second.
"""

from __future__ import annotations

import argparse
import math
import sys
import time
from collections.abc import Sequence

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import String

from gantry_driver.core.machine.monitor import Monitor
from icu_common.adapters.processes.program_end import ends_quietly, help_text
from icu_common.core.configuration.text_bounds import plain
from icu_common.core.geometry.frames import JOINTS
from icu_common.nodes.qos import LATCHED, RESULTS
from icu_common.nodes.runtime import own_arguments, ros_session

LIVE_S, PIPED_S = 0.1, 1.0


class MonitorNode(Node):
    """Feeds a :class:`~gantry_driver.core.machine.monitor.Monitor` from the topics."""

    def __init__(self, driver: str) -> None:
        super().__init__("gantry_monitor")
        self.monitor = Monitor()
        self._status_name = f"{driver}: board"
        self.create_subscription(String, "gantry/driver_state", self._on_state, LATCHED)
        self.create_subscription(JointState, "joint_states", self._on_joints, RESULTS)
        self.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, RESULTS)

    def _on_state(self, message: String) -> None:
        self.monitor.state = plain(message.data)

    def _on_joints(self, message: JointState) -> None:
        places = dict(zip(message.name, message.position))
        if all(name in places for name in JOINTS):
            self.monitor.reading([places[name] for name in JOINTS], time.monotonic())

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            if status.name == self._status_name:
                self.monitor.diagnostics({pair.key: pair.value for pair in status.values}, time.monotonic())


@ends_quietly
def main(arguments: Sequence[str] | None = None) -> int:
    """Show the values until Ctrl-C, or for ``--seconds``."""
    arguments = list(sys.argv if arguments is None else arguments)
    parser = argparse.ArgumentParser(prog="gantry_monitor", description=help_text(__doc__))
    parser.add_argument("--seconds", type=float, default=math.inf, metavar="S", help="end after S seconds")
    parser.add_argument("--driver", default="serial_driver", metavar="NAME", help="name of the driver's node")
    given = parser.parse_args(own_arguments(arguments))
    if not given.seconds > 0:
        parser.error(f"--seconds {given.seconds:g}; expected above 0")
    live = sys.stdout.isatty()
    with ros_session(arguments) as session:
        node = MonitorNode(given.driver)
        session.executor.add_node(node)
        end, shown_at = time.monotonic() + given.seconds, time.monotonic()
        try:
            while session.goes_on and time.monotonic() < end:
                session.spin(0.05)
                now = time.monotonic()
                if now - shown_at >= (LIVE_S if live else PIPED_S):
                    shown_at = now
                    text = node.monitor.line(now)
                    print(f"\r\x1b[K{text}" if live else text, end="" if live else "\n", flush=True)
        finally:
            if live:
                print(flush=True)
            session.end(node)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
