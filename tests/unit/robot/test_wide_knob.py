"""A wide knob on the whole robot: what moved is the bench's truth."""

from __future__ import annotations

from virtual_robot import VirtualRobot

from icu_common.core.results import Outcome


def test_the_marker_of_a_wide_knob_is_seen_wherever_the_turn_ended() -> None:
    robot = VirtualRobot(4, layout="ventilator_v1")
    robot.prepare(calibrate=False)
    robot.look_at_panel()
    result = robot.command("turn:SELECT:100")
    stands = robot.bench.state.knob_deg("SELECT")
    print(f"{result.outcome.value} {result.reason}, at {stands:.1f} degrees")
    assert result.outcome is Outcome.REACHED, result.reason
    assert abs(stands - 100) <= 3.0
