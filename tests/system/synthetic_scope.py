"""A small replacement for the rest of the graph, for tests of the page alone: images, pose, answers to commands.

Run as a program. It draws the panel from its layout, answers gestures as the controller does (accepted, then reached
with a measured error after a motion of 1.5 s). It obeys stop, reset, home and enable. Lines on standard input change
the world: ``confidence 0.2``, ``shift 0.01`` (the panel moves, m), ``heartbeat_timeout 9`` and ``motion 6`` (s),
``stall`` and ``resume`` (images), and ``deaf 1`` (no stop arrives). ``mute 1`` stops the panel's reports, ``unread 1``
hides the knobs' markers, and ``driver homing`` is the driver's message. Each is answered by ``heard`` on standard
output once it holds.
"""

from __future__ import annotations

import math
import sys
import threading
import time
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PointStamped, PoseStamped, TransformStamped
from rclpy.node import Node
from sensor_msgs.msg import CameraInfo, Image, JointState, PointCloud2
from std_msgs.msg import Empty, Float32, Header, String
from std_srvs.srv import SetBool, Trigger
from trajectory_msgs.msg import JointTrajectory
from visualization_msgs.msg import MarkerArray

from icu_common.core.geometry.camera_model import CameraModel
from icu_common.core.geometry.frames import BASE, CAMERA_LEFT, JOINTS, PANEL
from icu_common.core.geometry.geometry import Transform
from icu_common.core.goals.results import GoalResult, Outcome
from icu_common.core.panel.gesture import parse_gesture
from icu_common.core.panel.panel_layout import Control, PanelLayout, load_layout, rgb
from icu_common.core.panel.panel_state import ControlSeen, PanelSeen
from icu_common.core.reasons.message import Message
from icu_common.core.reasons.state_text import because
from icu_common.nodes import qos
from icu_common.nodes.diagnostics import Diagnostics
from icu_common.nodes.messages.cameras import camera_info_message, image_message
from icu_common.nodes.messages.clouds import cloud_message
from icu_common.nodes.messages.heads import header, stamp_ns
from icu_common.nodes.messages.joints import joint_message, trajectory_message
from icu_common.nodes.messages.panels import controls_message, panel_state_message
from icu_common.nodes.messages.places import point_message, pose_message, transform_message
from icu_common.nodes.messages.results import result_message, result_of_message
from icu_common.nodes.runtime import run
from icu_common.nodes.state_codes import code_values

LAYOUT = Path(__file__).resolve().parents[2] / "config" / "scopes" / "dso_bench_4.yaml"
PX_PER_MM = 4
ERROR_M = 0.00042
TIP_ABOVE_M = 0.03
CALIBRATED = because(
    "calibrated",
    Message(
        "calibration.samples_rms_predicted",
        samples=12,
        where="",
        rms_mm=0.08,
        held="",
        sigma_mm=0.05,
        made_at="2026-07-04T02:32:13+00:00",
    ),
)


def camera() -> CameraModel:
    k = np.array([[1700.0, 0, 639.5], [0, 1700.0, 359.5], [0, 0, 1]])
    p = np.hstack([k, np.zeros((3, 1))])
    return CameraModel(name="left", width=1280, height=720, k=k, d=np.zeros(5), r=np.eye(3), p=p)


def right_camera() -> CameraModel:
    left = camera()
    p = left.p.copy()
    p[0, 3] = -1700.0 * 0.12
    return CameraModel(name="right", width=1280, height=720, k=left.k, d=left.d, r=left.r, p=p)


def panel_pose(shift_m: float = 0.0) -> Transform:
    """Return camera_from_panel: 0.68 m away, seen from 20 degrees below."""
    tilt = math.radians(20)
    facing = np.diag([1.0, -1.0, -1.0])
    turn = np.array([[1, 0, 0], [0, math.cos(tilt), -math.sin(tilt)], [0, math.sin(tilt), math.cos(tilt)]])
    rotation = turn @ facing
    centre = np.array([0.16, 0.075, 0.0])
    return Transform(rotation, np.array([shift_m, 0.0, 0.68]) - rotation @ centre)


def draw_face(layout: PanelLayout, running: bool) -> np.ndarray:
    """Draw all but the screen's trace."""
    width, height = (round(v * PX_PER_MM) for v in layout.size_mm)
    face = np.full((height, width, 3), rgb(layout.colour)[::-1], np.uint8)
    for control in layout.controls:
        x, y = control.position_mm[0] * PX_PER_MM, height - control.position_mm[1] * PX_PER_MM
        w, h = (v * PX_PER_MM / 2 for v in control.size_mm)
        colour = rgb(control.lit_colour if control.name == "RUN_STOP" and running else control.colour)[::-1]
        if control.shape == "circle":
            cv2.circle(face, (round(x), round(y)), round(w), colour, -1, cv2.LINE_AA)
            cv2.circle(face, (round(x), round(y)), round(w), (30, 30, 30), 2, cv2.LINE_AA)
        else:
            corners = (round(x - w), round(y - h)), (round(x + w), round(y + h))
            cv2.rectangle(face, *corners, colour, -1)
            cv2.rectangle(face, *corners, (60, 60, 60), 2)
    return face


