"""Makes the golden bag: the simulated bench by a virtual clock, seen through JPEG, as the graph would have recorded it.

A calibration (eight samples of the stylus) and three presses. Images are only taken while a program requests them, and
keep their restart markers. Noise is left out: two images share the same bytes, which the bag's compression finds.
Everything that the virtual robot decides follows from the pictures as they are in the bag.
"""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PointStamped
from golden.expectation import BAG, bag_check
from rclpy.serialization import serialize_message
from sensor_msgs.msg import CameraInfo, CompressedImage, JointState
from std_msgs.msg import Header, String
from support.parameter_files import parameters
from support.virtual_robot import VirtualRobot
from trajectory_msgs.msg import JointTrajectory

from gantry_driver.core.job import controller_messages as msg
from gantry_driver.core.job.controller_config import ControllerConfig
from gantry_driver.core.job.goal_job import LOOKING
from harris_perception.core.hand_eye.hand_eye import calibrate
from harris_perception.core.hand_eye.hand_eye_config import HandEyeConfig
from harris_perception.core.hand_eye.tip_samples import Sample
from harris_perception.core.hand_eye_procedure.still_watch import StillConfig, StillWatch
from harris_perception.core.stylus.stylus import StylusTracker
from harris_perception.core.stylus.stylus_config import StylusSearchConfig
from harris_perception.pairing.free_pairs import ImagePair
from icu_bringup.adapters.bag.bag_reader import BagReader
from icu_bringup.adapters.bag.bag_writer import BagWriter
from icu_bringup.adapters.bag.bags import BagTopic
from icu_bringup.nodes.bag_qos import recorded_qos
from icu_common.core.configuration.config import from_mapping
from icu_common.core.geometry.frames import BASE, CAMERA_LEFT, CAMERA_RIGHT, JOINTS
from icu_common.core.goals.results import Outcome
from icu_common.nodes import qos
from icu_common.nodes.messages.cameras import camera_info_message
from icu_common.nodes.messages.heads import header
from icu_common.nodes.messages.joints import joint_message, trajectory_message
from icu_common.nodes.messages.places import point_message
from icu_common.nodes.messages.results import result_message
from icu_simulator.imaging.timing import Shot

SEED = 7
TIPS = 3
"""Sightings for each sample of the calibration; the replay gets the same number."""
TRACKER = {"max_fit_error": 0.15, "row_tolerance_px": 1.0, "pair.period_s": 0.0}
"""JPEG's blocks blur the ball. Images for recognition have no partner, so the cameras are not compared. The replay uses
the same settings."""
CONTROLLER = {"tolerance_m": 0.0003}
"""So that no error lies near the bound of a correction, which another computer could then decide otherwise."""
CORNERS_M = ((0.06, 0.05), (0.06, 0.17), (0.30, 0.17), (0.30, 0.05))
LOWER_M = -0.012
PRESSES = ("RUN_STOP", "CURSORS", "SINGLE")
SIDES = (("left", CAMERA_LEFT), ("right", CAMERA_RIGHT))
TOPICS = {
    **{f"/stereo/{side}/image_raw/compressed": (CompressedImage, qos.IMAGES) for side, _ in SIDES},
    **{f"/stereo/{side}/camera_info": (CameraInfo, qos.IMAGES) for side, _ in SIDES},
    "/joint_states": (JointState, qos.RESULTS),
    "/gantry/driver_state": (String, qos.LATCHED),
    "/gantry/machine_settings": (String, qos.LATCHED),
    "/gantry/goal": (PointStamped, qos.COMMAND),
    "/gantry/command": (String, qos.COMMAND),
    "/gantry/trajectory": (JointTrajectory, qos.COMMAND),
    "/gantry/trajectory_result": (DiagnosticArray, qos.RESULTS),
    "/operator/heartbeat": (Header, qos.RESULTS),
    "/bag/cue": (String, qos.RESULTS),
}
INFO_S, UNSEEN_S, JOINTS_S = 0.4, 0.6, 0.09


def jpeg_options() -> list[int]:
    """Say how pictures are packed; OpenCV 4.6 cannot, it only replays the bag."""
    return [
        *(cv2.IMWRITE_JPEG_QUALITY, 93),
        *(cv2.IMWRITE_JPEG_SAMPLING_FACTOR, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444),
        *(cv2.IMWRITE_JPEG_RST_INTERVAL, 10),
    ]


