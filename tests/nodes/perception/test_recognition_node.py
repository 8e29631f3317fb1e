"""The recognition node: the panel's true pose and controls come out, and nothing where nothing is sure."""

from __future__ import annotations

import dataclasses
import json
import re
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped
from nodes.recognition_rig import CAMERA, LAYOUT, PERIOD, START, Rig
from rclpy.parameter import Parameter
from sensor_msgs.msg import CameraInfo, Image, PointCloud2
from std_msgs.msg import String
from unit.harris_perception import panel_scene as scene
from visualization_msgs.msg import Marker

from harris_perception.core.pose.planar_pose import FACE_POINT_COLUMNS, FacePoints
from harris_perception.nodes.recognition_node import RecognitionNode
from icu_common.core.configuration.config import ConfigError
from icu_common.core.geometry.frames import CAMERA_LEFT, PANEL
from icu_common.core.geometry.geometry import Transform
from icu_common.core.goals.results import Outcome
from icu_common.core.panel.panel_layout import load_layout, parse_layout
from icu_common.nodes import qos
from icu_common.nodes.messages.cameras import camera_info_message, image_message
from icu_common.nodes.messages.clouds import cloud_array, cloud_message
from icu_common.nodes.messages.heads import header, stamp_ns
from icu_common.nodes.messages.panels import controls_of_message, panel_state_of_message
from icu_common.nodes.messages.places import transform_of_pose
from icu_common.nodes.messages.results import result_of_message


def picture(shift_m: float = 0.0, seed: int = 1) -> np.ndarray:
    truth = scene.pose(LAYOUT, shift_m=(shift_m, 0.0))
    return np.asarray(scene.picture(LAYOUT, CAMERA, truth, scene.Look(screen_seed=seed), seed))


def error_mm(pose: PoseStamped, shift_m: float = 0.0) -> float:
    truth = scene.pose(LAYOUT, shift_m=(shift_m, 0.0))
    points = scene.control_points_m(LAYOUT)
    return float(np.linalg.norm(transform_of_pose(pose.pose).apply(points) - truth.apply(points), axis=1).max() * 1e3)


def test_pose_after_three_agreeing_pictures_then_lost_then_moved(ros: Any) -> None:
    rig = Rig(ros)
    assert [rig.show(picture(seed=n), n) for n in (1, 2)] == [0.0, 0.0]
    assert rig.poses == []
    assert rig.show(picture(seed=3), 3) > 0.85
    ros.spin_until(lambda: rig.poses, 10.0)
    assert rig.poses[-1].header.frame_id == CAMERA_LEFT
    assert stamp_ns(rig.poses[-1].header.stamp) == START + 3 * PERIOD
    assert error_mm(rig.poses[-1]) < 0.15
    assert rig.node._with_corners == 3

    blank = np.full((720, 1280), 100, np.uint8)
    assert rig.show(blank, 4) == 0.0
    assert len(rig.poses) == 1

    confidences = [rig.show(picture(shift_m=0.03, seed=n), n) for n in (5, 6, 7)]
    assert confidences[:2] == [0.0, 0.0] and confidences[2] > 0.85
    ros.spin_until(lambda: len(rig.poses) == 2, 10.0)
    assert error_mm(rig.poses[-1], shift_m=0.03) < 0.15


def test_lamps_are_told_by_colour_only(ros: Any) -> None:
    rig = Rig(ros, **{"recognition.agreement.frames": 1})
    states: list[DiagnosticArray] = ros.collect(rig.probe, DiagnosticArray, "state", qos.RESULTS)
    ros.spin_until(lambda: rig.probe.count_publishers("state"), 10.0)
    for number, encoding in enumerate(("bgr8", "mono8"), start=1):
        rig.show(picture(), number, encoding=encoding)
        ros.spin_until(lambda n=number: len(states) == n, 10.0)
    colour, grey = ({c.name: c.lamp for c in panel_state_of_message(state).controls} for state in states)
    assert colour["RUN_STOP"] == "off"
    assert set(grey.values()) == {""}, "of a picture without colour nobody knows whether they shine"


