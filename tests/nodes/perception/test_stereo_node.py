"""Stereo node: metres, stamps and the plane of a known scene; thinning; what it says when something is missing."""

from __future__ import annotations

import itertools
from dataclasses import replace
from typing import Any

import cv2
import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PoseStamped
from sensor_msgs.msg import CameraInfo, Image, PointCloud2
from unit.harris_perception.rendered_stylus import stereo_model

from harris_perception.core.corners.harris import HarrisConfig, HarrisDetector
from harris_perception.core.stereo.stereo_matching import StereoMatchConfig
from harris_perception.nodes.stereo_node import Matcher, StereoConfig, StereoNode
from icu_common.core.geometry.camera_model import StereoModel
from icu_common.nodes import qos
from icu_common.nodes.messages.cameras import camera_info_message, image_message
from icu_common.nodes.messages.clouds import cloud_array, cloud_message
from icu_common.nodes.messages.heads import header, stamp_ns
from icu_common.nodes.messages.places import transform_of_pose

WITHIN_S = 30.0
STEREO = stereo_model()
NORMAL = np.array([0.0, -np.sin(np.deg2rad(25.0)), -np.cos(np.deg2rad(25.0))])
CENTRE = np.array([0.07, 0.0, 0.62])


def panel_pictures(seed: int = 1, stereo: StereoModel = STEREO) -> list[Any]:
    """Return raw grey images of a textured plane through CENTRE with NORMAL: every raw pixel's ray meets it."""
    rng = np.random.default_rng(seed)
    texture = np.full((900, 1200), 150.0, np.float32)
    for _ in range(700):
        x, y = rng.integers(0, 1200), rng.integers(0, 900)
        texture[y : y + rng.integers(8, 50), x : x + rng.integers(8, 50)] = rng.uniform(30, 230)
    texture = cv2.GaussianBlur(texture, (0, 0), 1.5)
    up = np.cross(NORMAL, [1.0, 0.0, 0.0])
    pictures = []
    for model, eye in ((stereo.left, 0.0), (stereo.right, stereo.baseline)):
        v, u = np.mgrid[0 : model.height, 0 : model.width]
        rays = model.rays(np.column_stack([u.ravel(), v.ravel()]))
        origin = np.array([eye, 0.0, 0.0])
        spot = origin + rays * (((CENTRE - origin) @ NORMAL) / (rays @ NORMAL))[:, None] - CENTRE
        mapx = (600 + 2500 * spot[:, 0]).astype(np.float32).reshape(model.height, model.width)
        mapy = (450 + 2500 * spot @ up).astype(np.float32).reshape(model.height, model.width)
        picture = cv2.remap(texture, mapx, mapy, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT)
        pictures.append(np.clip(picture + rng.normal(0, 1.5, picture.shape), 0, 255).astype(np.uint8))
    return pictures


PICTURES = panel_pictures()
CORNERS = [HarrisDetector(HarrisConfig(max_corners=800)).detect(picture).xy for picture in PICTURES]


@pytest.mark.parametrize("finer", [0.5, 0.8, 1.25])
def test_points_are_those_of_the_whole_left_picture_whatever_the_right_sensor(finer: float) -> None:
    right = STEREO.right
    size = {"width": round(right.width * finer), "height": round(right.height * finer)}
    sensor = replace(right, **size, k=np.diag([finer, finer, 1.0]) @ right.k)
    stereo = StereoModel(left=STEREO.left, right=sensor)
    detector = HarrisDetector(HarrisConfig(max_corners=800))
    pictures = panel_pictures(stereo=stereo)
    images = [image_message(picture, "mono8", header(1, "")) for picture in pictures]
    clouds = [cloud_message(("u", "v"), detector.detect(picture).xy, header(1, "")) for picture in pictures]
    config = StereoConfig(matching=StereoMatchConfig(min_depth_m=0.5, max_depth_m=0.8))
    points = Matcher(stereo, config).points((images[0], images[1]), (clouds[0], clouds[1]))
    rows = STEREO.left.project(points[:, :3])[:, 1]
    print(f"{finer} times as fine: {len(points)} points, {(rows > 400).sum()} of them in the lowest sixth")
    assert len(points) > 80 and (rows > 400).sum() > 10
    assert np.median(np.abs((points[:, :3] - CENTRE) @ NORMAL)) < 0.0005