class RecordedRobot(VirtualRobot):
    """A virtual robot whose messages go into a bag from :meth:`record` on."""

    def __init__(self, writer: BagWriter) -> None:
        self._writer: BagWriter | None = None
        self._waiting_writer = writer
        self._stamp, self._both = 0, False
        self._info_s = self._drawn_s = self._joints_s = -1.0
        self.sampling = False
        self._still = StillWatch(from_mapping(StillConfig, {**parameters("hand_eye", "still"), "tips": TIPS}))
        super().__init__(SEED, bench={"light.noise": 0.0})
        tracker = from_mapping(StylusSearchConfig, {**parameters("stylus_tracker"), **TRACKER})
        self.tracker = StylusTracker(tracker, self.stereo)
        self.controller.config = from_mapping(ControllerConfig, {**parameters("gantry_controller"), **CONTROLLER})
        handle = self.controller.handle

        def recorded(event: msg.Event, now_ns: int) -> list[msg.Action]:
            actions = handle(event, now_ns)
            for action in actions:
                if isinstance(action, msg.SendTrajectory):
                    path = action.path
                    head = header(action.stamp_ns, "")
                    self._write("/gantry/trajectory", trajectory_message(JOINTS, path.points, path.times_s, head))
            return actions

        self.controller.handle = recorded  # type: ignore[method-assign]

    def record(self) -> None:
        """Begin with the messages that a latched topic would send to a late subscriber."""
        self._writer = self._waiting_writer
        for name, (kind, profile) in TOPICS.items():
            module, kind_name = kind.__module__.split(".")[0], kind.__name__
            self._writer.add_topic(BagTopic(name=name, type=f"{module}/msg/{kind_name}", qos=(recorded_qos(profile),)))
        self._write("/gantry/machine_settings", String(data=self.driver.settings_text()))
        self._write("/gantry/driver_state", String(data=self.driver.state_text))
        self._tell(msg.OperatorHeartbeat())

    def _write(self, topic: str, message: Any) -> None:
        if self._writer is not None:
            self._writer.write(topic, self.now_ns, bytes(serialize_message(message)))

    # What a user does

    def go(self, x: float, y: float, z: float) -> None:
        count = len(self.results)
        self._tell(msg.PointGoal(frame=BASE, xyz=np.array([x, y, z]), stamp_ns=self.now_ns))
        result = self.answer(count)
        assert result.outcome is Outcome.REACHED, result

    def sample(self) -> Sample:
        """Wait for a sample of the still stylus, and give the cue for it."""
        self.run_for(0.35)
        self.sampling = True
        self.until(lambda: isinstance(self._still.sample(self.now_ns), Sample), 3.0)
        self.sampling = False
        found = self._still.sample(self.now_ns)
        assert isinstance(found, Sample)
        self._write("/bag/cue", String(data="/calibration/add_sample"))
        return found

    def calibrate(self) -> None:
        samples = []
        for x, y in CORNERS_M:
            self.go(x - 0.003, y - 0.003, 0.0)
            for z in (0.0, LOWER_M):
                self.go(x, y, z)
                samples.append(self.sample())
            self.go(x, y, 0.0)
        self._write("/bag/cue", String(data="/calibration/solve"))
        solver = from_mapping(HandEyeConfig, parameters("hand_eye", "solver"))
        solved = calibrate(samples, self.stereo, solver)
        aims = np.array([(x, y, 0.0) for x, y in CORNERS_M])
        self._tell(msg.CalibrationSigma(value_m=solved.sigma_m(aims)))
        self._tell(msg.CameraFromBase(transform=solved.camera_from_base))
        self._tell(msg.Axes(base_from_reading=solved.base_from_reading))

    # What is recorded

    def _tell(self, event: msg.Event) -> None:
        match event:
            case msg.DriverState():
                self._write("/gantry/driver_state", String(data=event.text))
            case msg.Joints() if self.now - self._joints_s < JOINTS_S:
                return
            case msg.Joints():
                self._joints_s = self.now
                self._still.reading(self.now_ns, event.readings)
                self._write("/joint_states", joint_message(JOINTS, event.readings, header(self.now_ns, "")))
            case msg.MotionResult():
                self._write("/gantry/trajectory_result", result_message(event.result, self.now_ns))
            case msg.PointGoal():
                self._write("/gantry/goal", point_message(event.xyz, header(event.stamp_ns, event.frame)))
            case msg.Command():
                self._write("/gantry/command", String(data=event.text))
            case msg.OperatorHeartbeat():
                self._write("/operator/heartbeat", header(self.now_ns, "operator"))
            case msg.CameraSeen() if self.now - self._info_s > INFO_S:
                self._info_s = self.now
                for camera, (side, frame) in zip(self.cameras, SIDES):
                    info = camera_info_message(camera, header(event.stamp_ns, frame))
                    self._write(f"/stereo/{side}/camera_info", info)
            case msg.CameraSeen():
                return  # between two that are recorded nothing is known
        super()._tell(event)

    def _pictures(self, due: Sequence[Shot]) -> dict[int, Any]:
        self._drawn_s = self.now
        drawn, seen = super()._pictures(due), {}
        for camera, (side, frame) in enumerate(SIDES[: None if self._both else 1]):
            done, packed = cv2.imencode(".jpg", drawn[camera], jpeg_options())
            assert done
            text = "bgr8; jpeg compressed bgr8"
            message = CompressedImage(header=header(self._stamp, frame), format=text, data=packed.tobytes())
            self._write(f"/stereo/{side}/image_raw/compressed", message)
            seen[camera] = cv2.imdecode(packed, cv2.IMREAD_COLOR)
        if self._both:
            self._find_tip(seen[0], seen[1])
        return seen

    def _find_tip(self, left: Any, right: Any) -> None:
        tip = self.tracker.find(left, right).tip
        if tip is not None:
            self._still.tip(self._stamp, tip)
            self._tell(msg.TipSeen(in_camera=tip, stamp_ns=self._stamp))
        else:
            self._tell(msg.TipUnseen(stamp_ns=self._stamp))

    def _see(self, pair: ImagePair) -> None:
        self._newest.append(pair)
        if self.sampling or self.controller.phase in LOOKING:
            self._both = True
            self._track(pair)
            self._both = False

    def _track(self, pair: ImagePair) -> None:
        """Draw the pair for the tracker, or its left image alone for recognition, which has no tip then."""
        self._stamp = self._tracked_ns = pair.left_ns
        images = self._pictures((pair.left, pair.right)[: 2 if self._both else 1])
        self._seen = images[0], images.get(1)

    def _watch_pair(self, gray: Any, right: Any, pose: Any, stamp: int) -> None:
        return

    def _every_panel(self) -> None:
        self.watch_panel = self.now - self._drawn_s > UNSEEN_S and bool(self.controller.goal)
        super()._every_panel()


