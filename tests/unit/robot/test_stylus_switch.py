"""The whole robot with a switch in its stylus: the pin follows the spring, and the driver passes it on."""

from __future__ import annotations

import pytest
from support.virtual_robot import VirtualRobot

from gantry_driver.core.job.controller_messages import Joints
from gantry_driver.core.states.machine_states import Position
from icu_common.core.goals.results import Outcome

pytestmark = pytest.mark.long

SWITCH = {"stylus.switch.enabled": True, "stylus.switch.threshold_mm": 0.3, "stylus.switch.hysteresis_mm": 0.1}


class WatchedRobot(VirtualRobot):
    """Keeps what the bench and the driver have of the switch."""

    def __init__(self, *arguments, **settings) -> None:
        self.felt: list[tuple[float, float, bool]] = []
        self.told: list[tuple[float, float, bool | None]] = []
        super().__init__(*arguments, **settings)

    def _sample(self) -> None:
        super()._sample()
        self.felt.append((self.now, self.bench.touch.compression_mm, self.bench.switch_closed))

    def _tell(self, event) -> None:
        if isinstance(event, Joints):
            self.told.append((self.now, float(event.readings[2]), event.probe))
        super()._tell(event)


@pytest.mark.timeout(300)
def test_a_press_closes_the_switch_and_the_driver_reports_it() -> None:
    robot = WatchedRobot(5, bench={**SWITCH, "keys.kind": "dome"}, driver={"probe": "stylus_switch"})
    robot.prepare(calibrate=False)
    assert {probe for _, _, probe in robot.told} == {False}, "every position has the pin"
    assert dict(robot.driver.diagnostics())["probe_pin"] == "open"
    robot.felt.clear()
    robot.told.clear()
    result = robot.command("press:SAVE")
    assert result.outcome is Outcome.REACHED, result.reason
    closed = [(now, depth) for now, depth, acts in robot.felt if acts]
    assert closed and min(depth for _, depth in closed) >= 0.2
    assert max(depth for _, depth, acts in robot.felt if not acts) <= 0.35
    reported = [now for now, _, probe in robot.told if probe]
    assert len(reported) >= 2
    # At 50 reports a second: each comes within a report's period, its transfer and the message's way.
    assert 0 <= reported[0] - closed[0][0] < 0.06
    assert 0 <= reported[-1] - closed[-1][0] < 0.06
    assert robot.told[-1][2] is False


def test_without_the_parameter_nothing_is_passed_on() -> None:
    robot = WatchedRobot(5, bench=SWITCH)
    robot.until(lambda: robot.driver.state == "unhomed", 20.0)
    assert not robot.driver.home(robot.now)
    robot.until(lambda: robot.driver.state == "idle", 60.0)
    robot.board.board.set_probe(True)
    robot.run_for(0.3)
    assert {probe for _, _, probe in robot.told} == {None}
    assert Position(reading_m=(0, 0, 0)).probe is None
    assert dict(robot.driver.diagnostics())["probe_pin"] == "none"


def test_a_normally_closed_switch_needs_6() -> None:
    robot = WatchedRobot(
        5, bench={**SWITCH, "stylus.switch.contact": "normally_closed"}, driver={"probe": "stylus_switch"}
    )
    robot.until(lambda: robot.driver.state == "unhomed", 20.0)
    assert not robot.driver.home(robot.now)
    robot.until(lambda: robot.driver.state == "idle", 60.0)
    robot.told.clear()
    robot.run_for(0.5)
    assert {probe for _, _, probe in robot.told} == {True}, "the wrong setting shows at once, with the stylus up"
    robot.board.board.eeprom.values[6] = 1
    robot.told.clear()
    robot.run_for(0.5)
    assert {probe for _, _, probe in robot.told[2:]} == {False}


def test_a_key_without_force_closes_the_switch_only_at_the_end_of_its_stroke() -> None:
    """A key that gives way leaves the spring at its stop: contact without force is not felt."""
    robot = WatchedRobot(5, bench=SWITCH, driver={"probe": "stylus_switch"})
    robot.prepare(calibrate=False)
    robot.felt.clear()
    robot.take_records()
    assert robot.command("press:SAVE").outcome is Outcome.REACHED
    touched = next(r["time_s"] for r in robot.take_records() if r["event"] == "contact")
    closed = next(now for now, _, acts in robot.felt if acts)
    # 1.5 mm of stroke and 0.3 mm of compression at 10 mm/s.
    assert 0.16 < closed - touched < 0.3
    assert max(depth for now, depth, _ in robot.felt if now < touched + 0.13) < 0.05