class Rig:
    """Publishers of everything the node takes, and what it gave."""

    def __init__(self, ros: Any, **parameters: Any) -> None:
        self.ros, self.probe = ros, ros.plain()
        kinds = ((Image, "image_raw", qos.IMAGES), (CameraInfo, "camera_info", qos.IMAGES))
        self.out = {
            f"{side}/{name}": self.probe.create_publisher(kind, f"{side}/{name}", profile)
            for side in ("left", "right")
            for kind, name, profile in (*kinds, (PointCloud2, "corners", qos.RESULTS))
        }
        self.points: list[PointCloud2] = ros.collect(self.probe, PointCloud2, "points2", qos.RESULTS)
        self.planes: list[PoseStamped] = ros.collect(self.probe, PoseStamped, "panel_plane", qos.RESULTS)
        self.diagnostics: list[DiagnosticArray] = ros.collect(self.probe, DiagnosticArray, "/diagnostics", qos.RESULTS)
        self.node = ros.node(StereoNode, parameters)
        names = ("points2", "panel_plane")
        ros.spin_until(
            lambda: (
                all(p.get_subscription_count() for p in self.out.values())
                and all(self.node.count_subscribers(n) and self.probe.count_publishers(n) for n in names)
            ),
            WITHIN_S,
        )

    def calibrate(self) -> None:
        for side, model in (("left", STEREO.left), ("right", STEREO.right)):
            self.out[f"{side}/camera_info"].publish(camera_info_message(model, header(1, "")))
        self.ros.spin_until(lambda: self.node._matcher is not None, WITHIN_S)

    def show(self, stamp: int, *, right_late_ns: int = 0, without: str = "", deep: bool = False) -> None:
        """Publish one moment: corners first, as nothing promises an order."""
        for i, side in enumerate(("left", "right")):
            head = header(stamp + right_late_ns * i, f"camera_{side}_optical_frame")
            cloud = np.column_stack([CORNERS[i], np.ones(len(CORNERS[i]))])
            if without != f"{side}/corners":
                self.out[f"{side}/corners"].publish(cloud_message(("u", "v", "response"), cloud, head))
            picture, encoding = (PICTURES[i].astype(np.uint16) * 16, "mono16") if deep else (PICTURES[i], "mono8")
            self.out[f"{side}/image_raw"].publish(image_message(picture, encoding, head))

    def said(self) -> list[str]:
        return [s.message for d in self.diagnostics for s in d.status if s.name == "stereo"]

    def values(self) -> dict[str, str]:
        status = [s for d in self.diagnostics for s in d.status if s.name == "stereo"]
        return {pair.key: pair.value for pair in status[-1].values} if status else {}


def test_points_and_plane_of_a_known_panel(ros: Any) -> None:
    rig = Rig(ros)
    rig.calibrate()
    stamp = 1_600_000_000_250_000_000
    rig.show(stamp)
    ros.spin_until(lambda: rig.points and rig.planes, WITHIN_S, rig.said)
    cloud, plane = rig.points[0], rig.planes[0]
    for message in (cloud, plane):
        assert stamp_ns(message.header.stamp) == stamp and message.header.frame_id == "camera_left_optical_frame"
    xyz = cloud_array(cloud, ("x", "y", "z")).astype(float)
    sigma = cloud_array(cloud, ("sigma",))[:, 0]
    off = (xyz - CENTRE) @ NORMAL
    assert len(xyz) > 120 and np.mean(np.abs(off) < 0.001) > 0.9 and sigma.min() > 0 and sigma.max() < 0.003
    pose = transform_of_pose(plane.pose)
    angle = np.degrees(np.arccos(min(1.0, pose.rotation[:, 2] @ NORMAL)))
    assert angle < 0.2 and abs((pose.translation - CENTRE) @ NORMAL) < 0.0003
    ros.spin_until(lambda: rig.values().get("plane_share"), WITHIN_S)
    assert float(rig.values()["plane_share"]) > 0.85 and int(rig.values()["points"]) == len(xyz)
    ros.spin_until(lambda: "no pictures with corners in the last second" in rig.said()[-1], WITHIN_S, rig.said)


def test_pictures_of_12_bits_give_the_points_of_those_of_8(ros: Any) -> None:
    rig = Rig(ros)
    rig.calibrate()
    for number, deep in enumerate((False, True), start=1):
        rig.show(number * 1_000_000_000, deep=deep)
        ros.spin_until(lambda n=number: len(rig.points) == n, WITHIN_S, rig.said)
    shallow, deep_points = (cloud_array(cloud, ("x", "y", "z")) for cloud in rig.points)
    assert abs(len(deep_points) - len(shallow)) <= 0.05 * len(shallow)
    ros.spin_until(lambda: len(rig.planes) == 2, WITHIN_S, rig.said)
    apart = [p.pose.position.z for p in rig.planes]
    assert apart[0] == pytest.approx(apart[1], abs=0.0001)


