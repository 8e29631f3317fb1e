"""Every button of every panel in config/scopes, pressed once by the whole robot with its cameras; truth is the bench's.

CH3 of mso_dark_6 is below a band of the ball's own colour: there the tip is measured off it.
"""

from __future__ import annotations

import math

import pytest
from support.parameter_files import CONFIG
from support.virtual_robot import VirtualRobot

from icu_common.core.goals.results import Outcome

pytestmark = pytest.mark.long

LAYOUTS = sorted(path.stem for path in (CONFIG / "scopes").glob("*.yaml"))
BEFORE_THE_BALLS_COLOUR = {("mso_dark_6", "CH3")}


@pytest.mark.timeout(480)  # a minute, on a computer that has nothing else to do
@pytest.mark.parametrize("layout", LAYOUTS)
def test_every_button_is_pressed_in_its_middle(layout: str) -> None:
    robot = VirtualRobot(7, layout=layout)
    robot.prepare(calibrate=False)
    buttons = [c for c in robot.layout.controls if c.kind == "button"]
    assert len(buttons) >= 4
    for button in buttons:
        robot.look_at_panel(3)  # as few as may agree
        robot.take_records()
        result = robot.command(f"press:{button.name}")
        records = robot.take_records()
        assert result.outcome is Outcome.REACHED, (button.name, result.reason)
        contacts = [r for r in records if r["event"] == "contact"]
        assert {r["control"] for r in contacts} == {button.name}
        assert not [r for r in records if r["event"] == "collision"]
        off_mm = math.dist(contacts[0]["tip_panel_mm"][:2], button.position_mm)
        by = dict(result.details)["measured_by"]
        print(f"{button.name}: {off_mm:.3f} mm off, told {1000 * result.error_m:.3f} by {by}")
        assert off_mm < 0.25 and result.error_m < 0.00025, button.name
        assert by == ("cameras off it" if (layout, button.name) in BEFORE_THE_BALLS_COLOUR else "cameras")
