"""The whole robot in room `workshop`: ordinary webcams, a printed calibration board, belts, a panel as manufactured."""

from __future__ import annotations

import math

import numpy as np
import pytest
from support.virtual_robot import VirtualRobot

from icu_common.core.goals.results import Felt, Outcome

pytestmark = pytest.mark.long

SEED = 1
NAMES = ("TRIG_MENU", "CURSORS", "SAVE", "MENU")
RESTED_LOOKS = 35
"""A cell of the screen counts after 6 s at rest; the graph has watched it for longer when the robot is ready."""
HAND_MM = (190.0, 90.0, 80.0, 60.0)


@pytest.mark.timeout(1800)
def test_keys_are_pressed_and_a_hand_is_refused() -> None:
    """Before, this calibration failed, TRIG_MENU counted as hidden, and keys were touched 0.25 mm off in the mean."""
    print(f"seed {SEED}")
    robot = VirtualRobot(SEED, room="workshop")
    robot.prepare()
    robot.look_at_panel(RESTED_LOOKS)
    errors = []
    for name in NAMES:
        robot.look_at_panel()
        robot.run_for(0.5)
        robot.take_records()
        result = robot.command(f"press:{name}")
        records = robot.take_records()
        contact = next(r for r in records if r["event"] == "contact")
        errors.append(math.dist(contact["tip_panel_mm"][:2], contact["control_mm"][:2]))
        print(f"{name}: {result.outcome.value} {result.touch} {result.reason} {errors[-1]:.3f} mm")
        assert result.outcome is Outcome.REACHED and result.touch is Felt.PRESSED
        assert any(r["event"] == "press" and r["control"] == name for r in records)
    # CURSORS cannot be measured, so its own deviation of up to 0.28 mm remains.
    assert np.mean(errors) < 0.2 and max(errors) < 0.4
    robot.renderer.hide(HAND_MM)
    robot.look_at_panel()
    result = robot.command("press:RUN_STOP")
    print(f"hand: {result.outcome.value} {result.reason}")
    assert result.outcome is not Outcome.REACHED
    assert not any(r["event"] in ("contact", "press") for r in robot.take_records())