def trace(layout: PanelLayout, phase: float) -> np.ndarray:
    """Return the points of the screen's trace, (N, 2) px of the face."""
    screen = layout.control("SCREEN")
    x = np.linspace(-screen.size_mm[0] / 2 + 3, screen.size_mm[0] / 2 - 3, 300)
    y = 20 * np.sin(x / 9 + phase)
    points = np.column_stack([(x + screen.position_mm[0]), layout.size_mm[1] - screen.position_mm[1] - y]) * PX_PER_MM
    return points.astype(np.float32)


class SyntheticScope(Node):
    def __init__(self, **kwargs: Any) -> None:
        super().__init__("synthetic_scope", **kwargs)
        self.layout = load_layout(LAYOUT)
        self.faces = {running: draw_face(self.layout, running) for running in (False, True)}
        self.still: dict[tuple[str, bool, float], np.ndarray] = {}
        self.models = {"left": camera(), "right": right_camera()}
        self.running, self.phase, self.shift, self.confidence, self.stalled = True, 0.0, 0.0, 0.97, False
        self.position = [0.1, 0.05, 0.0]
        self.goal: tuple[str, str, int] | None = None
        self.enabled = True
        self.heartbeat_ns = 0
        self.rests_until_s = 0.0
        self.heartbeat_timeout = 0.6
        self.motion = 1.5
        self.deaf = self.mute = self.unread = 0.0
        self.reach_m = math.inf
        self.controller, self.driver = "ready", "idle"
        self.knobs = {c.name: c.marks[0][1] if c.marks else 10.0 for c in self.layout.controls if c.kind == "knob"}
        self.changed_ns = 0
        self.images = {s: self.create_publisher(Image, f"{s}/image_raw", qos.IMAGES) for s in self.models}
        self.infos = {s: self.create_publisher(CameraInfo, f"{s}/camera_info", qos.IMAGES) for s in self.models}
        self.poses = self.create_publisher(PoseStamped, "panel/pose", qos.LATCHED)
        self.controls = self.create_publisher(MarkerArray, "panel/controls", qos.LATCHED)
        self.confidences = self.create_publisher(Float32, "panel/confidence", qos.SENSOR)
        self.panels = self.create_publisher(DiagnosticArray, "panel/state", qos.RESULTS)
        self.edges = self.create_publisher(PointCloud2, "left/edge_lines", qos.RESULTS)
        self.bases = self.create_publisher(TransformStamped, "calibration/camera_from_base", qos.LATCHED)
        self.ways = self.create_publisher(JointTrajectory, "gantry/trajectory", qos.COMMAND)
        self.corners = self.create_publisher(PointCloud2, "left/corners", qos.RESULTS)
        self.tips = self.create_publisher(PointStamped, "stylus/tip", qos.SENSOR)
        self.targets = self.create_publisher(PointStamped, "gantry/target", qos.LATCHED)
        self.states = self.create_publisher(String, "gantry/state", qos.LATCHED)
        self.drivers = self.create_publisher(String, "gantry/driver_state", qos.LATCHED)
        self.calibrations = self.create_publisher(String, "calibration/state", qos.LATCHED)
        self.joints = self.create_publisher(JointState, "joint_states", qos.SENSOR)
        self.results = self.create_publisher(DiagnosticArray, "gantry/result", qos.RESULTS)
        self.create_subscription(String, "gantry/command", self.on_command, qos.COMMAND)
        self.create_subscription(PointStamped, "gantry/goal", self.on_goal, qos.COMMAND)
        self.create_subscription(Empty, "gantry/stop_request", lambda m: self.stop("operator"), qos.RESULTS)
        self.create_subscription(Header, "heartbeat", self.on_heartbeat, qos.SENSOR)
        for name, function in (("stop", self.on_stop), ("reset", self.on_reset), ("home", self.on_home)):
            self.create_service(Trigger, f"gantry/{name}", function)
        self.create_service(SetBool, "gantry/enable", self.on_enable)
        self.create_timer(1 / 15, self.on_picture)
        self.create_timer(0.05, self.on_tick)
        self.controls.publish(controls_message(self.layout, header(0, PANEL)))
        self.calibrations.publish(String(data=CALIBRATED))
        self.diagnostics = Diagnostics(self)
        self.create_timer(1.0, self.report)
        self.say()
        threading.Thread(target=self.listen, daemon=True).start()

    def now(self) -> int:
        return int(self.get_clock().now().nanoseconds)

    def listen(self) -> None:
        for line in sys.stdin:
            word, *rest = line.split()
            if word in ("stall", "resume"):
                self.stalled = word == "stall"
            elif word == "driver":
                self.driver = rest[0]
                self.say()
            else:
                setattr(self, word, float(rest[0]))
            print("heard", flush=True)

    def report(self) -> None:
        """Report the codes and values of the calibration's state, as the calibration's program does."""
        self.diagnostics.tell("ok", CALIBRATED, code_values(self.calibrations.topic_name, {}))

    def say(self) -> None:
        self.states.publish(String(data=self.controller))
        self.drivers.publish(String(data=self.driver))

    def on_heartbeat(self, message: Header) -> None:
        self.heartbeat_ns = stamp_ns(message.stamp)

    def on_picture(self) -> None:
        self.phase += 0.2
        stamp = self.now()
        pose = panel_pose(self.shift)
        if not self.mute:
            self.confidences.publish(Float32(data=self.confidence))
        self.poses.publish(pose_message(pose, header(stamp, CAMERA_LEFT)))
        rest = panel_pose()  # the machine is at rest when the panel moves
        base = Transform(rest.rotation, rest.apply(np.array([0.0, 0.0, TIP_ABOVE_M])))
        self.bases.publish(transform_message(base, header(stamp, CAMERA_LEFT), BASE))
        self.joints.publish(joint_message(JOINTS, self.position, header(stamp, "")))
        tip = rest.apply(np.array([self.position[0], self.position[1], TIP_ABOVE_M - self.position[2]]))
        self.tips.publish(point_message(tip, header(stamp, CAMERA_LEFT)))
        self.panels.publish(panel_state_message(self.seen(stamp), header(stamp, CAMERA_LEFT)))
        begin_s = time.monotonic()
        if self.stalled or begin_s < self.rests_until_s:
            return
        face = self.faces[self.running]
        line = trace(self.layout, self.phase if self.running else 0.0)
        size_m = np.array(self.layout.size_mm) * 1e-3
        corners = np.array([[0, 0, 0], [size_m[0], 0, 0], [*size_m, 0], [0, size_m[1], 0]])
        height, width = face.shape[:2]
        source = np.array([[0, height], [width, height], [width, 0], [0, 0]], np.float32)
        for side, model in self.models.items():
            points = pose.apply(corners) - (np.array([0.12, 0, 0]) if side == "right" else 0)
            warp = cv2.getPerspectiveTransform(source, model.project(points).astype(np.float32))
            seen = side, self.running, self.shift
            if seen not in self.still:
                self.still[seen] = cv2.warpPerspective(face, warp, (1280, 720), borderValue=(52, 48, 44))
            picture = self.still[seen].copy()
            shown = cv2.perspectiveTransform(line[None], warp).round().astype(np.int32)
            cv2.polylines(picture, shown, False, (60, 220, 250), 2, cv2.LINE_AA)
            picture[-16:, -16:] = round(20 * self.phase) % 256  # no two pictures are alike, whatever the scope shows
            if side == "left":
                u, v = model.project(tip)[0]
                cv2.circle(picture, (round(u), round(v)), 6, (255, 0, 255), -1, cv2.LINE_AA)
                if self.corners.get_subscription_count():
                    gray = cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY)
                    found = cv2.goodFeaturesToTrack(gray, 300, 0.02, 6).reshape(-1, 2)
                    rows = np.column_stack([found, np.ones(len(found))])
                    self.corners.publish(cloud_message(("u", "v", "response"), rows, header(stamp, CAMERA_LEFT)))
                lines = [[*corner, 0] for corner in model.project(points).tolist()] + [[640, 100, 1], [640, 600, 1]]
                self.edges.publish(cloud_message(("u", "v", "line"), lines, header(stamp, CAMERA_LEFT)))
            self.images[side].publish(image_message(picture, "bgr8", header(stamp, CAMERA_LEFT)))
            self.infos[side].publish(camera_info_message(model, header(stamp, CAMERA_LEFT)))
        # On a loaded machine the pictures become fewer: what is asked meanwhile must not wait for ever longer.
        end_s = time.monotonic()
        self.rests_until_s = end_s + min(end_s - begin_s, 0.5)

    def seen(self, stamp: int) -> PanelSeen:
        """Return what recognition would read: RUN/STOP's lamp, the knobs' markers, when the screen changed."""

        def one(control: Control) -> ControlSeen:
            lamp = ("green" if self.running else "off") if control.name == "RUN_STOP" else ""
            angle = math.nan if self.unread else self.knobs.get(control.name, math.nan)
            changed = self.changed_ns if control.kind == "touch_area" else 0
            more = {"detent_deg": control.detent_deg, "marks": control.marks, "changed_ns": changed}
            return ControlSeen(name=control.name, kind=control.kind, lamp=lamp, angle_deg=angle, **more)

        return PanelSeen(stamp_ns=stamp, controls=tuple(one(control) for control in self.layout.controls))

    def has_effect(self, text: str) -> None:
        """Do to the instrument what a gesture does."""
        gesture = parse_gesture(text) if not text.startswith("(") else None
        if gesture is None or not isinstance(gesture.target, str):
            self.changed_ns = self.now()
        elif gesture.target in self.knobs:
            knob = self.layout.control(gesture.target)
            way = -gesture.argument * knob.detent_deg if gesture.kind == "click" else gesture.argument
            place = dict(knob.marks).get(gesture.mark, gesture.argument)
            angle = place if gesture.kind == "set" else self.knobs[knob.name] + way
            self.knobs[knob.name] = math.remainder(angle, 360.0)
        elif gesture.target == "RUN_STOP":
            self.running = not self.running

    def on_tick(self) -> None:
        if self.goal is None:
            return
        goal_id, text, started = self.goal
        if self.now() - self.heartbeat_ns > self.heartbeat_timeout * 1e9:
            self.stop("heartbeat lost")
        elif self.now() - started > self.motion * 1e9:
            self.goal = None
            self.controller, self.driver = "ready", "idle"
            self.has_effect(text)
            self.answer(goal_id, text, Outcome.REACHED, error_m=ERROR_M, duration_s=self.motion)
            self.say()

    def answer(self, goal_id: str, text: str, outcome: Outcome, **more: Any) -> None:
        result = GoalResult(goal_id=goal_id, goal=text, outcome=outcome, **more)
        message = result_message(result, self.now())
        assert result_of_message(message).goal_id == goal_id
        self.results.publish(message)

    def start(self, goal_id: str, text: str, xy: np.ndarray) -> None:
        if self.controller != "ready":
            self.answer(goal_id, text, Outcome.REJECTED, reason=f"the controller is {self.controller}")
            return
        if xy[0] > self.reach_m:
            self.answer(goal_id, text, Outcome.REJECTED, reason=f"x is beyond {self.reach_m} m")
            return
        self.goal = (goal_id, text, self.now())
        way = [[*self.position[:2], 0.0], [float(xy[0]), float(xy[1]), 0.0], [float(xy[0]), float(xy[1]), TIP_ABOVE_M]]
        self.ways.publish(trajectory_message(JOINTS, way, [0.1, 1.0, 1.5], header(self.now(), "")))
        self.position = [float(xy[0]), float(xy[1]), 0.0]
        self.controller, self.driver = "moving", "moving"
        target = panel_pose(self.shift).apply(np.array([*xy, 0.0]))
        self.targets.publish(point_message(target, header(self.now(), CAMERA_LEFT)))
        self.answer(goal_id, text, Outcome.ACCEPTED)
        self.say()

    def on_command(self, message: String) -> None:
        gesture = parse_gesture(message.data)
        target = gesture.target
        if isinstance(target, str):
            place = np.array(self.layout.control(target).position_mm) * 1e-3
        else:
            place = np.array([target.x, target.y] if target.frame == PANEL else [0.1, 0.1])
        self.start(gesture.id or message.data, message.data, place)

    def on_goal(self, message: PointStamped) -> None:
        text = f"({message.point.x:.1f}, {message.point.y:.1f})@{message.header.frame_id}"
        # Base and panel are one here; only metres of the base are a place, a point of the picture is pressed anywhere.
        metres = message.header.frame_id == BASE
        place = np.array([message.point.x, message.point.y]) if metres else np.array([0.1, 0.1])
        self.start(str(stamp_ns(message.header.stamp)), text, place)

    def stop(self, why: str) -> None:
        if self.deaf:
            return
        if self.goal is not None:
            self.answer(self.goal[0], self.goal[1], Outcome.ABORTED, reason=f"stopped: {why}")
            self.goal = None
        self.controller = self.driver = f"stopped: {why}"
        self.say()

    def on_stop(self, request: Any, response: Any) -> Any:
        self.stop("operator")
        response.success, response.message = True, "stopped"
        return response

    def on_reset(self, request: Any, response: Any) -> Any:
        self.controller, self.driver = "ready", "idle"
        self.say()
        response.success, response.message = True, "reset"
        return response

    def on_home(self, request: Any, response: Any) -> Any:
        self.position = [0.0, 0.0, 0.0]
        response.success, response.message = True, "homing"
        return response

    def on_enable(self, request: Any, response: Any) -> Any:
        self.enabled = bool(request.data)
        response.success, response.message = True, "enabled" if self.enabled else "disabled"
        return response


if __name__ == "__main__":
    raise SystemExit(run(SyntheticScope))
