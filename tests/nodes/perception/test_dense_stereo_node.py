"""Dense stereo node: disparity, metres and colours of a known plane; idle without readers; what it says."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from sensor_msgs.msg import CameraInfo, Image, PointCloud2
from stereo_msgs.msg import DisparityImage
from unit.harris_perception.rendered_stylus import stereo_model

from harris_perception.core.stereo.dense_stereo import DenseStereo
from harris_perception.nodes.dense_stereo_node import DenseStereoNode
from icu_common.nodes import qos
from icu_common.nodes.messages.cameras import camera_info_message, image_message
from icu_common.nodes.messages.clouds import cloud_array
from icu_common.nodes.messages.heads import header, stamp_ns

WITHIN_S = 30.0
STEREO = stereo_model()
DEPTH_M = 0.62
LIMITS = {"limits.min_depth_m": 0.5, "limits.max_depth_m": 0.8, "limits.binning": 2}
BGR = (40, 120, 200)
SEED = 3


def wall() -> list[Any]:
    """Return raw colour pictures of a wall at DEPTH_M across the view, its upper half reddish, its lower half grey."""
    rng = np.random.default_rng(SEED)
    layers = [cv2.GaussianBlur(rng.normal(0, 1, (900, 1200)), (0, 0), size) * size for size in (1.5, 3.0)]
    drawing = (0.8 + 0.25 * sum(layers)).clip(0.2, 1.2).astype(np.float32)
    pictures = []
    for model, eye in ((STEREO.left, 0.0), (STEREO.right, STEREO.baseline)):
        v, u = np.mgrid[0 : model.height, 0 : model.width]
        spot = model.rays(np.column_stack([u.ravel(), v.ravel()])) * DEPTH_M
        x, y = spot[:, 0] + eye, spot[:, 1]
        at = [(size / 2 + 2700 * p).astype(np.float32).reshape(v.shape) for p, size in ((x, 1200), (y, 900))]
        light = cv2.remap(drawing, *at, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT)
        tint = np.where((y < 0).reshape(v.shape)[..., None], BGR, (150, 150, 150))
        pictures.append((light[..., None] * tint + rng.normal(0, 0.5, tint.shape)).clip(0, 255).astype(np.uint8))
    return pictures


PICTURES = wall()


class Rig:
    """Publishers of everything the node takes, and what it gave."""

    def __init__(self, ros: Any, **parameters: Any) -> None:
        self.ros, self.probe = ros, ros.plain()
        self.out = {
            f"{side}/{name}": self.probe.create_publisher(kind, f"{side}/{name}", qos.IMAGES)
            for side in ("left", "right")
            for kind, name in ((Image, "image_raw"), (CameraInfo, "camera_info"))
        }
        self.diagnostics: list[DiagnosticArray] = ros.collect(self.probe, DiagnosticArray, "/diagnostics", qos.RESULTS)
        self.node = ros.node(DenseStereoNode, LIMITS | parameters)

    def read(self, kind: Any, topic: str) -> list[Any]:
        """Subscribe, and wait until the node has detected it and subscribes to the images itself."""
        received: list[Any] = self.ros.collect(self.probe, kind, topic, qos.IMAGES)
        self.ros.spin_until(lambda: self.node.count_subscribers(topic) and self.pictures_wanted(), WITHIN_S)
        self.ros.spin_until(lambda: self.probe.count_publishers(topic), WITHIN_S)
        return received

    def pictures_wanted(self) -> bool:
        return all(self.out[f"{side}/image_raw"].get_subscription_count() for side in ("left", "right"))

    def calibrate(self) -> None:
        names = [f"{side}/camera_info" for side in ("left", "right")]
        self.ros.spin_until(lambda: all(self.out[n].get_subscription_count() for n in names), WITHIN_S)
        for name, model in zip(names, (STEREO.left, STEREO.right)):
            self.out[name].publish(camera_info_message(model, header(1, "")))
        self.ros.spin_until(lambda: self.node._stereo is not None, WITHIN_S)

    def show(
        self, stamp: int, *, right_late_ns: int = 0, encoding: str = "bgr8", pictures: list[Any] = PICTURES
    ) -> None:
        for i, side in enumerate(("left", "right")):
            head = header(stamp + right_late_ns * i, f"camera_{side}_optical_frame")
            self.out[f"{side}/image_raw"].publish(image_message(pictures[i], encoding, head))

    def status(self) -> Any:
        found = [s for d in self.diagnostics for s in d.status if s.name == "dense_stereo"]
        return found[-1] if found else None

    def values(self) -> dict[str, str]:
        return {pair.key: pair.value for pair in self.status().values} if self.status() else {}


def test_disparity_and_points_of_a_wall(ros: Any) -> None:
    rig = Rig(ros)
    rig.calibrate()
    disparities, clouds = rig.read(DisparityImage, "disparity"), rig.read(PointCloud2, "dense_points")
    stamp = 1_600_000_000_250_000_000
    rig.show(stamp)
    ros.spin_until(lambda: disparities and clouds, WITHIN_S, rig.status)
    message, cloud = disparities[0], clouds[0]
    for head in (message.header, message.image.header, cloud.header):
        assert stamp_ns(head.stamp) == stamp and head.frame_id == "camera_left_optical_frame"
    # As stereo_image_proc has it: depth is f t / d, sixteenths of a pixel, unknown is below the least.
    assert message.image.encoding == "32FC1" and (message.image.height, message.image.width) == (240, 400)
    assert message.f == 850.0 and abs(message.t - STEREO.baseline) < 1e-6 and message.delta_d == 1 / 16
    assert message.min_disparity <= 850 * 0.12 / 0.8 and message.max_disparity >= 850 * 0.12 / 0.5
    raw = np.frombuffer(message.image.data, np.float32).reshape(240, 400)
    window = message.valid_window
    assert (window.x_offset, window.width, window.height) == (126, 274, 240) and (raw[:, :126] < 126).all()
    disparity = np.where(raw < message.min_disparity, np.nan, raw)
    expected = 850 * 0.12 / DEPTH_M
    seen = disparity[5:-5, 180:-5]
    assert np.isfinite(seen).mean() > 0.95 and abs(np.nanmedian(seen) - expected) < 0.1
    assert np.nanmean(np.abs(seen - expected) < 0.5) > 0.97
    assert (cloud.height, cloud.width, cloud.point_step, cloud.row_step) == (240, 400, 16, 6400) and not cloud.is_dense
    xyz = cloud_array(cloud, ("x", "y", "z")).reshape(240, 400, 3)
    assert np.array_equal(np.isfinite(xyz[..., 2]), np.isfinite(disparity))
    assert abs(np.nanmedian(xyz[..., 2]) - DEPTH_M) < 0.0005
    centre = (STEREO.left.p[:2, 2] + 0.5) / 2 - 0.5
    x, y = 300, 60
    known = np.argwhere(np.isfinite(disparity[y - 3 : y + 4, x - 3 : x + 4]))[0] + (y - 3, x - 3)
    point = xyz[tuple(known)]
    assert np.allclose(point[:2], (known[::-1] - centre) / 850 * point[2], atol=1e-5)
    colours = np.frombuffer(cloud.data, np.uint8).reshape(240, 400, 16)[:, :, 12:]
    above, below = colours[20:100, 150:].reshape(-1, 4), colours[140:220, 150:].reshape(-1, 4)
    assert np.allclose(above[:, :3].mean(axis=0) / above[:, 2].mean() * BGR[2], BGR, atol=4)
    assert np.ptp(below[:, :3].mean(axis=0)) < 2 and not colours[..., 3].any()
    ros.spin_until(lambda: rig.values().get("known_share"), WITHIN_S)
    assert rig.status().message == "matching" and 0.4 < float(rig.values()["known_share"]) < 0.7


def test_nothing_is_computed_and_no_picture_taken_without_a_reader(ros: Any, monkeypatch: Any) -> None:
    worked: list[str] = []
    for name in ("disparity", "points"):
        real = getattr(DenseStereo, name)
        monkeypatch.setattr(DenseStereo, name, lambda *a, name=name, real=real: worked.append(name) or real(*a))
    rig = Rig(ros)
    rig.calibrate()
    ros.spin_until(lambda: rig.status() and rig.status().message.startswith("idle"), WITHIN_S)
    rig.show(1_000_000_000)
    assert not rig.pictures_wanted()
    reader = rig.probe.create_subscription(DisparityImage, "disparity", lambda message: None, qos.IMAGES)
    ros.spin_until(rig.pictures_wanted, WITHIN_S)
    rig.show(2_000_000_000)
    ros.spin_until(lambda: rig.node._matched == 1, WITHIN_S)
    assert worked == ["disparity"]
    rig.probe.destroy_subscription(reader)
    ros.spin_until(lambda: not rig.node._listening, WITHIN_S)
    ros.spin_until(lambda: not rig.pictures_wanted(), WITHIN_S)
    rig.show(3_000_000_000)
    clouds = rig.read(PointCloud2, "dense_points")
    rig.show(4_000_000_000)
    ros.spin_until(lambda: clouds, WITHIN_S)
    assert [stamp_ns(c.header.stamp) for c in clouds] == [4_000_000_000]
    assert worked == ["disparity", "disparity", "points"]


@pytest.mark.parametrize("side", [0, 1])
def test_a_glint_in_one_picture_of_12_bits_costs_no_disparity(ros: Any, side: int) -> None:
    rig = Rig(ros)
    rig.calibrate()
    disparities = rig.read(DisparityImage, "disparity")
    deep = [np.minimum(picture, 250).astype(np.uint16) * 4 for picture in PICTURES]  # a quarter of the full light
    for number, brightest in enumerate((1000, 1100), start=1):
        deep[side][0, 0] = brightest
        rig.show(number * 1_000_000_000, encoding="bgr16", pictures=deep)
        ros.spin_until(lambda n=number: len(disparities) == n, WITHIN_S, rig.status)
    before, with_glint = (np.frombuffer(d.image.data, np.float32) >= d.min_disparity for d in disparities)
    assert with_glint.mean() > 0.8 * before.mean() > 0.4


def test_pairs_by_near_stamps_and_what_stays_alone_is_counted(ros: Any) -> None:
    rig = Rig(ros, pair_tolerance_s=0.005, rate_hz=5.0)
    rig.calibrate()
    disparities = rig.read(DisparityImage, "disparity")
    rig.show(1_000_000_000, right_late_ns=9_000_000)
    ros.spin_until(lambda: all(rig.node._pairs._waiting), WITHIN_S)
    for stamp, late in ((2_000_000_000, 4_000_000), (2_100_000_000, 0), (3_000_000_000, 0)):
        rig.show(stamp, right_late_ns=late)
        ros.spin_until(lambda stamp=stamp: rig.node._pairs.newest_ns == stamp, WITHIN_S)
    ros.spin_until(lambda: len(disparities) == 2, WITHIN_S)
    assert [stamp_ns(d.header.stamp) for d in disparities] == [2_000_000_000, 3_000_000_000]
    ros.spin_until(lambda: rig.values().get("unpaired") == "2", WITHIN_S, rig.values)
    assert rig.values()["pairs"] == "2"


def test_what_is_missing_or_wrong_is_said(ros: Any) -> None:
    rig = Rig(ros)
    disparities = rig.read(DisparityImage, "disparity")
    ros.spin_until(lambda: rig.status() and rig.status().message == "no camera_info yet", WITHIN_S, rig.status)
    rig.calibrate()
    for i, side in enumerate(("left", "right")):
        small = np.ascontiguousarray(PICTURES[i][:100, :100])
        rig.out[f"{side}/image_raw"].publish(image_message(small, "bgr8", header(1_000_000_000, "")))
    ros.spin_until(lambda: "(480, 800)" in rig.status().message, WITHIN_S, rig.status)
    rig.show(2_000_000_000)
    ros.spin_until(lambda: disparities, WITHIN_S)
    ros.spin_until(lambda: rig.status().message == "matching", WITHIN_S, rig.status)
    ros.spin_until(lambda: "no pairs of pictures in the last second" in rig.status().message, WITHIN_S, rig.status)
