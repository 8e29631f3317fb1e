"""Overlay geometry against pinhole arithmetic."""

from __future__ import annotations

import numpy as np
import pytest
from support.pinhole import pinhole as camera
from unit.scope_ui_bridge.desk_rig import FACES, Rig, pose, scene

from icu_common.core.geometry.geometry import Transform
from scope_ui_bridge.core.video import VideoScene, labels_of


def pinhole(x_m: float, y_m: float, z_m: float) -> tuple[float, float]:
    """Return the pixel of a point of the panel by hand: no distortion, panel 0.65 m away, facing the camera."""
    depth = 0.65 - z_m
    return 639.5 + 1700 * (x_m - 0.16) / depth, 359.5 - 1700 * (y_m - 0.075) / depth


def flat_scene() -> VideoScene:
    made = scene()
    made.left, made.right = camera(), camera("right", baseline_m=0.12)
    made.changed()
    return made


def test_a_controls_top_face_is_drawn_at_its_height() -> None:
    (button, *_rest) = flat_scene().panel("left")["controls"]
    expected = [pinhole(0.2 + sx * 0.008, 0.12 + sy * 0.0045, 0.003) for sx, sy in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
    assert np.abs(np.array(button["outline"]) - expected).max() < 0.06
    low, high = np.min(expected, axis=0), np.max(expected, axis=0)
    assert button["box"] == pytest.approx([*low, *(high - low)], abs=0.11)


def test_in_the_right_picture_everything_is_shifted_by_the_disparity() -> None:
    made = flat_scene()
    left, right = made.panel("left"), made.panel("right")
    by_name = {control["name"]: control for control in right["controls"]}
    for face, control in zip(FACES, left["controls"]):
        shift = np.array(control["outline"]) - np.array(by_name[face.name]["outline"])
        assert shift == pytest.approx(np.tile([1700 * 0.12 / (0.65 - face.centre[2]), 0], (len(shift), 1)), abs=0.11)


def test_no_two_controls_are_called_alike_and_none_by_a_name_that_cannot_be_seen() -> None:
    written = {"UP": "Volume", "DOWN": " volume ", "STOP_KEY": "\u200b", "BELL": "\U0001f514", "MUTE": "إيقاف"}
    assert labels_of([*written, "SET", "BED_7"], written) == {
        "UP": "Volume (UP)",
        "DOWN": "volume (DOWN)",
        "STOP_KEY": "Stop key",
        "BELL": "\U0001f514",
        "MUTE": "إيقاف",
        "SET": "Set",
        "BED_7": "Bed 7",
    }


def test_distortion_bends_the_panels_outline() -> None:
    outline = np.array(scene().panel("left")["outline"])
    bottom = outline[:8]
    assert len(outline) == 32
    assert np.ptp(bottom[:, 1]) > 0.5
    assert np.abs(outline[0] - pinhole(0, 0, 0)).max() < 12


def test_controls_outside_the_picture_are_left_out() -> None:
    made = flat_scene()
    made.place_panel(pose(0.22))
    # 0.22 m to the right: RUN_STOP at 0.2 + 0.22 - 0.16 = 0.26 m is at 639.5 + 680 px, outside 1280
    assert made.panel("left")["controls"] == []
    assert made.panel("left")["outline"]


def test_noise_of_the_pose_changes_nothing_and_a_shift_does() -> None:
    made = scene()
    version = made.version
    made.place_panel(pose(0.00005))
    assert made.version == version
    assert made.camera_from_panel is not None
    assert made.camera_from_panel.translation[0] == pytest.approx(-0.16 + 0.00005), "checks use the newest pose"
    made.place_panel(pose(0.001))
    assert made.version == version + 1


def test_a_pixel_and_its_panel_point_belong_together() -> None:
    made = scene()
    for x, y in ((0.02, 0.02), (0.3, 0.14), (0.16, 0.075)):
        pixel = made.project("left", pose().apply(np.array([x, y, 0.0])))
        assert pixel is not None
        assert made.panel_point((pixel[0, 0], pixel[0, 1])) == pytest.approx([x, y, 0.0], abs=1e-6)
    assert made.on_panel(np.array([0.31, 0.14, 0.0]))
    assert not made.on_panel(np.array([0.33, 0.14, 0.0]))


def test_tip_and_target_are_projected_and_old_tips_are_not() -> None:
    made = flat_scene()
    made.tip, made.tip_ns = np.array([0.0, 0.0, 0.5]), 10_000_000_000
    made.target = ("base_link", np.array([0.01, 0.0, 0.0]))
    assert made.moving_parts("left", 10_100_000_000) == {"tip": [639.5, 359.5], "target": None}
    made.camera_from_base = Transform(np.eye(3), np.array([0.0, 0.0, 0.5]))
    assert made.moving_parts("left", 10_600_000_000) == {"tip": None, "target": [673.5, 359.5]}
    made.target = ("panel_link", np.array([0.16, 0.075, 0.0]))
    assert made.moving_parts("left", 0)["target"] == [639.5, 359.5]
    made.target = ("nowhere", np.zeros(3))
    assert made.moving_parts("left", 0)["target"] is None


def test_the_way_is_planned_to_the_selection_and_then_the_one_that_is_driven() -> None:
    rig = Rig()
    desk = rig.desk
    assert desk.tip_path.message("left") == {"path": [], "planned": True}
    rig.select(control="RUN_STOP")
    desk.machine.set_position(0.1, 0.05, 0.02, rig.now)
    assert desk.tip_path.message("left")["path"] == [], "where the gantry is, is not known before the calibration"
    # base_link: as the panel's frame, 30 mm before its face
    base = Transform(pose().rotation, pose().apply(np.array([0.0, 0.0, 0.03])))
    desk.scene.camera_from_base = base
    before = [[0.1, 0.05, -0.02], [0.1, 0.05, 0.0], [0.2, 0.12, 0.0], [0.2, 0.12, -0.027]]
    shown = desk.tip_path.message("left")
    assert shown["planned"]
    assert np.allclose(shown["path"], desk.scene.project("left", base.apply(np.array(before))), atol=0.06)
    assert desk.tip_path.message("right")["path"][0][0] < shown["path"][0][0]
    desk.machine.set_state("driver", "moving")
    assert desk.tip_path.message("left") == {"path": [], "planned": False}, "not what was planned, but what is driven"
    desk.tip_path.publish(np.array([[0.1, 0.05, 0.0], [0.19, 0.11, 0.0]]))
    driven = [[0.1, 0.05, -0.02], [0.1, 0.05, 0.0], [0.19, 0.11, 0.0]]
    found = desk.tip_path.message("left")
    assert np.allclose(found["path"], desk.scene.project("left", base.apply(np.array(driven))), atol=0.06)
    assert not found["planned"]
    desk.machine.set_state("driver", "idle")
    assert desk.tip_path.message("left") == shown
    desk.machine.set_state("driver", "moving")
    assert desk.tip_path.message("left")["path"] == [], "the way of the last motion is not shown for the next"


def test_a_way_that_is_told_before_its_motion_is_drawn_with_it() -> None:
    """As in a recording, and of who orders without the page: nothing says beforehand that something will move."""
    rig = Rig()
    desk = rig.desk
    desk.machine.set_position(0.1, 0.05, 0.02, rig.now)
    desk.scene.camera_from_base = Transform(pose().rotation, pose().apply(np.array([0.0, 0.0, 0.03])))
    way = np.array([[0.1, 0.05, 0.0], [0.19, 0.11, 0.0]])
    rig.wait(0.1)
    desk.tip_path.publish(way)
    assert desk.tip_path.message("left") == {"path": [], "planned": True}, (
        "a picture comes between the way and its motion"
    )
    rig.wait(0.5)
    desk.tip_path.message("left")
    desk.machine.set_state("controller", "moving")
    shown = desk.tip_path.message("left")
    assert (len(shown["path"]), shown["planned"]) == (3, False)
    desk.machine.set_state("controller", "ready")
    desk.tip_path.message("left")
    desk.machine.set_state("controller", "moving")
    assert desk.tip_path.message("left")["path"] == [], "the way of the last motion is not shown for the next"
    desk.machine.set_state("controller", "ready")
    desk.tip_path.publish(way)
    rig.wait(1.1)
    desk.tip_path.message("left")
    desk.machine.set_state("controller", "moving")
    assert desk.tip_path.message("left")["path"] == [], "nor one that nobody has set out on"


def test_without_a_calibration_or_a_pose_nothing_is_drawn() -> None:
    assert VideoScene().panel("left") == {"version": 0, "outline": [], "controls": [], "missing": "camera"}
    blind = VideoScene(left=camera(), faces=FACES)
    assert blind.panel("left") == {"version": 0, "outline": [], "controls": [], "missing": "panel"}
    assert blind.panel_point((1.0, 1.0)) is None
    lone = scene_without_right()
    assert (lone.panel("right")["controls"], lone.panel("right")["missing"]) == ([], "camera")
    assert lone.panel("left")["controls"] and lone.panel("left")["missing"] == ""


def scene_without_right() -> VideoScene:
    made = scene()
    made.right = None
    made.changed()
    return made
