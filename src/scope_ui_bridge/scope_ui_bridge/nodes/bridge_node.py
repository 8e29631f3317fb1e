"""ROS node of the operator page: passes topics to the desk and the desk's decisions to the graph.

The executor runs in the main thread, the web server in its own. Callbacks convert a message and pass it on; none of
them waits. ``graph_outlets`` has the orders, ``scene_inlets``, ``machine_inlets``, ``shown_topics`` and
``program_watch`` the subscriptions.

On SIGUSR1 it makes a new sign-in token (the old one becomes void), prints it and writes it to the token file.
"""

from __future__ import annotations

import secrets
import signal
import socket
import sys
from typing import Any

from icu_common.adapters.real_time import BRIDGE, ask_for_real_time
from icu_common.core.configuration.config import ConfigError
from icu_common.nodes.graph_node import GraphNode
from icu_common.nodes.parameters import LiveParameters
from icu_common.nodes.runtime import run
from icu_common.nodes.timers import every
from scope_ui_bridge.adapters.web.web_server import WebServer
from scope_ui_bridge.core.access import Role, SignIn
from scope_ui_bridge.core.config import BridgeConfig
from scope_ui_bridge.core.desk import Desk
from scope_ui_bridge.nodes.arrival import Arrival
from scope_ui_bridge.nodes.bridge_files import TokenFile, open_audit, read_layout, read_sequences
from scope_ui_bridge.nodes.graph_outlets import GraphOutlets
from scope_ui_bridge.nodes.machine_inlets import MachineInlets
from scope_ui_bridge.nodes.program_watch import ProgramWatch
from scope_ui_bridge.nodes.scene_inlets import SceneInlets
from scope_ui_bridge.nodes.shown_topics import ShownTopics
from scope_ui_bridge.nodes.simulated_clock import SimulatedClock


class BridgeNode(GraphNode):
    """Serves the operator page: owns the desk, the web server, and their connections to the graph."""

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("ui_bridge", **kwargs)
        parameters = LiveParameters(self, BridgeConfig, self._on_config, unrest=lambda: self._desk.machine.unrest())
        config = parameters.config
        layout = read_layout(config)
        robot = f"{socket.gethostname()}{self.get_namespace()}"
        self._desk = Desk(config, secrets.token_hex(8), layout.title if layout else "", robot)
        self._desk.sequence.stored = read_sequences(config, self._report)
        self._token_file = TokenFile(config, self._report)
        self.outlets = GraphOutlets(self)
        sign_in = SignIn(lambda: secrets.token_urlsafe(32), config.session_lifetime_s, Role(config.token_role))
        self._server = WebServer(config, self._desk, sign_in, self.outlets, open_audit(config))
        arrival = Arrival(config.replay, self.outlets.ros_ns)
        labels = {control.name: control.label for control in layout.controls} if layout else {}
        self._scene = SceneInlets(self, self._server, self._desk, arrival, labels)
        self._machine = MachineInlets(self, self._server, self._desk, config.replay)
        self._shown = ShownTopics(self, self._server, self._desk, arrival)
        self.programs = ProgramWatch(self, self._server, self._desk)
        try:
            self._server.start()
        except ConfigError:
            self._server.close()
            raise
        self._server.post(self._desk.begun)
        every(self, 1.0, self._check_server, wall=True)
        self._simulated_clock = SimulatedClock(self)
        self.issue_token()

    @property
    def url(self) -> str:
        """The page's address, without a token."""
        return self._desk.config.url(self._server.port)

    def issue_token(self) -> None:
        """Make a new sign-in token, print the page's address with it, and write it to the token file."""
        self._server.new_token(self._announce)

    def close(self) -> None:
        """End the server; without its heartbeat the driver stops."""
        self._server.close()
        self.programs.close()
        self._token_file.remove()

    def _announce(self, token: str) -> None:
        print(f"Operator page: {self.url}?token={token}", flush=True)
        self._token_file.write(token)

    def _report(self, text: str) -> None:
        self.get_logger().error(text)

    def _check_server(self) -> None:
        if not self._server.alive:
            raise RuntimeError("the web server has ended; the bridge ends too, so that bring-up sees it")

    def _on_config(self, config: BridgeConfig) -> None:
        self._server.mailbox.each(self._use_config, config)

    def _use_config(self, config: BridgeConfig) -> None:
        self._desk.config = config


def _make(**options: Any) -> BridgeNode:
    node = BridgeNode(**options)
    signal.signal(signal.SIGUSR1, lambda number, frame: node.issue_token())
    return node


def main() -> int:
    if refusal := ask_for_real_time(BRIDGE):
        print(f"ui_bridge: {refusal}; under load a motion may be stopped, see docs/how-to/hardware.md", file=sys.stderr)
    return run(_make)


if __name__ == "__main__":
    raise SystemExit(main())
