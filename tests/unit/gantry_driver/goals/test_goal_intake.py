"""Where a gesture touches, asked before anything moves."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from unit.gantry_driver.controller_bench import CAMERA, CAMERA_FROM_BASE, CAMERA_FROM_PANEL, KNOB, PANEL

from gantry_driver.core.goals.goal_intake import find_touch
from gantry_driver.core.job.controller_config import ControllerConfig
from gantry_driver.core.job.effects import Knob
from gantry_driver.core.motion.motion_plan import MotionConfig, OutOfReach
from gantry_driver.core.motion.scene import Scene
from icu_common.core.panel.gesture import parse_gesture

AXES = np.array([[1.01, 0.0], [0.0, 1.0]])
SCENE = Scene(
    camera_from_base=CAMERA_FROM_BASE,
    camera_from_panel=CAMERA_FROM_PANEL,
    base_from_reading=AXES,
    panel=PANEL,
    camera=CAMERA,
)
KNOB_X_M = float((CAMERA_FROM_BASE.inverse() @ CAMERA_FROM_PANEL).apply(KNOB)[0] / AXES[0, 0])
"""The reading of x over the knob's middle."""


def test_the_whole_arc_of_a_turn_must_be_in_reach_by_the_calibrated_axes() -> None:
    narrow = ControllerConfig(motion=MotionConfig(x_max_m=KNOB_X_M + 0.002))
    find_touch(parse_gesture("turn:CH1_SCALE:20"), None, SCENE, narrow)
    with pytest.raises(OutOfReach, match=f"gantry_x_joint = .* lies outside 0.0000 to {KNOB_X_M + 0.002:.4f} m"):
        find_touch(parse_gesture("turn:CH1_SCALE:90"), None, SCENE, narrow)
    # The same arc by axes without a scale ends farther out still.
    with pytest.raises(OutOfReach):
        find_touch(parse_gesture("turn:CH1_SCALE:20"), None, replace(SCENE, base_from_reading=np.eye(2)), narrow)


def test_a_knob_that_was_not_read_yet_is_tried_by_any_turn() -> None:
    gesture = parse_gesture("set:CH1_SCALE:60")
    unread = find_touch(gesture, Knob(name="CH1_SCALE", way_deg=math.nan), SCENE, ControllerConfig())
    assert len(unread.arc) == 1
    assert 0 < np.linalg.norm(unread.arc[0, :2] - unread.in_base[:2]) < 2e-4
    read = find_touch(gesture, Knob(name="CH1_SCALE", way_deg=40.0, seen_deg=20.0), SCENE, ControllerConfig())
    assert len(read.arc) == 20


def test_a_stylus_of_two_positions_touches_where_it_ends() -> None:
    config = ControllerConfig(motion=MotionConfig(stylus_two_positions=True, stylus_max_m=0.04))
    touch = find_touch(parse_gesture("press:RUN_STOP"), None, SCENE, config)
    assert (touch.hover_z, touch.touch_z) == (0.0, -0.04)
