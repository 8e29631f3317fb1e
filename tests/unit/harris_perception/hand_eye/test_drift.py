"""The watch over a calibration in use: what it says when the tip or a control is not where it should be."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from unit.harris_perception.rectified_pair import stored_calibration

from harris_perception.core.hand_eye.calibration_file import StoredCalibration
from harris_perception.core.hand_eye.drift import DriftConfig, DriftWatch
from harris_perception.core.hand_eye.tip_samples import Sample
from icu_common.core.geometry.geometry import Transform

POSE = Transform(np.diag([1.0, -1.0, -1.0]), np.array([-0.17, 0.09, 0.66]))
PANEL = Transform(np.eye(3), np.array([0.02, 0.025, -0.035]))
CONTROLS = {"RUN_STOP": np.array([0.208, 0.127, 0.003]), "MENU": np.array([0.02, 0.01, 0.003])}


def stored(mounting: str = "fixed") -> StoredCalibration:
    return dataclasses.replace(
        stored_calibration(POSE, np.array([[1.003, -0.002], [0.0, 0.998]])),
        stylus_direction=np.array([0.001, 0.0, -1.0]),
        right=None,
        mounting=mounting,
        base_from_panel=PANEL,
    )


def sample(calibration: StoredCalibration, off: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Sample:
    reading = np.array([0.2, 0.1, 0.01])
    tip = calibration.tip_in_camera(reading) + off
    return Sample(reading=reading, tip=tip, covariance=np.zeros((3, 3)))


def moved(dx: float) -> Transform:
    return Transform(PANEL.rotation, PANEL.translation + (dx, 0.0, 0.0))


@pytest.mark.parametrize("mounting", ["fixed", "carriage"])
def test_expected_tip_follows_the_mounting(mounting: str) -> None:
    tip = stored(mounting).tip_in_camera(np.array([0.2, 0.1, 0.01]))
    x, y = (0.2004, 0.0998) if mounting == "fixed" else (0.0, 0.0)
    np.testing.assert_allclose(tip, POSE.apply([x + 0.00001, y, -0.01]), atol=1e-12)


def test_everything_in_its_place_says_nothing() -> None:
    watch = DriftWatch(DriftConfig(), stored())
    for _ in range(10):
        watch.tip(sample(stored(), (0.0002, 0.0, 0.0005)))
        watch.panel(moved(0.0005), CONTROLS)
    assert watch.text == ""
    assert watch.tip_m == pytest.approx(0.00054, abs=1e-5)
    assert watch.control_m == pytest.approx(0.0005, abs=1e-9)


def test_a_tip_elsewhere_means_a_moved_camera_or_machine() -> None:
    watch = DriftWatch(DriftConfig(times=3), stored())
    for count in range(3):
        assert watch.text == "", count
        watch.tip(sample(stored(), (0.002, 0.0, 0.0)))
        watch.panel(moved(0.002), CONTROLS)
    assert watch.text == (
        "the tip is 2.0 mm off its calibrated position and RUN_STOP is 2.0 mm off its position at the "
        "calibration: a camera or the machine has moved: calibrate again"
    )
    watch.tip(sample(stored()))
    watch.panel(PANEL, CONTROLS)
    assert watch.text == ""


def test_a_control_elsewhere_with_the_tip_in_place_means_a_moved_panel() -> None:
    watch = DriftWatch(DriftConfig(times=2), stored())
    c, s = np.cos(0.02), np.sin(0.02)
    turn = Transform(np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]), np.zeros(3))
    for _ in range(2):
        watch.tip(sample(stored()))
        watch.panel(PANEL @ turn, CONTROLS)
    assert watch.text.startswith("RUN_STOP is 4.9 mm off its position at the calibration: the panel has moved")


def test_one_wrong_sighting_is_no_drift() -> None:
    watch = DriftWatch(DriftConfig(times=3), stored())
    for off in (0.002, 0.0, 0.002, 0.0, 0.002):
        watch.tip(sample(stored(), (off, 0.0, 0.0)))
        assert watch.text == ""


def test_without_a_known_panel_the_first_one_counts() -> None:
    watch = DriftWatch(DriftConfig(times=1), dataclasses.replace(stored(), base_from_panel=None))
    watch.panel(moved(0.05), CONTROLS)
    assert watch.text == ""
    watch.panel(moved(0.052), {})
    assert watch.text.startswith("the panel's corner is 2.0 mm off its position")
