"""The shipped limits of the space at the panel against what calibration and controller need of it."""

from __future__ import annotations

import math

import pytest
from support.parameter_files import CONFIG, parameters

from gantry_driver.core.configuration.machine_config import DriverConfig
from gantry_driver.core.job.controller_config import ControllerConfig
from icu_common.core.configuration.config import from_mapping
from icu_common.core.panel.panel_layout import load_layout

DRIVER = from_mapping(DriverConfig, parameters("serial_driver"))
CONTROLLER = from_mapping(ControllerConfig, parameters("gantry_controller"))


def test_the_calibration_stays_in_the_free_space() -> None:
    run = parameters("hand_eye", "run")
    deepest_m = -min(*run["heights_m"], run["held_out_height_m"])
    assert deepest_m <= DRIVER.envelope.free_space_m


def test_the_stylus_crosses_above_the_highest_control_of_any_layout() -> None:
    """The panel of the bench is 35 mm below home, leans, and is seen within 3 mm (``max_depth_error_m``)."""
    layouts = [load_layout(path) for path in (CONFIG / "scopes").glob("*.yaml")]
    highest_m = max(control.height_mm for layout in layouts for control in layout.controls) / 1000.0
    assert DRIVER.envelope.crossing_m + CONTROLLER.touch.ball_radius_m + highest_m <= 0.035 - 0.005


def test_a_correction_of_the_aim_is_allowed_where_the_controller_makes_it() -> None:
    approach_m = CONTROLLER.motion.approach_m * math.sqrt(2.0)
    assert CONTROLLER.max_correction_m + approach_m <= DRIVER.envelope.correction_m
    assert DRIVER.envelope.side_height_m <= CONTROLLER.touch.hover_m - CONTROLLER.max_depth_error_m


def test_a_press_of_the_controller_is_as_deep_as_the_guard_allows() -> None:
    assert pytest.approx(DRIVER.overtravel_m) == CONTROLLER.touch.overtravel_m
