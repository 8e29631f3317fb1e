"""The simulated bench as a program of the graph: parameters and diagnostics around the simulation's thread."""

from __future__ import annotations

import functools
from pathlib import Path
from typing import Any

from rclpy.publisher import Publisher
from rosgraph_msgs.msg import Clock
from std_msgs.msg import Float32

from icu_common.adapters.steps.step_ledger import LEDGER_VARIABLE
from icu_common.core.configuration.config import ConfigError
from icu_common.core.panel.panel_layout import load_layout
from icu_common.nodes.diagnostics import Diagnostics
from icu_common.nodes.graph_node import CLOCK_TOPIC, GraphNode, this_process
from icu_common.nodes.messages.heads import time_message
from icu_common.nodes.parameters import LiveParameters
from icu_common.nodes.qos import LATCHED
from icu_common.nodes.runtime import interruptible, run
from icu_common.nodes.timers import every
from icu_simulator.adapters.bench.simulation import Health, Simulation
from icu_simulator.adapters.bench.step_time import StepTime
from icu_simulator.core.configuration import BenchConfig

DIAGNOSTICS_S = 1.0
IMAGE_CLOCK_TOPIC = "clock_of_images"
"""Topic with the time of each image alone: a node that needs no finer time uses it as its ``/clock`` (graph.yaml)."""
FACTOR_S = 1.0
"""Wall seconds between two values of ``simulation_factor``."""


class BenchNode(GraphNode):
    """Runs the bench; the physical ground truth is not published on any topic."""

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("bench", **kwargs)
        self._settings = LiveParameters(self, BenchConfig, self._changed, self._check)
        config = self._settings.config
        steps = self._step_time(config) if config.stepped else None
        with interruptible():  # drawing the views takes seconds
            self._simulation = _simulation(config, steps)
        if steps is not None:
            self._factor = self.create_publisher(Float32, "simulation_factor", LATCHED)
            every(self, FACTOR_S, self._show_factor, wall=True)
        self._frames_before = 0
        self._diagnostics = Diagnostics(self)
        every(self, DIAGNOSTICS_S, self._report)
        self._simulation.start()

    def _step_time(self, config: BenchConfig) -> StepTime:
        if this_process.ledger is None:
            raise ConfigError(f"stepped needs a ledger of steps ({LEDGER_VARIABLE}), which bring_up makes")
        clocks = [self.create_publisher(Clock, topic, LATCHED) for topic in (CLOCK_TOPIC, IMAGE_CLOCK_TOPIC)]
        step, image = (functools.partial(_publish_time, clock) for clock in clocks)
        return StepTime(this_process.ledger, round(1e9 / config.step_rate_hz), step, image)

    def _show_factor(self) -> None:
        self._factor.publish(Float32(data=self._simulation.health().factor))

    def _check(self, config: BenchConfig) -> None:
        self._simulation.check(config)

    def _changed(self, config: BenchConfig) -> None:
        self._simulation.configure(config)

    def _report(self) -> None:
        health = self._simulation.health()
        rate = (health.frames_sent - self._frames_before) / DIAGNOSTICS_S
        self._frames_before = health.frames_sent
        level, message = _judged(health)
        values = [
            ("board_connected", health.board_connected),
            ("readers", health.readers),
            ("pairs_per_s", rate),
            ("render_ms", round(health.render_ms, 1)),
            ("bad_lines", health.bad_lines),
            ("simulation_factor", round(health.factor, 2)),
            ("left_behind", health.left_behind),
        ]
        self._diagnostics.tell(level, message, values)

    def close(self) -> None:
        """Stop the simulation and remove its sockets."""
        self._simulation.stop()


def _publish_time(clock: Publisher, now_ns: int) -> None:
    clock.publish(Clock(clock=time_message(now_ns)))


def _judged(health: Health) -> tuple[str, str]:
    if health.error:
        return "error", health.error
    if not health.board_connected:
        return "warn", "no motor positions: the mock board does not answer"
    return "ok", "running"


def _simulation(config: BenchConfig, steps: StepTime | None) -> Simulation:
    if not config.layout:
        raise ConfigError("layout is empty: the panel's layout file is needed")
    try:
        ledger = None if steps is None else this_process.ledger
        return Simulation(load_layout(Path(config.layout)), config, steps, ledger)
    except (ValueError, OSError) as error:
        raise ConfigError(str(error)) from error


def main() -> int:
    """Run the node until SIGINT or SIGTERM."""
    return run(BenchNode)


if __name__ == "__main__":
    raise SystemExit(main())
