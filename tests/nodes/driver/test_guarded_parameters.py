"""No safety parameter of driver or controller can change while the stylus presses."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from nodes.driver_operator import IN_PROCESS, NO_PANEL, PATIENCE, Operator
from nodes.gantry_bench import GantryBench
from nodes.grbl_board import GrblBoard
from rclpy.node import Node
from rclpy.parameter import Parameter

from gantry_driver.core.configuration.machine_config import DriverConfig
from gantry_driver.core.job.controller_config import ControllerConfig
from gantry_driver.nodes.serial_driver_node import SerialDriverNode
from icu_common.core.configuration.config import Config, ConfigItem, settings_of, to_mapping


def guards(config_class: type[Config]) -> list[ConfigItem]:
    return [i for i in settings_of(config_class) if i.setting.guards and not i.setting.read_only]


def other_values(item: ConfigItem, value: Any) -> list[Any]:
    """Return the ends of a setting's range, or the other value of a switch."""
    if isinstance(value, bool):
        return [not value]
    return [end for end in (item.setting.minimum, item.setting.maximum) if end != value]


def assert_all_refused(node: Node, config_class: type[Config], live: Any, reason: str) -> None:
    before = to_mapping(live.config)
    items = guards(config_class)
    assert len(items) >= 9
    for item in items:
        for value in other_values(item, before[item.name]):
            (answer,) = node.set_parameters([Parameter(item.name, value=value)])
            assert not answer.successful, (item.name, value)
            assert answer.reason.startswith(f"{item.name} can change only while the machine is at rest: "), answer
            assert reason in answer.reason
    assert to_mapping(live.config) == before


@pytest.fixture
def board(ros: Any, tmp_path: Path) -> Iterator[GrblBoard]:
    with contextlib.closing(GrblBoard(tmp_path)) as made:
        yield made
        ros.close()
        ros.nodes.clear()


def test_driver_keeps_its_safety_settings_while_the_stylus_presses_or_moves(ros: Any, board: GrblBoard) -> None:
    values = {"port": str(board.port), "trajectory_programs": "operator", **PATIENCE, **IN_PROCESS, **NO_PANEL}
    node = ros.node(SerialDriverNode, values)
    op = Operator(ros, board).ready()
    op.go((0.05, 0.05, 0.03), frame_id="down")
    op.state("moving")
    assert_all_refused(node, DriverConfig, node._live, "the driver is moving")
    op.until(lambda: op.results and op.results[-1].outcome.value == "reached")
    assert board.mpos()[2] == pytest.approx(-31.0, abs=0.1), "the stylus is down"
    assert_all_refused(node, DriverConfig, node._live, "the stylus is down")
    (free,) = node.set_parameters([Parameter("feed_m_s", value=0.05)])
    assert free.successful, "other parameters change at any time"
    op.go((0.05, 0.05, 0.0), frame_id="up")
    op.until(lambda: op.results[-1].goal_id == "up" and op.results[-1].outcome.value == "reached")
    (changed,) = node.set_parameters([Parameter("lift_on_stop", value=False)])
    assert changed.successful and node._live.config.lift_on_stop is False


def test_controller_keeps_its_safety_settings_while_the_stylus_is_extended(ros: Any) -> None:
    bench = GantryBench(ros)
    bench.see()
    bench.spin_until_state("ready")
    bench.readings = np.array([0.1, 0.1, 0.03])
    node = bench.controller
    ros.spin_until(lambda: node._controller.unrest(), 10.0)
    assert_all_refused(node, ControllerConfig, node._live, "the stylus is extended by 30.0 mm")
    bench.readings = np.zeros(3)
    ros.spin_until(lambda: not node._controller.unrest(), 10.0)
    (changed,) = node.set_parameters([Parameter("heartbeat_timeout_s", value=1.0)])
    assert changed.successful and node._controller.config.heartbeat_timeout_s == 1.0