def test_a_glint_in_pictures_of_12_bits_is_no_change_of_a_screen(ros: Any) -> None:
    rig = Rig(ros, **{"recognition.agreement.frames": 1})
    states: list[DiagnosticArray] = ros.collect(rig.probe, DiagnosticArray, "state", qos.RESULTS)
    ros.spin_until(lambda: rig.probe.count_publishers("state"), 10.0)
    dark = picture().astype(np.uint16) * 4  # a quarter of the full light
    # Of 10 bits, as far as a single image shows; with the glint of 11.
    for number, glint in enumerate([1000] * 6 + [1100] * 3 + [1000] * 3, start=1):
        dark[0, 0] = glint
        rig.show(dark, number, encoding="bgr16")
        ros.spin_until(lambda n=number: len(states) == n, 10.0)
    changed = [max(c.changed_ns for c in panel_state_of_message(state).controls) for state in states]
    assert changed == [0] * 12


def test_a_camera_that_loses_its_calibration_ends_the_poses(ros: Any) -> None:
    rig = Rig(ros, **{"recognition.agreement.frames": 1})
    assert rig.show(picture(seed=1), 1) > 0.85
    ros.spin_until(lambda: len(rig.poses) == 1, 10.0)
    # Message of the camera node when it has none for these images.
    rig.infos.publish(CameraInfo(header=header(START + PERIOD, CAMERA_LEFT), width=1280, height=720))
    ros.spin_until(lambda: rig.node._camera is None, 10.0)
    assert rig.node.set_parameters([Parameter("silence_s", value=0.3)])[0].successful
    assert rig.show(picture(seed=2), 2) == 0.0 and len(rig.poses) == 1
    rig.infos.publish(camera_info_message(CAMERA, header(START + 2 * PERIOD, CAMERA_LEFT)))
    ros.spin_until(lambda: rig.node._camera is not None, 10.0)
    assert rig.show(picture(seed=3), 3) > 0.85


def test_points_measured_for_a_pose_are_told_to_who_listens(ros: Any) -> None:
    rig = Rig(ros, **{"recognition.agreement.frames": 1})
    rig.show(picture(seed=1), 1)
    points: list[PointCloud2] = ros.collect(rig.probe, PointCloud2, "points", qos.RESULTS)
    ros.spin_until(lambda: rig.node._points.get_subscription_count() == 1, 10.0)
    rig.show(picture(seed=2), 2)
    ros.spin_until(lambda: points, 10.0)
    assert len(points) == 1 and points[0].header.frame_id == CAMERA_LEFT
    assert stamp_ns(points[0].header.stamp) == START + 2 * PERIOD
    measured = FacePoints.of_rows(cloud_array(points[0], FACE_POINT_COLUMNS))
    error, _ = measured.residuals(scene.pose(LAYOUT).apply(measured.in_space), CAMERA)
    assert len(error) > 300
    assert np.sqrt(np.mean(error**2)) < 0.3


def test_controls_and_outline_are_those_of_the_layout(ros: Any) -> None:
    rig = Rig(ros)
    message = ros.spin_until(lambda: rig.controls, 10.0)[-1]
    controls, outline = controls_of_message(message)
    assert {m.header.frame_id for m in message.markers} == {PANEL}
    assert [c.name for c in controls] == [c.name for c in LAYOUT.controls]
    for found, wanted in zip(controls, LAYOUT.controls):
        assert (found.kind, found.shape) == (wanted.kind, wanted.shape)
        assert found.position_mm == pytest.approx(wanted.position_mm)
        assert found.size_mm == pytest.approx(wanted.size_mm)
        assert found.height_mm == pytest.approx(wanted.height_mm)
    np.testing.assert_allclose(outline.max(axis=0), (0.32, 0.15))
    run_stop = next(m for m in message.markers if m.text == "RUN_STOP")
    top = run_stop.pose.position
    assert (top.x, top.y, top.z) == pytest.approx((0.208, 0.127, 0.003))
    assert message.markers[-1].type == Marker.LINE_STRIP


def test_markers_that_contradict_the_print_raise_an_alarm_until_they_confirm_it(ros: Any, tmp_path: Path) -> None:
    text = scene.LAYOUT.read_text() + (
        "markers:\n  - {dictionary: 4X4_50, id: 7, position_mm: [156.5, 12.0], size_mm: 12.0}\n"
    )
    file = tmp_path / "marked.yaml"
    file.write_text(text)
    good, moved = parse_layout(text), parse_layout(text.replace("[156.5,", "[152.5,"))
    rig = Rig(ros, layout=str(file), **{"recognition.agreement.frames": 1})
    alarms: list[String] = ros.collect(rig.probe, String, "alarm", qos.LATCHED)
    ros.spin_until(lambda: [a.data for a in alarms] == [""], 10.0)
    views = [scene.picture(shown, CAMERA, scene.pose(good), scene.Look(), 1) for shown in (good, moved)]
    assert rig.show(views[0], 1) > 0.8
    assert rig.show(views[1], 2) == 0.0
    ros.spin_until(lambda: len(alarms) == 2, 10.0)
    assert "by marker 4X4_50 7 the panel is 4." in alarms[-1].data
    assert "mm from where its print is (limit 2 mm)" in alarms[-1].data
    poses = len(rig.poses)
    # A hidden marker confirms nothing.
    assert rig.show(picture(), 3) == 0.0
    assert len(rig.poses) == poses
    assert rig.show(views[0], 4) > 0.8
    ros.spin_until(lambda: alarms[-1].data == "", 10.0)


