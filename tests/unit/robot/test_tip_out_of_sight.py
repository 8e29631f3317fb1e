"""A control before which the ball cannot be told from what is behind it, on the whole robot; its truth is the bench's."""

from __future__ import annotations

import math

from virtual_robot import VirtualRobot

from icu_common.core.results import Outcome


def test_a_button_below_a_band_of_the_balls_colour_is_pressed() -> None:
    robot = VirtualRobot(7, layout="mso_dark_6")
    robot.prepare()
    button = robot.layout.control("CH3")
    for effect in ("lamp off -> violet", "lamp violet -> off"):
        robot.look_at_panel()
        robot.take_records()
        result = robot.command("press:CH3")
        records = robot.take_records()
        details = dict(result.details)
        assert result.outcome is Outcome.REACHED, result.reason
        assert details["effect"] == effect
        contacts = [r for r in records if r["event"] == "contact"]
        assert {r["control"] for r in contacts} == {"CH3"}
        assert not [r for r in records if r["event"] == "collision"]
        at = contacts[0]["tip_panel_mm"]
        off_mm = math.dist(at[:2], button.position_mm)
        print(f"{effect}: {off_mm:.3f} mm beside, told {1000 * result.error_m:.3f} by {details['measured_by']}")
        assert off_mm < 0.25
