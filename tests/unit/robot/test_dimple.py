"""A knob with a dimple, turned by the ball in it, on the whole robot; what moved is the bench's truth."""

from __future__ import annotations

import numpy as np
import pytest
from support.virtual_robot import VirtualRobot

from icu_common.core.goals.results import Outcome

pytestmark = pytest.mark.slow


def test_a_knob_is_turned_by_the_ball_in_its_dimple() -> None:
    robot = VirtualRobot(4, layout="ventilator_v1")
    robot.prepare(calibrate=False)
    knob = robot.layout.control("SELECT")
    assert knob.dimple is not None
    bottom_mm = knob.height_mm - knob.dimple.depth_mm + 1000 * robot.controller.config.touch.ball_radius_m
    for command, goal in (("turn:SELECT:100", 100.0), ("set:SELECT:-45", -45.0)):
        robot.look_at_panel()
        robot.take_records()
        result = robot.command(command)
        records = robot.take_records()
        stands = robot.bench.state.knob_deg("SELECT")
        print(f"{command}: {result.outcome.value} {result.reason}, at {stands:.1f} degrees, {dict(result.details)}")
        assert result.outcome is Outcome.REACHED, result.reason
        assert abs((stands - goal + 180) % 360 - 180) <= 3.0
        assert abs((float(dict(result.details)["knob_deg"]) - stands + 180) % 360 - 180) < 2.0
        contacts = [r for r in records if r["event"] == "contact"]
        assert {r["control"] for r in contacts} == {"SELECT"}
        assert not [r for r in records if r["event"] == "collision"]
        np.testing.assert_allclose([r["tip_panel_mm"][2] for r in contacts], bottom_mm, atol=0.15)