def test_a_panel_that_stereo_sees_at_another_depth_raises_an_alarm_until_they_agree(ros: Any) -> None:
    rig = Rig(ros, **{"recognition.agreement.frames": 1})
    alarms: list[String] = ros.collect(rig.probe, String, "alarm", qos.LATCHED)
    stereo = rig.probe.create_publisher(PointCloud2, "stereo_points", qos.RESULTS)
    ros.spin_until(lambda: stereo.get_subscription_count() == 1, 10.0)
    x, y = np.meshgrid(np.linspace(0.02, 0.30, 9), np.linspace(0.02, 0.13, 5))
    face = scene.pose(LAYOUT).apply(np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)]))

    def look(times: int, farther: float) -> None:
        cloud = np.column_stack([face * farther, np.full(len(face), 0.001)])
        for _ in range(times):
            stereo.publish(cloud_message(("x", "y", "z", "sigma"), cloud, header(START + PERIOD, CAMERA_LEFT)))

    assert rig.show(picture(), 1) > 0.8
    look(5, 0.99)
    ros.spin_until(lambda: alarms and alarms[-1].data, 10.0)
    assert re.match(r"both cameras together see the panel \d\.\d mm nearer than its print (limit 2 mm", alarms[-1].data)
    assert rig.show(picture(seed=2), 2) == 0.0, "no pose counts"
    other = dataclasses.replace(CAMERA, d=CAMERA.d + 1e-6)
    rig.infos.publish(camera_info_message(other, header(START, CAMERA_LEFT)))
    ros.spin_until(lambda: rig.node._camera is not None and np.array_equal(rig.node._camera.d, other.d), 10.0)
    look(2, 1.0)
    assert rig.show(picture(seed=4), 4) == 0.0, "another calibration is no proof yet"
    look(3, 1.0)
    ros.spin_until(lambda: alarms[-1].data == "", 10.0)
    assert rig.show(picture(seed=3), 3) > 0.8
    ros.spin_until(lambda: stereo.get_subscription_count() == 0, 10.0)  # and costs nothing any more


def test_a_panel_whose_markers_have_not_been_seen_once_is_not_used(ros: Any, tmp_path: Path) -> None:
    text = scene.LAYOUT.read_text() + (
        "markers:\n  - {dictionary: 4X4_50, id: 7, position_mm: [156.5, 12.0], size_mm: 12.0}\n"
    )
    file = tmp_path / "marked.yaml"
    file.write_text(text)
    rig = Rig(ros, layout=str(file), **{"recognition.agreement.frames": 1})
    alarms: list[String] = ros.collect(rig.probe, String, "alarm", qos.LATCHED)
    assert rig.show(picture(), 1) == 0.0, "a sibling without markers, or all of them are hidden"
    ros.spin_until(lambda: alarms and alarms[-1].data == "no camera has seen the panel's markers yet", 10.0)
    assert not rig.poses
    marked = scene.picture(parse_layout(text), CAMERA, scene.pose(parse_layout(text)), scene.Look(), 1)
    assert rig.show(marked, 2) > 0.8
    ros.spin_until(lambda: alarms[-1].data == "", 10.0)
    assert rig.show(picture(), 3) > 0.8, "once confirmed, a hand may hide them"


def test_without_published_corners_it_finds_its_own(ros: Any) -> None:
    rig = Rig(ros, **{"recognition.agreement.frames": 1, "corners_wait_s": 0.02})
    assert rig.show(picture(), 1, with_corners=False) > 0.85
    assert rig.node._with_corners == 0
    ros.spin_until(lambda: rig.poses, 10.0)
    assert error_mm(rig.poses[-1]) < 0.15