def make(path: Path) -> None:
    """Write the bag."""
    with BagWriter(path, "mcap", zstd=True) as writer:
        robot = RecordedRobot(writer)
        robot.until(lambda: robot.driver.state == "unhomed", 20.0)
        assert not robot.driver.home(robot.now)
        robot.until(lambda: robot.driver.state == "idle", 60.0)
        robot.record()
        robot.run_for(0.5)
        robot.look_at_panel(4)
        robot.calibrate()
        robot.go(0.01, 0.01, 0.0)
        for number, control in enumerate(PRESSES):
            # Long enough for a press that sees no effect to end in the replay, too.
            robot.look_at_panel(5)
            result = robot.command(f"press:{control} id=press-{number}")
            print(result, flush=True)
            assert result.outcome is Outcome.REACHED, result
        robot.look_at_panel(5)


def main() -> int:
    """Make a new bag and new recorded results."""
    shutil.rmtree(BAG, ignore_errors=True)
    make(BAG)
    with BagReader(BAG) as bag:
        size = sum(p.stat().st_size for p in BAG.iterdir())
        counts = ", ".join(f"{t.name} {t.count}" for t in bag.topics)
        print(f"{size / 1e6:.2f} MB, {bag.duration_ns / 1e9:.1f} s: {counts}")
    assert size < 4_000_000, size
    # Nodes, settings and tolerances are kept; they are edited in the file.
    with tempfile.TemporaryDirectory(prefix="golden_") as folder:
        done = bag_check("--make", "--out", folder)
    print(f"{done.stdout}{done.stderr}")
    assert done.returncode == 0
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