def test_without_a_reader_it_takes_no_images_and_has_nothing_to_warn_of(ros: Any) -> None:
    rig, stamps = Rig(ros), itertools.count(1_000_000_000, 100_000_000)
    rig.calibrate()
    readers = [s for s in rig.probe.subscriptions if s.topic_name in ("/points2", "/panel_plane")]
    assert len(readers) == 2
    for reader in readers:
        rig.probe.destroy_subscription(reader)
    inputs = [rig.out[f"{side}/{name}"] for side in ("left", "right") for name in ("image_raw", "corners")]
    ros.spin_until(lambda: not any(p.get_subscription_count() for p in inputs), WITHIN_S)
    ros.spin_until(lambda: rig.said()[-1:] == ["idle: no subscriber"], WITHIN_S, rig.said)
    status = next(s for d in reversed(rig.diagnostics) for s in d.status if s.name == "stereo")
    assert status.level == DiagnosticStatus.OK and not rig.points
    points: list[PointCloud2] = ros.collect(rig.probe, PointCloud2, "points2", qos.RESULTS)
    ros.spin_until(lambda: all(p.get_subscription_count() for p in inputs), WITHIN_S)

    def seen() -> bool:
        rig.show(next(stamps))
        return bool(points)

    ros.spin_until(seen, WITHIN_S, rig.said)


def test_in_step_with_a_recording_it_takes_images_without_a_reader(ros: Any) -> None:
    probe = ros.plain()
    images = [probe.create_publisher(Image, f"{side}/image_raw", qos.IMAGES) for side in ("left", "right")]
    ros.node(StereoNode, {"on_demand": False})
    ros.spin_until(lambda: all(p.get_subscription_count() for p in images), WITHIN_S)


def test_pairs_are_thinned_by_their_own_stamps(ros: Any) -> None:
    rig = Rig(ros, rate_hz=5.0)
    rig.calibrate()
    stamps = [1_000_000_000 + i * 66_666_667 for i in range(7)]
    for stamp in stamps:
        rig.show(stamp)
        ros.spin_until(lambda stamp=stamp: rig.node._sets.newest_ns == stamp, WITHIN_S)
    ros.spin_until(lambda: len(rig.points) >= 3, WITHIN_S)
    assert [stamp_ns(p.header.stamp) for p in rig.points] == [stamps[0], stamps[3], stamps[6]]


def test_unsynchronised_cameras_are_paired_within_the_tolerance(ros: Any) -> None:
    rig = Rig(ros, pair_tolerance_s=0.005)
    rig.calibrate()
    rig.show(1_000_000_000, right_late_ns=9_000_000)
    rig.show(2_000_000_000, right_late_ns=4_000_000)
    ros.spin_until(lambda: rig.points, WITHIN_S)
    assert [stamp_ns(p.header.stamp) for p in rig.points] == [2_000_000_000]
    ros.spin_until(lambda: int(rig.values().get("unpaired", 0)) == 4, WITHIN_S, rig.values)


def test_what_is_missing_is_said_and_nothing_is_published(ros: Any) -> None:
    rig = Rig(ros)
    ros.spin_until(lambda: any("no camera_info yet" in text for text in rig.said()), WITHIN_S, rig.said)
    rig.out["left/camera_info"].publish(CameraInfo(width=800, height=480))
    rig.out["right/camera_info"].publish(camera_info_message(STEREO.right, header(1, "")))
    complaint = "left camera_info: the camera is not calibrated"
    ros.spin_until(lambda: any(complaint in text for text in rig.said()), WITHIN_S, rig.said)
    rig.show(500_000_000)
    ros.spin_until(lambda: rig.node._sets.newest_ns == 500_000_000, WITHIN_S)
    rig.calibrate()
    rig.show(1_000_000_000, without="right/corners")
    rig.show(2_000_000_000)
    ros.spin_until(lambda: rig.points, WITHIN_S)
    assert [stamp_ns(p.header.stamp) for p in rig.points] == [2_000_000_000]


def test_a_setting_out_of_bounds_is_refused_at_the_start(ros: Any) -> None:
    with pytest.raises(Exception, match="rate_hz"):
        ros.node(StereoNode, {"rate_hz": 0.0})