def test_silence_of_the_camera_counts_as_loss(ros: Any) -> None:
    rig = Rig(ros, **{"recognition.agreement.frames": 1, "silence_s": 0.5})
    assert rig.show(picture(), 1) > 0.85
    ros.spin_until(lambda: len(rig.confidences) > 1, 10.0)
    assert rig.confidences[-1].data == 0.0


def test_a_node_that_was_held_up_looks_at_the_waiting_pictures_before_it_loses_the_panel(ros: Any) -> None:
    rig = Rig(ros, **{"recognition.agreement.frames": 1, "silence_s": 0.5})
    assert rig.show(picture(), 1) > 0.85
    now_s = [rig.node._seconds()]
    rig.node._seconds = lambda: now_s[0]
    rig.node._on_tick()
    for held_up_s in (3.0, 0.1, 0.1, 0.1, 0.1):
        now_s[0] += held_up_s
        rig.node._on_tick()
        assert rig.node._confidence > 0.85, "its pictures may still wait"
    now_s[0] += 0.19
    rig.node._on_tick()
    assert rig.node._confidence == 0.0, "it was in time for 0.5 s, and there was none"


def test_a_node_that_is_held_up_all_the_time_loses_the_panel_in_the_end(ros: Any) -> None:
    rig = Rig(ros, **{"recognition.agreement.frames": 1, "silence_s": 0.5})
    assert rig.show(picture(), 1) > 0.85
    now_s = [rig.node._seconds()]
    rig.node._seconds = lambda: now_s[0]
    for _ in range(5):
        now_s[0] += 1.0
        rig.node._on_tick()
        assert rig.node._confidence > 0.85
    now_s[0] += 1.0
    rig.node._on_tick()
    assert rig.node._confidence == 0.0


def test_pictures_between_the_rate_are_left_out_and_others_refused(ros: Any) -> None:
    rig = Rig(ros, **{"recognition.agreement.frames": 1, "rate_hz": 4.0})
    assert rig.show(picture(), 1) > 0.85
    frames = rig.node._frames
    head = header(START + PERIOD + PERIOD // 3, CAMERA_LEFT)
    rig.images.publish(image_message(picture(), "mono8", head))
    # A picture of another size is looked at, refused, and counts as a lost panel.
    reports: list[DiagnosticArray] = ros.collect(rig.probe, DiagnosticArray, "/diagnostics", qos.RESULTS)
    assert rig.show(np.zeros((480, 640), np.uint8), 2) == 0.0
    assert rig.node._frames == frames + 1
    told = ros.spin_until(lambda: [s.message for r in reports for s in r.status if "refused" in s.message], 10.0)
    assert told[0].startswith("not recognised: picture refused: ") and "480" in told[0]


def test_a_camera_that_flips_its_pictures_is_told(ros: Any) -> None:
    rig = Rig(ros, **{"recognition.agreement.frames": 1})
    reports: list[DiagnosticArray] = ros.collect(rig.probe, DiagnosticArray, "/diagnostics", qos.RESULTS)
    for number in (1, 2):
        assert rig.show(np.ascontiguousarray(picture(seed=number)[:, ::-1]), number) == 0.0
    told = ros.spin_until(lambda: [s.message for r in reports for s in r.status if "mirror" in s.message], 10.0)
    assert told[0].startswith("not recognised: the panel is seen in a mirror: switch off "), told
    assert rig.show(picture(), 3) > 0.85 and not rig.node._recogniser.mirrored


def test_template_picture_instead_of_the_drawing(ros: Any, tmp_path: Path) -> None:
    straight = Transform(np.diag([1.0, -1.0, -1.0]), np.array([-0.16, 0.075, 0.6]))
    lens = dataclasses.replace(CAMERA, d=np.zeros(5))
    seen = scene.picture(LAYOUT, lens, straight, scene.Look(arm_x_mm=None, noise=0.5), 1)
    corners = np.array([(0, 0.15, 0), (0.32, 0.15, 0), (0.32, 0, 0), (0, 0, 0)])
    pixels = lens.project(straight.apply(corners)).astype(np.float32)
    face = np.array([(-0.5, -0.5), (959.5, -0.5), (959.5, 449.5), (-0.5, 449.5)], np.float32)
    rectified = cv2.warpPerspective(seen, cv2.getPerspectiveTransform(pixels, face), (960, 450))
    path = tmp_path / "face.png"
    cv2.imwrite(str(path), rectified)
    rig = Rig(ros, template=str(path), template_px_per_mm=3.0, **{"recognition.agreement.frames": 1})
    assert rig.show(picture(), 1) > 0.6
    ros.spin_until(lambda: rig.poses, 10.0)
    assert error_mm(rig.poses[-1]) < 0.4


@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        ({}, "layout: the path of the designated panel's layout file is needed"),
        ({"layout": "missing.yaml"}, "layout: .*missing.yaml"),
        ({"layout": str(scene.LAYOUT), "template": "missing.png"}, "template: missing.png is not a picture"),
        ({"layout": str(scene.LAYOUT), "rate_hz": 0.0}, "rate_hz"),
    ],
)
def test_wrong_parameters_stop_the_node_with_a_reason(ros: Any, parameters: dict[str, Any], message: str) -> None:
    with pytest.raises(Exception, match=message) as refusal:
        ros.node(RecognitionNode, parameters)
    assert isinstance(refusal.value, ConfigError) or "rate_hz" in str(refusal.value)


