"""The hand-eye node: runs against a machine with hidden errors, saves, loads, and refuses with reasons."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PointStamped, PoseStamped, TransformStamped
from rclpy.parameter import Parameter
from sensor_msgs.msg import CameraInfo, JointState, PointCloud2
from std_msgs.msg import Float64MultiArray, String
from std_srvs.srv import Trigger
from unit.harris_perception.rectified_pair import camera, measured_face, stored_calibration

from harris_perception.core.hand_eye.calibration_file import StoredCalibration, load, save
from harris_perception.core.hand_eye.tip_samples import Sample
from harris_perception.core.pose.planar_pose import FACE_POINT_COLUMNS
from harris_perception.nodes.hand_eye_node import HandEyeNode
from icu_common.core.geometry.frames import BASE, CAMERA_LEFT, JOINTS
from icu_common.core.geometry.geometry import Transform
from icu_common.core.goals.results import GoalResult, Outcome
from icu_common.nodes import qos
from icu_common.nodes.messages.answers import answer_of
from icu_common.nodes.messages.cameras import camera_info_message
from icu_common.nodes.messages.clouds import cloud_message
from icu_common.nodes.messages.heads import header, stamp_ns
from icu_common.nodes.messages.joints import joint_message
from icu_common.nodes.messages.places import point_message, pose_message, transform_of_message
from icu_common.nodes.messages.results import result_message

AXES = np.array([[1.003, -0.002], [0.0, 0.998]])
TURN = np.asarray(cv2.Rodrigues(np.array([2.71, 0.05, -0.08]))[0], dtype=float)
POSE = Transform(TURN, np.array([-0.17, 0.09, 0.66]))
QUICK = {
    "run.columns": 3,
    "run.rows": 2,
    "run.held_out": 2,
    "still.tips": 3,
    "still.settle_s": 0.0,
    "still.fresh_s": 10.0,  # nothing is sent while a service is called, which takes long on a busy machine
    "run.look_timeout_s": 30.0,
    "run.accept_timeout_s": 30.0,
}


class Rig:
    """The node, a machine that obeys its goals at once, and eyes that see the tip."""

    def __init__(self, ros: Any, focal: float = 1700.0, **parameters: Any) -> None:
        self.ros = ros
        self.reading = np.zeros(3)
        self.rng = np.random.default_rng(1)
        self.off = np.zeros(3)
        self.outcome, self.reason = Outcome.REACHED, ""
        self.goals: list[PointStamped] = []
        self.node = ros.node(HandEyeNode, {**QUICK, **parameters})
        self.probe = probe = ros.plain()
        self.states: list[String] = ros.collect(probe, String, "state", qos.LATCHED)
        self.transforms: list[TransformStamped] = ros.collect(probe, TransformStamped, "camera_from_base", qos.LATCHED)
        self.axes: list[Float64MultiArray] = ros.collect(probe, Float64MultiArray, "axes", qos.LATCHED)
        probe.create_subscription(PointStamped, "goal", self._obey, qos.COMMAND)
        self.tips = probe.create_publisher(PointStamped, "tip", qos.RESULTS)
        self.joints = probe.create_publisher(JointState, "joint_states", qos.RESULTS)
        self.driver = probe.create_publisher(String, "driver_state", qos.LATCHED)
        self.results = probe.create_publisher(DiagnosticArray, "result", qos.RESULTS)
        self.infos = [probe.create_publisher(CameraInfo, f"{s}/camera_info", qos.IMAGES) for s in ("left", "right")]
        self.clients = {n: probe.create_client(Trigger, n) for n in ("run", "add_sample", "solve", "save")}
        for publisher in (self.tips, self.joints, self.driver, self.results, *self.infos):
            ros.spin_until(lambda p=publisher: p.get_subscription_count() == 1, 10.0)
        for client in self.clients.values():
            ros.spin_until(client.service_is_ready, 10.0)
        ros.spin_until(lambda: self.node._goal.get_subscription_count() == 1 and self.states, 10.0)
        self.focal = focal

    def cameras(self) -> None:
        for publisher, baseline in zip(self.infos, (0.0, 0.12)):
            publisher.publish(camera_info_message(camera(self.focal, baseline), header(1, CAMERA_LEFT)))
        self.ros.spin_until(lambda: len(self.node.calibrator.cameras) == 2, 10.0)

    def now(self) -> int:
        return int(self.probe.get_clock().now().nanoseconds)

    def say_driver(self, text: str) -> None:
        self.driver.publish(String(data=text))
        self.ros.spin_until(lambda: self.node.calibrator.driver == text, 10.0)

    def _obey(self, goal: PointStamped) -> None:
        assert goal.header.frame_id == BASE
        self.goals.append(goal)
        self.reading = np.round(np.array([goal.point.x, goal.point.y, -goal.point.z]) * 80e3) / 80e3
        self.look()
        for outcome in (Outcome.ACCEPTED, self.outcome):
            reason = self.reason if outcome is self.outcome else ""
            answer = GoalResult(goal_id=str(stamp_ns(goal.header.stamp)), goal="", outcome=outcome, reason=reason)
            self.results.publish(result_message(answer, self.now()))

    def look(self) -> None:
        self.joints.publish(joint_message(JOINTS, self.reading, header(self.now(), BASE)))
        tip = POSE.apply(self.tip_base() + self.off) + self.rng.normal(0, (0.00003, 0.00003, 0.00012))
        self.tips.publish(point_message(tip, header(self.now(), CAMERA_LEFT)))

    def tip_base(self) -> Any:
        return np.array([*(AXES @ self.reading[:2]), -self.reading[2]])

    def watch(self, condition: Any, within_s: float) -> None:
        def looked() -> Any:
            self.look()
            return condition()

        self.ros.spin_until(looked, within_s, lambda: self.state)

    @property
    def state(self) -> str:
        return str(self.states[-1].data) if self.states else ""

    def call(self, name: str) -> tuple[bool, str]:
        future = self.clients[name].call_async(Trigger.Request())
        self.ros.spin_until(future.done, 10.0)
        return future.result().success, answer_of(future.result().message)


def test_run_calibrates_publishes_and_saves(ros: Any, tmp_path: Path) -> None:
    path = tmp_path / "hand_eye.yaml"
    rig = Rig(ros, calibration_file=str(path), machine="bench")
    assert rig.state == "uncalibrated"
    rig.cameras()
    rig.say_driver("idle")
    assert rig.call("run") == (True, "calibrating; watch the state")
    rig.watch(lambda: rig.state.startswith(("calibrated", "failed")), 60.0)
    assert rig.state.startswith("calibrated: 18 samples, rms 0."), rig.state
    rig.ros.spin_until(lambda: rig.transforms and rig.axes, 10.0)
    message = rig.transforms[-1]
    assert (message.header.frame_id, message.child_frame_id) == (CAMERA_LEFT, BASE)
    query = np.array([(0.05, 0.05, -0.03), (0.3, 0.15, -0.03)])
    error = np.linalg.norm(transform_of_message(message).apply(query) - POSE.apply(query), axis=1)
    print("pose error mm", error * 1e3)
    assert error.max() < 0.0005
    np.testing.assert_allclose(np.array(rig.axes[-1].data).reshape(2, 2), AXES, atol=0.001)
    kept = load(path)
    assert (kept.machine, kept.samples, kept.right is not None) == ("bench", 18, True)
    assert 0 < kept.held_out_m < 0.001
    heights = {round(g.point.z, 4) for g in rig.goals}
    assert heights == {0.0, -0.016, -0.006}
    # Two positions at the lower end of each axis, which the controller enters from above, show the backlash.
    assert [sum(value(g.point) == 0.0 for g in rig.goals) for value in (lambda p: p.x, lambda p: p.y)] == [2, 2]
    assert np.abs(kept.backlash_m).max() < 0.0002, "this machine has none"
    assert (kept.backlash_sigma_m > 0).all()


def test_stop_of_the_driver_fails_the_run(ros: Any) -> None:
    rig = Rig(ros)
    rig.cameras()
    rig.say_driver("idle")
    rig.call("run")
    rig.watch(lambda: len(rig.goals) >= 3, 20.0)
    rig.say_driver("stopped: by the operator")
    rig.ros.spin_until(lambda: rig.state.startswith("failed"), 10.0)
    assert rig.state == "failed: the driver reports 'stopped: by the operator'"
    goals = len(rig.goals)
    rig.say_driver("idle")
    assert rig.call("save") == (False, "no calibration_file")
    assert len(rig.goals) == goals


def test_refused_goal_gives_its_reason(ros: Any) -> None:
    rig = Rig(ros)
    rig.cameras()
    rig.say_driver("idle")
    rig.outcome, rig.reason = Outcome.REJECTED, "no heartbeat"
    rig.call("run")
    rig.watch(lambda: rig.state.startswith("failed"), 10.0)
    assert "was rejected: no heartbeat" in rig.state


def test_run_is_refused_with_what_is_missing(ros: Any) -> None:
    rig = Rig(ros)
    assert rig.call("run") == (False, "the driver reports 'unknown'; expected connected, homed and idle")
    rig.say_driver("unhomed")
    assert rig.call("run") == (False, "the driver reports 'unhomed'; expected connected, homed and idle")
    rig.say_driver("idle")
    assert rig.call("run") == (False, "no camera_info of the left camera has arrived")
    assert rig.goals == []


def test_a_tip_that_is_not_finite_makes_no_sample(ros: Any) -> None:
    rig = Rig(ros)
    rig.watch(lambda: len(rig.node.calibrator.watch._tips) == 3, 10.0)
    rig.tips.publish(point_message((math.nan, 0.0, 0.6), header(rig.now(), CAMERA_LEFT)))
    after = rig.now()
    rig.tips.publish(point_message(POSE.apply(rig.tip_base()), header(after, CAMERA_LEFT)))
    ros.spin_until(lambda: rig.node.calibrator.watch._tips[-1][0] == after, 10.0)
    assert np.isfinite([tip for _, tip in rig.node.calibrator.watch._tips]).all()
    assert rig.call("add_sample") == (True, "sample 1 at readings x = 0.0, y = 0.0, stylus = 0.0 mm")
    assert np.isfinite(rig.node.calibrator.samples[0].tip).all()


def test_a_tip_of_a_camera_with_a_clock_ahead_makes_no_sample(ros: Any) -> None:
    """The machine could still have moved when it was seen."""
    rig = Rig(ros)
    rig.watch(lambda: len(rig.node.calibrator.watch._tips) == 3, 10.0)
    rig.tips.publish(point_message((0.0, 0.0, 0.6), header(rig.now() + 3_600_000_000_000, CAMERA_LEFT)))
    after = rig.now()
    rig.tips.publish(point_message(POSE.apply(rig.tip_base()), header(after, CAMERA_LEFT)))
    rig.ros.spin_until(lambda: rig.node.calibrator.watch._tips[-1][0] == after, 10.0)
    assert all(stamp <= after for stamp, _ in rig.node.calibrator.watch._tips)


def test_a_run_that_could_only_fail_moves_nothing(ros: Any) -> None:
    rig = Rig(ros, **{"run.y_max_m": 0.05})
    rig.cameras()
    rig.say_driver("idle")
    done, why = rig.call("run")
    assert not done and why.startswith("the run's positions do not determine the calibration: the samples"), why
    assert "at least 60 mm" in why and rig.goals == []


def test_samples_by_hand(ros: Any) -> None:
    rig = Rig(ros)
    rig.cameras()
    assert rig.call("add_sample") == (False, "no joint_states arrive")
    assert rig.call("solve") == (False, "0 samples (at least 6): move to another position and add one")
    assert rig.call("save") == (False, "no calibration_file")
    for number, place in enumerate([(0.05, 0.05), (0.3, 0.05), (0.3, 0.15), (0.05, 0.15), (0.1, 0.1), (0.2, 0.1)], 1):
        rig.reading = np.array([*place, 0.0])

        def rests_there(wanted: tuple[float, float] = place) -> bool:
            sample = rig.node.calibrator.watch.sample(rig.now())
            return isinstance(sample, Sample) and np.allclose(sample.reading[:2], wanted)

        rig.watch(rests_there, 10.0)
        done, text = rig.call("add_sample")
        assert done, text
        x, y = place[0] * 1e3, place[1] * 1e3
        assert text == f"sample {number} at readings x = {x:.1f}, y = {y:.1f}, stylus = 0.0 mm"
    done, text = rig.call("solve")
    assert done, text
    assert math.isnan(rig.node.calibrator.stored.held_out_m)
    axes = rig.ros.spin_until(lambda: rig.axes, 10.0)[-1]
    np.testing.assert_allclose(np.array(axes.data).reshape(2, 2), AXES, atol=0.002)


def stored(path: Path) -> StoredCalibration:
    calibration = stored_calibration(POSE, AXES)
    save(calibration, path)
    return calibration


def test_file_is_used_once_the_cameras_are_known(ros: Any, tmp_path: Path) -> None:
    path = tmp_path / "c.yaml"
    calibration = stored(path)
    rig = Rig(ros, calibration_file=str(path), machine="bench")
    assert rig.state == "uncalibrated: waiting for camera_info to check the calibration file"
    assert rig.transforms == []
    rig.cameras()
    ros.spin_until(lambda: rig.state.startswith("calibrated") and rig.transforms and rig.axes, 10.0)
    assert rig.state == f"calibrated: {calibration.summary()}"
    loaded = transform_of_message(rig.transforms[-1])
    np.testing.assert_allclose(loaded.rotation, POSE.rotation, atol=1e-12)
    np.testing.assert_allclose(loaded.translation, POSE.translation, atol=1e-12)
    assert list(rig.axes[-1].data) == AXES.ravel().tolist()


@pytest.mark.parametrize(
    ("focal", "machine", "reason"),
    [
        (1710.0, "bench", "the left camera's calibration has changed by 10.00 px since this calibration"),
        (1700.0, "other", "the calibration is for machine 'bench', this one is 'other'"),
    ],
)
def test_file_of_another_bench_is_refused(ros: Any, tmp_path: Path, focal: float, machine: str, reason: str) -> None:
    path = tmp_path / "c.yaml"
    stored(path)
    rig = Rig(ros, focal=focal, calibration_file=str(path), machine=machine)
    rig.cameras()
    ros.spin_until(lambda: rig.state.startswith("failed"), 10.0)
    assert rig.state == f"failed: the stored calibration does not fit: {reason}"
    assert rig.transforms == [] and rig.axes == []


def test_file_of_a_machine_that_cannot_be_is_refused(ros: Any, tmp_path: Path) -> None:
    path = tmp_path / "c.yaml"
    save(replace(stored(path), base_from_reading=-np.eye(2)), path)
    rig = Rig(ros, calibration_file=str(path), machine="bench")
    rig.cameras()
    ros.spin_until(lambda: rig.state.startswith(("failed", "calibrated")), 10.0)
    assert "the x axis moves -1.000 m per metre of reading (limits 0.95 to 1.05)" in rig.state
    assert rig.transforms == [] and rig.axes == []


def test_parameters_that_are_changed_hold_for_the_calibration_in_use(ros: Any, tmp_path: Path) -> None:
    path = tmp_path / "c.yaml"
    stored(path)
    rig = Rig(ros, calibration_file=str(path), machine="bench")
    rig.cameras()
    ros.spin_until(lambda: rig.state.startswith("calibrated"), 10.0)
    rig.reading = np.array([0.1, 0.1, 0.0])
    rig.off = np.array([0.02, 0.0, 0.0])
    wider = [Parameter("drift.max_tip_m", value=0.1), Parameter("drift.times", value=1)]
    assert rig.node.set_parameters_atomically(wider).successful
    rig.watch(lambda: rig.node.calibrator.drift.tip_m > 0.015, 15.0)
    assert "drift" not in rig.state
    assert rig.node.set_parameters([Parameter("drift.max_tip_m", value=0.01)])[0].successful
    rig.watch(lambda: "drift: the tip is" in rig.state, 15.0)
    assert rig.node.set_parameters([Parameter("drift.max_tip_m", value=0.1)])[0].successful
    rig.watch(lambda: rig.state.startswith("calibrated") and "drift" not in rig.state, 15.0)
    assert rig.node.set_parameters([Parameter("machine", value="other")])[0].successful
    ros.spin_until(lambda: rig.state.startswith("failed"), 10.0)
    assert rig.state.endswith("the calibration is for machine 'bench', this one is 'other'")
    ros.spin_until(lambda: not rig.axes[-1].data, 10.0)


def test_broken_file_is_named(ros: Any, tmp_path: Path) -> None:
    path = tmp_path / "c.yaml"
    path.write_text("nonsense")
    rig = Rig(ros, calibration_file=str(path))
    assert rig.state == f"failed: {path}: not a hand-eye calibration: expected format 2"


def test_calibration_in_use_is_withdrawn_when_the_camera_changes(ros: Any, tmp_path: Path) -> None:
    path = tmp_path / "c.yaml"
    stored(path)
    rig = Rig(ros, calibration_file=str(path), machine="bench")
    rig.cameras()
    ros.spin_until(lambda: rig.state.startswith("calibrated") and rig.axes, 10.0)
    changed = replace(camera(1703.0))
    rig.infos[0].publish(camera_info_message(changed, header(2, CAMERA_LEFT)))
    ros.spin_until(lambda: rig.state.startswith("failed") and not rig.axes[-1].data, 10.0)
    assert rig.state == (
        "failed: the calibration in use does not fit: the left camera's calibration has changed by 3.00 px since this "
        "made"
    )


def test_calibration_in_use_is_withdrawn_when_the_camera_has_none_any_more(ros: Any, tmp_path: Path) -> None:
    path = tmp_path / "c.yaml"
    stored(path)
    rig = Rig(ros, calibration_file=str(path), machine="bench")
    rig.cameras()
    ros.spin_until(lambda: rig.state.startswith("calibrated") and rig.axes, 10.0)
    # Message of the camera node about images in another resolution than that of its calibration.
    rig.infos[0].publish(CameraInfo(header=header(2, CAMERA_LEFT), width=640, height=480))
    ros.spin_until(lambda: rig.state.startswith("failed") and not rig.axes[-1].data, 10.0, lambda: rig.state)
    assert rig.state == (
        "failed: the calibration in use does not fit: the left camera's images of 640 x 480 px have no calibration"
    )
    rig.say_driver("idle")
    assert rig.call("run") == (False, "no camera_info of the left camera has arrived")
    ros.spin_until(lambda: not rig.axes[-1].data, 10.0)
    rig.cameras()
    ros.spin_until(lambda: rig.state.startswith("calibrated") and rig.axes[-1].data, 10.0, lambda: rig.state)
    assert list(rig.axes[-1].data) == AXES.ravel().tolist()


@pytest.mark.parametrize(
    ("info", "reason"),
    [
        (camera_info_message(camera(1703.0), header(2, CAMERA_LEFT)), "calibration has changed meanwhile"),
        (CameraInfo(width=640, height=480), "pictures of 640 x 480 px have no calibration"),
    ],
)
def test_a_camera_that_changes_ends_the_run(ros: Any, info: CameraInfo, reason: str) -> None:
    rig = Rig(ros)
    rig.cameras()
    rig.say_driver("idle")
    rig.look()
    rig.call("run")
    rig.watch(lambda: len(rig.goals) >= 3, 20.0)
    rig.infos[0].publish(info)
    rig.ros.spin_until(lambda: rig.state.startswith("failed"), 10.0, lambda: rig.state)
    assert rig.state == f"failed: the left camera's {reason}"


def test_calibration_of_other_machine_settings_is_refused(ros: Any, tmp_path: Path) -> None:
    path = tmp_path / "c.yaml"
    save(replace(stored(path), settings="$100=80 $101=80"), path)
    rig = Rig(ros, calibration_file=str(path), machine="bench")
    settings = rig.probe.create_publisher(String, "machine_settings", qos.LATCHED)
    settings.publish(String(data="$100=80 $101=80"))
    rig.cameras()
    ros.spin_until(lambda: rig.state.startswith("calibrated"), 10.0)
    settings.publish(String(data="$100=80 $101=160"))
    ros.spin_until(lambda: rig.state.startswith("failed"), 10.0)
    assert rig.state.endswith("the machine's settings have changed since this calibration: $101 was 80, now 160")


def test_drift_of_the_tip_is_told_and_ends(ros: Any, tmp_path: Path) -> None:
    path = tmp_path / "c.yaml"
    stored(path)
    rig = Rig(ros, calibration_file=str(path), machine="bench", **{"drift.times": 1})
    reports = ros.collect(rig.probe, DiagnosticArray, "/diagnostics")
    rig.cameras()
    ros.spin_until(lambda: rig.state.startswith("calibrated"), 10.0)
    rig.reading = np.array([0.1, 0.1, 0.0])
    rig.off = np.array([0.003, 0.0, 0.0])
    rig.watch(lambda: "drift: the tip is" in rig.state, 15.0)
    assert "calibrate again" in rig.state and rig.state.startswith("calibrated: ")
    rig.watch(lambda: any(r.status[0].level == b"\x01" for r in reports[-1:]), 10.0)
    values = {pair.key: pair.value for pair in reports[-1].status[0].values}
    assert 2.5 < float(values["tip_off_mm"]) < 3.5
    rig.off = np.zeros(3)
    rig.watch(lambda: "drift" not in rig.state, 15.0)


def test_contacts_are_kept_and_refused_with_the_reason(ros: Any) -> None:
    rig = Rig(ros)
    contact = rig.probe.create_publisher(PointStamped, "contact", qos.RESULTS)
    ros.spin_until(lambda: contact.get_subscription_count() == 1, 10.0)
    rig.reading = np.array([0.12, 0.08, 0.033])
    rig.watch(lambda: rig.node.calibrator.reading is not None and not rig.node.calibrator.watch.unrest(rig.now()), 10.0)
    contact.publish(point_message((0.1, 0.05, 0.0), header(1, BASE)))
    for count in range(6):
        contact.publish(point_message((0.1, 0.05, 0.001), header(1, "panel_link")))
        rig.watch(lambda c=count: len(rig.node.calibrator.contacts) == min(c + 1, 5), 10.0)
    kept = rig.node.calibrator.contacts[0]
    np.testing.assert_allclose(kept.in_panel, (0.1, 0.05, 0.003))
    np.testing.assert_allclose(kept.reading, rig.reading)


def test_a_contact_counts_only_where_the_machine_is_known_to_stand(ros: Any) -> None:
    rig = Rig(ros, **{"still.settle_s": 5.0})

    def change(name: str, seconds: float) -> None:  # from when on who is held up misses nothing by it
        assert rig.node.set_parameters([Parameter(name, value=seconds)])[0].successful

    touched = point_message((0.1, 0.05, 0.001), header(1, "panel_link"))
    rig.reading = np.array([0.12, 0.08, 0.033])
    rig.watch(lambda: rig.node.calibrator.reading is not None, 10.0)
    rig.reading = np.array([0.12, 0.08, 0.034])
    rig.node._on_joints(joint_message(JOINTS, rig.reading, header(rig.now(), BASE)))
    rig.node._on_contact(touched)
    assert rig.node.calibrator.contacts == [], "it moves"
    change("still.settle_s", 0.3)
    rig.watch(lambda: not rig.node.calibrator.watch.unrest(rig.now()), 10.0)
    rig.node._on_contact(touched)
    assert len(rig.node.calibrator.contacts) == 1
    change("still.fresh_s", 1.0)
    ros.spin_until(lambda: rig.node.calibrator.watch.unrest(rig.now()) == "no joint_states arrive", 10.0)
    rig.node._on_contact(touched)
    assert len(rig.node.calibrator.contacts) == 1, "where it stands is not known any more"


class RidingRig(Rig):
    """The same with the cameras on the carriage: the tip rests in the picture, and the panel moves."""

    def __init__(self, ros: Any, **parameters: Any) -> None:
        super().__init__(ros, **parameters)
        self.measured, self.awaited_ns = True, 0
        self.panels = self.probe.create_publisher(PoseStamped, "panel/pose", qos.LATCHED)
        self.points = self.probe.create_publisher(PointCloud2, "panel/points", qos.RESULTS)
        for publisher in (self.panels, self.points):
            ros.spin_until(lambda p=publisher: p.get_subscription_count() == 1, 10.0)

    def look(self) -> None:
        super().look()
        if self.awaited_ns > self.node.calibrator.sightings.newest_ns:
            return  # The last one is still on its way: a busy machine must not be flooded.
        moved = np.array([*(AXES @ self.reading[:2]), 0.0])
        pose = Transform(TURN, POSE.apply(PANEL_AT - moved) + self.rng.normal(0, 0.00002, 3))
        head = header(self.now(), CAMERA_LEFT)
        self.panels.publish(pose_message(pose, head))
        if self.measured:
            self.points.publish(cloud_message(FACE_POINT_COLUMNS, measured_face(pose).rows, head))
            self.awaited_ns = stamp_ns(head.stamp)

    def tip_base(self) -> Any:
        return np.array([0.0, 0.0, -self.reading[2]])


PANEL_AT = np.array([0.02, 0.025, -0.035])


def test_cameras_on_the_carriage_are_calibrated_by_the_same_service(ros: Any, tmp_path: Path) -> None:
    path = tmp_path / "c.yaml"
    rig = RidingRig(ros, calibration_file=str(path), **{"run.mounting": "carriage", "still.panels": 2})
    rig.cameras()
    rig.say_driver("idle")
    assert rig.call("run") == (True, "calibrating; watch the state")
    rig.watch(lambda: rig.state.startswith(("calibrated", "failed")), 60.0)
    assert "cameras on the carriage" in rig.state, rig.state
    ros.spin_until(lambda: rig.axes and rig.transforms, 10.0)
    np.testing.assert_allclose(np.array(rig.axes[-1].data).reshape(2, 2), AXES, atol=0.001)
    # camera_from_base follows the readings.
    for place in ((0.05, 0.05, 0.0), (0.25, 0.12, 0.0)):
        rig.reading = np.array(place)

        def follows() -> bool:
            here = transform_of_message(rig.transforms[-1]).inverse().apply(POSE.translation)
            return bool(np.linalg.norm(here[:2] - AXES @ rig.reading[:2]) < 0.0005)

        rig.watch(follows, 10.0)
    kept = load(path)
    assert kept.mounting == "carriage"
    assert kept.base_from_panel is not None
    np.testing.assert_allclose(kept.base_from_panel.translation, PANEL_AT, atol=0.0005)


def test_a_pose_counts_with_what_was_measured_for_it(ros: Any) -> None:
    rig = RidingRig(ros, **{"run.mounting": "carriage", "still.panels": 2})
    rig.cameras()
    rig.reading = np.array([0.1, 0.1, 0.0])
    rig.measured = False
    rig.watch(lambda: rig.node.calibrator.sightings.unpaired > 0, 15.0)
    seen, text = rig.call("add_sample")
    assert (seen, text) == (False, "the cameras saw the panel 0 of 2 times while the machine was at rest")
    rig.measured = True
    rig.watch(lambda: not isinstance(rig.node.calibrator.watch.panel_sample(rig.now()), str), 15.0)
    assert len(rig.node.calibrator.watch.panel_sample(rig.now()).points.pixels) == 160
