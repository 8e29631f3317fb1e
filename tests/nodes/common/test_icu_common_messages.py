"""Messages come back as the values that were packed; misfits are refused with the reason."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np
import pytest
from sensor_msgs.msg import CameraInfo
from std_msgs.msg import Float64MultiArray
from support.pinhole import pinhole

from icu_common.core.geometry.geometry import Transform
from icu_common.core.goals.results import Felt, GoalResult, Outcome
from icu_common.core.panel.panel_layout import Control, Dimple, PanelLayout
from icu_common.core.processes.delays import Delay, ResultCode
from icu_common.nodes.messages.cameras import (
    camera_info_message,
    camera_model,
    disparity_message,
    image_array,
    image_message,
    same_camera,
)
from icu_common.nodes.messages.clouds import cloud_array, cloud_message, organised_cloud_message
from icu_common.nodes.messages.heads import check_frame, header, stamp_ns
from icu_common.nodes.messages.joints import (
    joint_contact,
    joint_message,
    joint_positions,
    trajectory_array,
    trajectory_message,
)
from icu_common.nodes.messages.panels import controls_message, controls_of_message
from icu_common.nodes.messages.places import (
    axes_message,
    axes_of_message,
    pose_message,
    transform_message,
    transform_of_message,
    transform_of_pose,
)
from icu_common.nodes.messages.results import result_message, result_of_message

HEAD = header(1_700_000_000_123_456_789, "camera_left_optical_frame")


@pytest.mark.parametrize(
    ("encoding", "shape", "dtype"),
    [("bgr8", (5, 7, 3), np.uint8), ("mono8", (5, 7), np.uint8), ("mono16", (5, 7), np.uint16)],
)
def test_picture_round_trip(encoding: str, shape: tuple[int, ...], dtype: type) -> None:
    picture = np.random.default_rng(3).integers(0, np.iinfo(dtype).max, shape, dtype=dtype)
    message = image_message(picture, encoding, HEAD)
    assert stamp_ns(message.header.stamp) == 1_700_000_000_123_456_789
    np.testing.assert_array_equal(image_array(message), picture)
    padded = np.zeros((shape[0], message.step + 6), np.uint8)
    padded[:, : message.step] = picture.reshape(shape[0], -1).view(np.uint8)
    message.step, message.data = padded.shape[1], padded.tobytes()
    np.testing.assert_array_equal(image_array(message), picture)


def test_picture_that_does_not_fit_is_refused() -> None:
    message = image_message(np.zeros((4, 4), np.uint8), "mono8", HEAD)
    message.height = 5
    with pytest.raises(ValueError, match="does not fit 16 bytes"):
        image_array(message)
    empty = image_array(image_message(np.zeros((3, 0, 3), np.uint8), "bgr8", HEAD))
    assert empty.shape == (3, 0, 3)
    message.encoding = "yuv422"
    with pytest.raises(ValueError, match="'yuv422' is none of"):
        image_array(message)


def test_cloud_round_trip() -> None:
    values = np.random.default_rng(4).normal(size=(9, 3)).astype(np.float32)
    cloud = cloud_message(("u", "v", "response"), values, HEAD)
    np.testing.assert_array_equal(cloud_array(cloud, ("response", "u")), values[:, [2, 0]])
    assert cloud_array(cloud_message(("u",), np.empty((0, 1)), HEAD), ("u",)).shape == (0, 1)
    with pytest.raises(ValueError, match="no float32 field w; it has u, v, response"):
        cloud_array(cloud, ("w",))


def test_padded_rows_of_a_cloud_are_read_without_their_padding() -> None:
    values = np.arange(12, dtype=np.float32).reshape(2, 2, 3)
    cloud = cloud_message(("u", "v", "response"), values.reshape(-1, 3), HEAD)
    cloud.height, cloud.width, cloud.row_step = 2, 2, 32
    padded = np.zeros((2, 32), np.uint8)
    padded[:, :24] = values.view(np.uint8).reshape(2, 24)
    cloud.data = padded.tobytes()
    np.testing.assert_array_equal(cloud_array(cloud, ("u", "response")), values.reshape(-1, 3)[:, [0, 2]])


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"point_step": 0}, "with step 0, .* fields up to byte 8 does not fit"),
        ({"point_step": 4}, "with step 4, .* fields up to byte 8 does not fit"),
        ({"width": 5}, "a cloud of 5 x 1 points with step 12, rows of 60 bytes .* does not fit 48 bytes"),
        ({"width": 2, "height": 2, "row_step": 30}, "rows of 30 bytes .* does not fit 48 bytes"),
        ({"width": 2, "height": 2, "row_step": 12}, "rows of 12 bytes .* does not fit 48 bytes"),
        ({"is_bigendian": True}, "expected the other order"),
    ],
)
def test_clouds_that_do_not_fit_their_data_are_refused(wrong: dict[str, Any], message: str) -> None:
    cloud = cloud_message(("u", "v", "response"), np.ones((4, 3)), HEAD)
    for name, value in wrong.items():
        setattr(cloud, name, value)
    with pytest.raises(ValueError, match=message):
        cloud_array(cloud, ("u", "v"))


def test_pose_and_transform_round_trip() -> None:
    transform = Transform.from_quaternion((0.1, -0.2, 0.3, 0.9), (0.1, 0.2, 0.3))
    for back in (
        transform_of_pose(pose_message(transform, HEAD).pose),
        transform_of_message(transform_message(transform, HEAD, "base_link")),
    ):
        np.testing.assert_allclose(back.rotation, transform.rotation, atol=1e-12)
        np.testing.assert_allclose(back.translation, transform.translation)


def test_axes_travel_row_by_row_and_none_when_they_are_withdrawn() -> None:
    axes = np.array([[1.003, -0.002], [0.0, 0.998]])
    assert np.array_equal(axes_of_message(axes_message(axes)), axes)
    assert axes_of_message(axes_message(None)) is None
    for wrong in ([1.0, 0.0, 0.0], [1.0, 0.0, 0.0, math.nan]):
        with pytest.raises(ValueError, match="expected 4 finite values"):
            axes_of_message(Float64MultiArray(data=wrong))


def test_result_round_trip() -> None:
    result = GoalResult(
        goal_id="7",
        goal="press:RUN_STOP",
        outcome=Outcome.REACHED,
        error_m=0.000123,
        duration_s=2.5,
        details=(("tries", "2"),),
        code="slow",
        touch=Felt.PRESSED,
    )
    assert result_of_message(result_message(result, 1)) == result
    rejected = result_of_message(
        result_message(GoalResult(goal_id="", goal="x", outcome=Outcome.REJECTED, reason="why"), 1)
    )
    assert rejected.reason == "why" and math.isnan(rejected.error_m)


def test_the_code_of_a_result_travels_and_is_empty_where_a_sender_gives_none() -> None:
    delay = Delay(code=ResultCode.STALE, what="goal", measured_s=0.527, limit_s=0.5)
    result = GoalResult(goal_id="7", goal="x", outcome=Outcome.REJECTED, code=delay.code, details=delay.details())
    message = result_message(result, 1)
    assert [pair.value for pair in message.status[0].values if pair.key == "code"] == ["stale"]
    back = result_of_message(message)
    assert back.code == result.code and ResultCode(back.code) is ResultCode.STALE
    assert (back.goal_id, back.outcome, back.reason) == ("7", Outcome.REJECTED, "")
    assert dict(back.details) == {"delayed": "goal", "delay_measured_s": "0.527", "delay_limit_s": "0.5"}
    old = result_message(GoalResult(goal_id="7", goal="x", outcome=Outcome.REJECTED), 1)
    assert not any(pair.key == "code" for pair in old.status[0].values)
    assert result_of_message(old).code == ""


def test_joints_by_name() -> None:
    message = joint_message(("b", "a"), (2.0, 1.0), HEAD)
    np.testing.assert_array_equal(joint_positions(message, ("a", "b")), (1.0, 2.0))
    with pytest.raises(ValueError, match="joint c is missing"):
        joint_positions(message, ("c",))


def test_the_switch_of_the_stylus_travels_with_the_positions() -> None:
    for contact, effort in ((None, []), (False, [0.0, 0.0]), (True, [0.0, 1.0])):
        message = joint_message(("a", "b"), (1.0, 2.0), HEAD, contact)
        assert list(message.effort) == effort
        assert joint_contact(message, "b") is contact
    message.effort = [0.0, 0.5]
    with pytest.raises(ValueError, match=r"the effort of joint b is 0\.5: expected 0 or 1"):
        joint_contact(message, "b")
    message.effort = [0.0]
    with pytest.raises(ValueError, match="the effort of joint b is None"):
        joint_contact(message, "b")


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_a_joint_that_is_not_finite_is_refused_by_name(value: float) -> None:
    message = joint_message(("a", "b", "other"), (1.0, value, 0.0), HEAD)
    with pytest.raises(ValueError, match=f"joint b = {value} m is not finite"):
        joint_positions(message, ("a", "b"))
    np.testing.assert_array_equal(joint_positions(message, ("a", "other")), (1.0, 0.0))


def test_a_trajectory_comes_back_in_the_order_asked_for() -> None:
    message = trajectory_message(("b", "a"), [[1, 2], [3, 4]], [0.1, 0.2], header(0, ""))
    assert trajectory_array(message, ("a", "b")).tolist() == [[2, 1], [4, 3]]
    assert trajectory_array(trajectory_message(("a",), [], [], header(0, "")), ("a",)).shape == (0, 1)
    with pytest.raises(ValueError, match="joint c is missing; the message has b, a"):
        trajectory_array(message, ("a", "c"))
    message.points[1].positions = [3.0, float("nan")]
    with pytest.raises(ValueError, match="point 1"):
        trajectory_array(message, ("a", "b"))


def test_disparities_travel_as_float32_and_unknown_ones_are_below_the_least() -> None:
    values = np.array([[10.0, np.nan, 12.0625], [41.5, 9.3, np.nan]], np.float32)
    message = disparity_message(values, 850.0, 0.12, (9.3, 41.5), 1 / 16, header(5, "left"), 1)
    assert (message.f, message.min_disparity, message.max_disparity) == (850.0, np.float32(9.3), 41.5)
    assert (message.image.step, message.image.encoding, message.image.header.frame_id) == (12, "32FC1", "left")
    assert (message.valid_window.x_offset, message.valid_window.width, message.valid_window.height) == (1, 2, 2)
    raw = image_array(message.image)
    assert raw[0, 1] == raw[1, 2] < message.min_disparity
    assert np.array_equal(np.where(raw < message.min_disparity, np.nan, raw), values, equal_nan=True)


@pytest.mark.parametrize(("kind", "encoding"), [("u2", "mono16"), ("f4", "32FC1")])
def test_a_picture_of_the_other_byte_order_is_packed_as_it_looks(kind: str, encoding: str) -> None:
    """As of a message with the most significant bytes first: its bytes went out in that order, said to be the other."""
    picture = np.array([[1, 256, 770], [4, 5, 6]], f">{kind}")
    message = image_message(picture, encoding, HEAD)
    np.testing.assert_array_equal(image_array(message), picture)
    assert not message.is_bigendian


def test_an_organised_cloud_has_a_point_and_a_colour_for_each_pixel() -> None:
    xyz = np.arange(24, dtype=np.float32).reshape(2, 4, 3)
    xyz[1, 2] = np.nan
    bgr = np.arange(24, dtype=np.uint8).reshape(2, 4, 3) * 10
    cloud = organised_cloud_message(xyz, bgr, header(5, "left"))
    assert (cloud.height, cloud.width, cloud.row_step, cloud.is_dense) == (2, 4, 64, False)
    assert [(f.name, f.offset) for f in cloud.fields] == [("x", 0), ("y", 4), ("z", 8), ("rgb", 12)]
    points = cloud_array(cloud, ("x", "y", "z")).reshape(2, 4, 3)
    assert np.array_equal(points, xyz, equal_nan=True)
    packed = np.frombuffer(cloud.data, np.uint32).reshape(2, 4, 4)[..., 3]
    assert packed[0, 1] == (50 << 16) + (40 << 8) + 30  # red above green above blue, as the viewers read it


def camera_info() -> CameraInfo:
    return camera_info_message(pinhole(), HEAD)


def test_the_same_camera_is_known_whatever_the_header_says() -> None:
    later = camera_info()
    later.header = header(5, "elsewhere")
    assert same_camera(camera_info(), later)
    assert not same_camera(None, later)


@pytest.mark.parametrize("field", ["width", "height", "distortion_model", "d", "k", "r", "p", "binning_x", "roi"])
def test_another_camera_is_known_by_each_of_its_values(field: str) -> None:
    other = camera_info()
    if field == "distortion_model":
        other.distortion_model = "fisheye"
    elif field in ("width", "height", "binning_x"):
        setattr(other, field, 640)
    elif field == "roi":
        other.roi.x_offset = 8
    else:
        getattr(other, field)[0] += 1e-3
    assert not same_camera(camera_info(), other)


def test_a_region_of_interest_and_binning_move_the_pixels() -> None:
    """CameraInfo has the matrices of the whole image; the received image is a part of it, in larger pixels."""
    info = camera_info()
    whole = camera_model(info)
    info.d[0], info.p[3] = -0.1, -1700.0 * 0.12
    info.roi.x_offset, info.roi.y_offset, info.roi.width, info.roi.height = 320, 120, 640, 480
    info.binning_x, info.binning_y = 2, 4
    part = camera_model(info)
    assert part.size == (320, 120)
    points = np.array([[0.02, -0.03, 0.6], [-0.05, 0.01, 0.7]])
    seen = dataclasses.replace(whole, d=np.array(info.d)).project(points)
    # The first pixel's centre is (0, 0), so its upper left corner (-0.5, -0.5), in both.
    np.testing.assert_allclose(part.project(points), (seen + 0.5 - (320, 120)) / (2, 4) - 0.5, atol=1e-9)
    np.testing.assert_allclose(part.rays(part.project(points)), points / points[:, 2:], atol=1e-9)
    assert part.p[0, 3] / part.p[0, 0] == pytest.approx(-0.12)
    info.roi.width = 1000
    with pytest.raises(ValueError, match="region of interest 1000 x 480 at 320, 120 px leaves the image of 1280 x 720"):
        camera_model(info)


def test_an_uncalibrated_camera_is_called_that() -> None:
    """By CameraInfo.msg K is 0 then; what else is missing in it is of no interest."""
    with pytest.raises(ValueError, match=r"^the camera is not calibrated \(K is 0\)$"):
        camera_model(CameraInfo(width=800, height=480))


def test_another_frame_than_expected_is_refused_by_name() -> None:
    check_frame(HEAD, "camera_left_optical_frame")
    with pytest.raises(ValueError, match="frame 'camera_left_optical_frame'; expected 'panel_link'"):
        check_frame(HEAD, "panel_link")


def test_a_dimple_travels_with_its_knob() -> None:
    dimple = Dimple(place_mm=(1.0, -8.5), diameter_mm=5.5, depth_mm=1.5)
    plain = Control(name="A", kind="knob", position_mm=(30, 20), size_mm=(20, 20), shape="circle", height_mm=15)
    knobs = (plain, dataclasses.replace(plain, name="B", position_mm=(60, 20), dimple=dimple))
    layout = PanelLayout(model="m", title="", size_mm=(100, 50), colour="#000000", controls=knobs, artwork=())
    message = controls_message(layout, HEAD)
    found = controls_of_message(message)[0]
    assert found[0].dimple is None and found[1].dimple is not None
    got = found[1].dimple
    assert (*got.place_mm, got.diameter_mm, got.depth_mm) == pytest.approx((1.0, -8.5, 5.5, 1.5))
    message.markers[1].points.pop()
    with pytest.raises(ValueError, match="marker 'B' has 1 points"):
        controls_of_message(message)