def test_layout_that_is_wrong_is_named_with_its_line(ros: Any, tmp_path: Path) -> None:
    path = tmp_path / "panel.yaml"
    path.write_text("model: m\nsize_mm: [10, 10]\ncontrols:\n  - {name: A, kind: lever}\n")
    with pytest.raises(ConfigError, match=r"panel\.yaml:4"):
        ros.node(RecognitionNode, {"layout": str(path)})


def test_a_change_that_cannot_be_used_is_refused_and_others_are_taken(ros: Any) -> None:
    node = Rig(ros).node
    old = node._recogniser
    for name, value in (("recognition.search.px_per_mm", 0.2), ("recognition.refine.min_points", 5000)):
        (refused,) = node.set_parameters([Parameter(name, value=value)])
        assert not refused.successful and "too little print to be recognised" in refused.reason
        assert node.get_parameter(name).value != value and node._recogniser is old
    assert node.set_parameters([Parameter("state.lit_chroma", value=20.0)])[0].successful
    assert node._reader.config.lit_chroma == 20.0
    assert node.set_parameters([Parameter("recognition.refine.min_points", value=30)])[0].successful
    assert node._recogniser is not old and node._recogniser.config.refine.min_points == 30


def test_a_panel_is_taught_by_messages(ros: Any, tmp_path: Path) -> None:
    folder = tmp_path / "scopes"
    rig = Rig(ros, teach_folder=str(folder))
    answers = ros.collect(rig.probe, DiagnosticArray, "teach/result", qos.RESULTS)
    pictures = rig.probe.create_publisher(Image, "teach/image_raw", qos.RESULTS)
    requests = rig.probe.create_publisher(String, "teach/request", qos.RESULTS)
    for publisher in (pictures, requests):
        ros.spin_until(lambda p=publisher: p.get_subscription_count() == 1, 10.0)
    ros.spin_until(lambda: rig.probe.count_publishers("teach/result") == 1, 10.0)
    truth = scene.pose(LAYOUT)
    width, height = (side / 1000 for side in LAYOUT.size_mm)
    face = np.array([(0, 0, 0), (width, 0, 0), (width, height, 0), (0, height, 0)])
    corners = CAMERA.project(truth.apply(face)).tolist()
    u, v = CAMERA.project(truth.apply(np.array([0.208, 0.127, 0.0])))[0]
    lesson = {"id": "one", "stamp": str(START), "model": "taught", "title": "Taught", "size_mm": [320, 150]}
    lesson |= {"corners": corners, "controls": [["RUN_STOP", "button", float(u), float(v), 16, 9, 3]]}

    def ask(pixels: Any = None, **changes: Any) -> Any:
        before = len(answers)
        shown = np.repeat(picture()[..., None], 3, axis=2) if pixels is None else pixels
        pictures.publish(image_message(shown, "bgr8", header(START, CAMERA_LEFT)))
        requests.publish(String(data=json.dumps(lesson | changes)))
        ros.spin_until(lambda: len(answers) > before, 30.0)
        return result_of_message(answers[-1])

    for name in ("early", "late"):  # of a picture that has not come
        requests.publish(String(data=json.dumps(lesson | {"id": name, "stamp": str(START + 1)})))
    ros.spin_until(lambda: len(answers) == 1, 10.0)
    early = result_of_message(answers[0])
    assert (early.goal_id, early.outcome) == ("early", Outcome.REJECTED)
    assert early.reason == f"a request for another panel came before the image of {START + 1}"
    ros.spin_until(lambda: len(answers) == 2, 20.0)
    assert result_of_message(answers[1]).goal_id == "late" and "within 5 s" in result_of_message(answers[1]).reason
    unclear = ask(size_mm="big")
    assert (unclear.goal_id, unclear.outcome) == (
        "one",
        Outcome.REJECTED,
    ) and "cannot read the request" in unclear.reason
    wrong = ask(corners=corners[::-1])
    assert wrong.outcome is Outcome.REJECTED and "do not go round the face" in wrong.reason
    empty = ask(np.zeros((0, 0, 3), np.uint8))
    assert empty.outcome is Outcome.REJECTED and empty.reason.startswith("error while teaching: ")
    assert not folder.exists()
    done = ask()
    details = dict(done.details)
    assert (done.goal_id, done.outcome, details["layout"]) == ("one", Outcome.REACHED, str(folder / "taught.yaml"))
    place = load_layout(folder / "taught.yaml").control("RUN_STOP").position_mm
    assert place == pytest.approx((208.0, 127.0), abs=0.1)
    assert f"--set recognition.template={folder / 'taught.png'}" in details["start"]


class Counted:
    """Counts how often the panel is measured."""

    def __init__(self, rig: Rig) -> None:
        self.times = 0
        self._locate = rig.node._recogniser.locate
        rig.node._recogniser.locate = self.locate  # type: ignore[method-assign]

    def locate(self, *args: Any) -> Any:
        self.times += 1
        return self._locate(*args)


def test_a_panel_that_looks_the_same_is_measured_at_times_and_published_each_time(ros: Any) -> None:
    agreement = {"recognition.agreement.frames": 1, "recognition.agreement.window": 2}
    rig = Rig(ros, **agreement)
    states: list[DiagnosticArray] = ros.collect(rig.probe, DiagnosticArray, "state", qos.RESULTS)
    counted = Counted(rig)
    same = [picture(seed=1 + n % 3) for n in range(3)]
    for number in range(1, 3):
        assert rig.show(same[number], number) > 0.85
    assert counted.times == 2, "the pose has settled from here on"
    for number in range(3, 7):
        assert rig.show(same[number % 3], number) > 0.85
    assert counted.times == 2
    ros.spin_until(lambda: len(rig.poses) == 6 and len(states) == 6, 30.0, lambda: (len(rig.poses), len(states)))
    stamps = [START + number * PERIOD for number in range(1, 7)]
    assert [stamp_ns(p.header.stamp) for p in rig.poses] == stamps
    assert [stamp_ns(s.header.stamp) for s in states] == stamps, "lamps and screens are read in each image"
    assert max(error_mm(pose) for pose in rig.poses) < 0.15
    assert rig.show(same[1], 7) > 0.85 and counted.times == 3, "at the latest the fifth is measured"

    assert rig.show(same[2], 8) > 0.85 and counted.times == 3
    covered = same[0].copy()
    covered[:, 700:] = 60
    assert rig.show(covered, 9) < rig.confidences[0].data - 0.1 and counted.times == 4, "a change shows at once"
    assert rig.show(np.full((720, 1280), 100, np.uint8), 10) == 0.0 and counted.times == 5


def test_in_step_with_a_recording_each_image_is_measured_and_corners_are_always_taken(ros: Any) -> None:
    rig = Rig(ros, **{"on_demand": False, "recognition.agreement.frames": 1, "recognition.agreement.window": 2})
    counted = Counted(rig)
    for number in range(1, 5):
        assert rig.show(picture(seed=number), number) > 0.85
    assert counted.times == 4 and rig.node._with_corners == 4


def test_corners_are_taken_while_the_panel_is_searched(ros: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("harris_perception.nodes.recognition_node._TRACKED", 2)
    rig = Rig(ros, **{"recognition.agreement.frames": 1})
    assert rig.show(picture(seed=1), 1) > 0.85 and rig.show(picture(seed=2), 2) > 0.85
    ros.spin_until(lambda: rig.corners.get_subscription_count() == 0, 10.0)
    assert rig.show(picture(seed=3), 3, with_corners=False) > 0.85 and rig.node._own_corners == 0
    assert rig.show(np.full((720, 1280), 100, np.uint8), 4, with_corners=False) == 0.0
    assert rig.node._own_corners == 1, "the first image that is searched again has none of its own topic"
    ros.spin_until(lambda: rig.corners.get_subscription_count() == 1, 10.0)
    before = rig.node._with_corners
    assert rig.show(picture(seed=5), 5) > 0.85 and rig.node._with_corners == before + 1
