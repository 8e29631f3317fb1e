"""ROS node of the operator page: passes topics to the desk and the desk's decisions to the graph.

The executor runs in the main thread, the web server in its own. Callbacks convert a message and pass it on; none of
them waits. The server's thread publishes directly: rclpy's publishers and clients may be used from any thread, and a
stop must not wait for the executor.

On SIGUSR1 it makes a new sign-in token (the old one becomes void), prints it and writes it to the token file.
"""

from __future__ import annotations

import contextlib
import secrets
import signal
import socket
import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PointStamped, PoseStamped, TransformStamped
from rcl_interfaces.msg import Log, ParameterEvent
from rclpy.parameter import parameter_value_to_python
from sensor_msgs.msg import CameraInfo, Image, JointState, PointCloud2
from std_msgs.msg import Empty, Float32, Float64MultiArray, Header, String
from std_srvs.srv import SetBool, Trigger
from trajectory_msgs.msg import JointTrajectory
from visualization_msgs.msg import MarkerArray

from icu_common.adapters.direct_stop.line import send_stop, stop_path
from icu_common.adapters.processes.hanging_programs import hanging_file, read_hanging
from icu_common.adapters.processes.process_identity import is_alive, process_number
from icu_common.adapters.processes.processor_load import LoadMeter
from icu_common.adapters.real_time import BRIDGE, ask_for_real_time
from icu_common.core.configuration.config import ConfigError
from icu_common.core.configuration.text_bounds import plain
from icu_common.core.geometry.frames import CAMERA_LEFT, JOINTS
from icu_common.core.geometry.geometry import Transform
from icu_common.core.goals.sequence import Sequence, parse_file
from icu_common.core.panel.panel_layout import Control, LayoutError, PanelLayout, load_layout
from icu_common.nodes import qos
from icu_common.nodes.camera_info import CameraInfoSubscription
from icu_common.nodes.graph_node import GraphNode, this_process
from icu_common.nodes.images import ReceivedImage
from icu_common.nodes.messages.cameras import camera_model, image_array, image_message
from icu_common.nodes.messages.clouds import cloud_array
from icu_common.nodes.messages.heads import MAX_NAME, check_frame, header, stamp_ns
from icu_common.nodes.messages.joints import joint_positions, trajectory_array
from icu_common.nodes.messages.panels import controls_of_message, panel_state_of_message
from icu_common.nodes.messages.places import (
    axes_of_message,
    point_array,
    point_message,
    transform_of_message,
    transform_of_pose,
)
from icu_common.nodes.messages.results import pairs_of, result_of_message
from icu_common.nodes.newest import NewestImage
from icu_common.nodes.parameters import LiveParameters
from icu_common.nodes.runtime import run
from icu_common.nodes.timers import every, runs_by_clock_topic, seconds_of
from scope_ui_bridge.adapters.graph_port import GraphError
from scope_ui_bridge.adapters.secret_files import AuditFile, write_secret
from scope_ui_bridge.adapters.web_server import WebServer
from scope_ui_bridge.core.access import Role, SignIn
from scope_ui_bridge.core.config import BridgeConfig
from scope_ui_bridge.core.desk import Desk
from scope_ui_bridge.core.records import AuditError
from scope_ui_bridge.core.status import Condition, LivenessMonitor, Sender, judge, stored_name
from scope_ui_bridge.core.video import CORNERS, EDGES, Face, labels_of

_SERVICES = {
    "home": "gantry/home",
    "reset": "gantry/reset",
    "enable": "gantry/enable",
    "disable": "gantry/enable",
    "calibrate": "calibration/run",
    "accept_settings": "gantry/accept_settings",
    "add_sample": "calibration/add_sample",
    "solve": "calibration/solve",
    "save": "calibration/save",
}

_STATES = {
    "controller": "gantry/state",
    "driver": "gantry/driver_state",
    "calibration": "calibration/state",
    "sequencer": "gantry/sequence_state",
}
_REPORTERS = {"hand_eye": "calibration", "serial_driver": "driver", "calibration_capture": "cameras"}
_LAYER_TOPICS = {
    (CORNERS, "left"): "left/corners",
    (CORNERS, "right"): "right/corners",
    (EDGES, "left"): "left/edge_lines",
    (EDGES, "right"): "right/edge_lines",
}
_LAYER_COLUMNS = {CORNERS: ("u", "v"), EDGES: ("u", "v", "line")}
_SHOWN_PERIOD_S = 0.2
_MAX_PATH = 200
_MAX_VALUE = 200
"""Maximum number of characters shown of a changed parameter's name and value."""
SILENT_S = 5.0
"""Seconds without a report from which on a node counts as late; nodes report every second."""
_RECORDERS = ("bag_recorder", "rosbag2_recorder")
"""Prefixes of recorders' node names: of bag_record, and of `ros2 bag record`."""
_LEVELS = {20: "info", 30: "warn", 40: "error", 50: "fatal"}


class BridgeNode(GraphNode):
    """Serves the operator page; also the :class:`GraphPort` of its web server."""

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("ui_bridge", **kwargs)
        parameters = LiveParameters(self, BridgeConfig, self._on_config, unrest=lambda: self._desk.machine.unrest())
        config = parameters.config
        self._layout = _read_layout(config)
        self._replay = config.replay
        self._axes = np.eye(2)
        self._withdrawn = False
        self._camera_from_base: Transform | None = None
        self._layers: dict[tuple[str, str], Any] = {}
        self._pictures: dict[str, NewestImage] = {}
        self._liveness = LivenessMonitor(SILENT_S)
        self._hanging_file = hanging_file()
        self._load = LoadMeter()
        robot = f"{socket.gethostname()}{self.get_namespace()}"
        self._seconds, self._simulated = seconds_of(self), runs_by_clock_topic(self)
        self._desk = Desk(config, secrets.token_hex(8), self._layout.title if self._layout else "", robot)
        self._scene = self._desk.scene
        self._desk.sequence.stored = self._read_sequences(config)
        self._token_file = Path(config.token_file).expanduser() if config.token_file else None
        self._make_outlets()
        sign_in = SignIn(lambda: secrets.token_urlsafe(32), config.session_lifetime_s, Role(config.token_role))
        self._server = WebServer(config, self._desk, sign_in, self, _open_audit(config))
        self._mail = self._server.mailbox
        self._make_inlets()
        try:
            self._server.start()
        except ConfigError:
            self._server.close()
            raise
        self._server.post(self._desk.begun)
        every(self, 1.0, self._check_server, wall=True)
        every(self, 0.5, self._check_liveness)
        self._simulated_ns, self._simulated_since_s, self._stood_still = 0, time.monotonic(), False
        if this_process.simulated:
            every(self, 0.5, self._check_simulated_time, wall=True)
        every(self, 1.0, self._check_states, wall=True)
        every(self, 1.0, self._look_for_recorders, wall=True)
        self.issue_token()

    @property
    def url(self) -> str:
        """The page's address, without a token."""
        return self._desk.config.url(self._server.port)

    def issue_token(self) -> None:
        """Make a new sign-in token, print the page's address with it, and write it to the token file."""
        self._server.new_token(self._announce)

    def close(self) -> None:
        """End the server; without its heartbeat the driver stops."""
        self._server.close()
        self._load.finish()
        if self._token_file is not None:
            with contextlib.suppress(OSError):  # for example if it could not be written
                self._token_file.unlink()

    def _announce(self, token: str) -> None:
        print(f"Operator page: {self.url}?token={token}", flush=True)
        if self._token_file is None:
            return
        try:
            write_secret(self._token_file, token)
        except OSError as error:
            self.get_logger().error(f"the sign-in token could not be written to {self._token_file}: {error}")

    def _check_server(self) -> None:
        if not self._server.alive:
            raise RuntimeError("the web server has ended; the bridge ends too, so that bring-up sees it")

    def _on_config(self, config: BridgeConfig) -> None:
        self._mail.each(self._use_config, config)

    def _use_config(self, config: BridgeConfig) -> None:
        self._desk.config = config

    # --- from the graph --------------------------------------------------------------------------------------------

    def _make_inlets(self) -> None:
        self._hear_camera("left")
        self._hear_camera("right")
        self._hear(PoseStamped, "panel/pose", qos.LATCHED, self._pose_seen)
        self._hear(MarkerArray, "panel/controls", qos.LATCHED, self._controls_seen)
        self._hear(DiagnosticArray, "panel/state", qos.SENSOR, self._panel_seen)
        self._hear(Float32, "panel/confidence", qos.SENSOR, self._confidence_seen)
        self._hear(PointStamped, "stylus/tip", qos.SENSOR, self._tip_seen)
        self._hear(PointStamped, "gantry/target", qos.LATCHED, self._target_seen)
        way = "gantry/recorded_trajectory" if self._replay else "gantry/trajectory"  # name in bag_play
        self._hear(JointTrajectory, way, qos.COMMAND, self._trajectory_seen)
        for part, topic in _STATES.items():
            self._hear(String, topic, qos.LATCHED, self._state_taker(part))
        self._hear(TransformStamped, "calibration/camera_from_base", qos.LATCHED, self._calibration_seen)
        self._hear(Float64MultiArray, "calibration/axes", qos.LATCHED, self._axes_seen)
        self._hear(JointState, "joint_states", qos.SENSOR, self._joints_seen)
        self._hear(Float32, "simulation_factor", qos.LATCHED, self._factor_seen)
        self._hear(DiagnosticArray, "/diagnostics", qos.RESULTS, self._facts_seen)
        self._hear(Log, "/rosout", qos.RESULTS, self._said)
        self._hear(ParameterEvent, "/parameter_events", qos.RESULTS, self._parameters_changed)
        self._hear(DiagnosticArray, "gantry/result", qos.RESULTS, self._result_seen)
        self._hear(DiagnosticArray, "panel/teach/result", qos.RESULTS, self._taught)
        self._hear(DiagnosticArray, "gantry/sequence_result", qos.RESULTS, self._sequence_result_seen)

        self._hear_what_is_shown()
        every(self, _SHOWN_PERIOD_S, self._hear_what_is_shown, wall=True)

    def _hear_what_is_shown(self) -> None:
        """Subscribe to images, corners and edges only while a page shows them.

        The left camera is needed while any page is connected: the bridge stops a page's motion that has no images, and
        a panel is taught in its image.
        """
        video = self._server.video
        for key in video.wanted - self._layers.keys():
            self._layers[key] = self._hear(PointCloud2, _LAYER_TOPICS[key], qos.SENSOR, self._layer_taker(*key))
        for key in self._layers.keys() - video.wanted:
            self.destroy_subscription(self._layers.pop(key))
        cameras = video.cameras | ({"left"} if self._desk.has_viewers else set())
        for side in cameras - self._pictures.keys():
            self._pictures[side] = NewestImage(self, f"{side}/image_raw", self._picture_taker(side))
        for side in self._pictures.keys() - cameras:
            self._pictures.pop(side).end()
            self._mail.newest(side, video.forget, side)

    def _layer_taker(self, layer: str, camera: str) -> Callable[[PointCloud2], None]:
        take, columns = self._scene.layers.take, _LAYER_COLUMNS[layer]
        return lambda message: self._mail.newest(
            f"{layer} {camera}", take, layer, camera, self._stamp(message), cloud_array(message, columns)
        )

    def _hear(self, message_type: Any, topic: str, profile: Any, take: Callable[[Any], None]) -> Any:
        def callback(message: Any) -> None:
            try:
                take(message)
            except ValueError as error:
                self.get_logger().error(f"{topic}: ignored: {plain(str(error))}", throttle_duration_sec=5.0)

        return self.create_subscription(message_type, topic, callback, profile)

    def _picture_taker(self, side: str) -> Callable[[ReceivedImage], None]:
        def take(message: ReceivedImage) -> None:
            try:
                picture = image_array(message)
            except ValueError as error:
                self.get_logger().error(f"{side} picture ignored: {error}", throttle_duration_sec=5.0)
                return
            stamp = self._stamp(message)
            self._mail.newest(side, self._server.video.offer, side, stamp, message.encoding, picture)
            self._mail.newest("picture", self._server.post_value, self._desk.machine.picture_came)

        return take

    def _stamp(self, message: Any) -> int:
        # In a replay, recorded stamps are as old as the session, so the time of arrival counts.
        return self.ros_ns() if self._replay else stamp_ns(message.header.stamp)

    def _state_taker(self, part: str) -> Callable[[String], None]:
        return lambda message: self._mail.newest(part, self._desk.set_state, part, plain(message.data))

    def _hear_camera(self, side: str) -> None:
        def changed(message: CameraInfo) -> None:
            try:
                self._camera_seen(side, message)
            except ValueError as error:
                self.get_logger().error(f"{side}/camera_info: ignored: {error}", throttle_duration_sec=5.0)
                cameras.again()

        cameras = CameraInfoSubscription(self, f"{side}/camera_info", qos.SENSOR, changed)

    def _camera_seen(self, side: str, message: CameraInfo) -> None:
        model = camera_model(message, side) if message.k[0] else None  # CameraInfo.msg: 0 is "uncalibrated"
        if model is None:
            self.get_logger().info(f"the {side} camera is not calibrated: no control is drawn in its picture")
        self._mail.each(self._set_scene, {side: model})

    def _pose_seen(self, message: PoseStamped) -> None:
        check_frame(message.header, CAMERA_LEFT)
        self._mail.newest("pose", self._scene.place_panel, transform_of_pose(message.pose))

    def _controls_seen(self, message: MarkerArray) -> None:
        controls, outline = controls_of_message(message)
        written = {control.name: control.label for control in self._layout.controls} if self._layout else {}
        labels = labels_of((control.name for control in controls), written)
        faces = tuple(_face(control, labels[control.name]) for control in controls)
        self._mail.newest("controls", self._set_scene, {"faces": faces, "outline": outline})

    def _panel_seen(self, message: DiagnosticArray) -> None:
        seen = panel_state_of_message(message)
        self._mail.newest("panel", self._server.post_value, self._desk.panel.show, seen)

    def _set_scene(self, values: dict[str, Any]) -> None:
        for name, value in values.items():
            setattr(self._scene, name, value)
        self._scene.changed()

    def _tip_seen(self, message: PointStamped) -> None:
        check_frame(message.header, CAMERA_LEFT)
        self._mail.newest("tip", self._set_tip, point_array(message), self._stamp(message))

    def _set_tip(self, point: Any, stamp: int) -> None:
        self._scene.tip, self._scene.tip_ns = point, stamp

    def _target_seen(self, message: PointStamped) -> None:
        self._mail.newest("target", setattr, self._scene, "target", (message.header.frame_id, point_array(message)))

    def _trajectory_seen(self, message: JointTrajectory) -> None:
        readings = trajectory_array(message, JOINTS)[:_MAX_PATH]
        path = np.column_stack([readings[:, :2] @ self._axes.T, -readings[:, 2]])
        self._mail.newest("path", self._desk.tip_path.publish, path)

    def _calibration_seen(self, message: TransformStamped) -> None:
        check_frame(message.header, CAMERA_LEFT)
        self._camera_from_base = transform_of_message(message)
        self._use_calibration()

    def _axes_seen(self, message: Float64MultiArray) -> None:
        axes = axes_of_message(message)
        self._withdrawn, self._axes = axes is None, np.eye(2) if axes is None else axes
        self._use_calibration()

    def _use_calibration(self) -> None:
        # Empty axes: the calibration was withdrawn. Its transform is still latched, and may arrive after them.
        known = None if self._withdrawn else self._camera_from_base
        self._mail.newest("calibrated", setattr, self._scene, "camera_from_base", known)

    def _joints_seen(self, message: JointState) -> None:
        reading = joint_positions(message, JOINTS)
        x, y = self._axes @ reading[:2]
        position = float(x), float(y), float(reading[2])
        self._mail.newest("joints", self._server.post_value, self._desk.machine.set_position, *position)

    def _confidence_seen(self, message: Float32) -> None:
        self._mail.newest("confidence", self._server.post_value, self._desk.machine.set_confidence, float(message.data))

    def _factor_seen(self, message: Float32) -> None:
        self._mail.newest("factor", self._desk.machine.set_simulation_factor, float(message.data))

    def _check_liveness(self) -> None:
        # The page's console shows these log messages, which it receives from /rosout.
        changes = self._liveness.check(self._seconds(), self._condition_of)
        late = [change for change in changes if change.condition is Condition.LATE]
        if late:
            silent_s, names = min(change.silent_s for change in late), ", ".join(change.name for change in late)
            self._load.describe(partial(self._report_late, f"no report for {silent_s:.0f} s, late: {names}"))
        for change in changes:
            if change.condition is Condition.ENDED:
                self.get_logger().error(f"{change.name} has ended")
            elif change.condition is Condition.HANGS:
                self.get_logger().fatal(f"{change.name} hangs: it gives no sign of life")

    def _check_simulated_time(self) -> None:
        """Report that the simulation has ended or hangs: without its clock, no timeout of the graph expires."""
        ros_ns, wall_s = self.ros_ns(), time.monotonic()
        if ros_ns != self._simulated_ns:
            if wall_s - self._simulated_since_s > SILENT_S:
                self.get_logger().info("simulated time goes on")
            self._simulated_ns, self._simulated_since_s, self._stood_still = ros_ns, wall_s, False
        elif wall_s - self._simulated_since_s > SILENT_S and not self._stood_still:
            self._stood_still = True
            text = f"simulated time has stood still for {SILENT_S:g} s: the bench, or a program it waits for, is late"
            self.get_logger().error(text)

    def _report_late(self, text: str, load: str) -> None:
        self.get_logger().warning(f"{text}; {load}" if load else text)

    def _condition_of(self, sender: Sender) -> Condition:
        number = process_number(sender.process)
        nodes = {f"{place.rstrip('/')}/{name}" for name, place in self.get_node_names_and_namespaces()}
        return judge(
            alive=None if number is None else is_alive(number),
            hangs=number in read_hanging(self._hanging_file),
            in_graph=sender.node in nodes,
        )

    def _facts_seen(self, message: DiagnosticArray) -> None:
        for status in message.status:
            name, facts = plain(status.name, MAX_NAME), pairs_of(status)
            sender = Sender(node=facts.get("node", ""), process=facts.get("process", ""))
            if self._liveness.heard(name, sender):
                self.get_logger().info(f"{name} reports again")
            part = next((part for reporter, part in _REPORTERS.items() if reporter in name), "")
            if part:
                self._mail.newest(f"facts {part}", self._desk.machine.set_facts, part, facts)

    def _said(self, message: Log) -> None:
        level = _LEVELS.get(message.level)
        # All robots of the domain share this topic; loggers have their nodes' names.
        mine = ".".join(self.get_namespace().split("/")[1:])
        if level and (not mine or message.name.startswith(f"{mine}.")):
            wall_ms = stamp_ns(message.stamp) // 1_000_000
            name, text = plain(message.name, MAX_NAME), plain(message.msg, 300)
            line = {"wall_ms": wall_ms, "level": level, "name": name, "text": text}
            self._mail.each(self._desk.said, line)

    def _parameters_changed(self, message: ParameterEvent) -> None:
        # All robots of the domain share this topic.
        if not message.node.startswith(self.get_namespace()):
            return
        for changed in message.changed_parameters:
            if changed.name != "use_sim_time":  # a command-line program that follows the graph's clock
                value = str(parameter_value_to_python(changed.value))[:_MAX_VALUE]
                self._server.post(self._desk.parameters.changed, message.node, changed.name[:_MAX_VALUE], value)

    def _result_seen(self, message: DiagnosticArray) -> None:
        self._server.post(self._desk.answers.result, result_of_message(message))

    def _sequence_result_seen(self, message: DiagnosticArray) -> None:
        self._server.post(self._desk.answers.sequence_result, result_of_message(message))

    def _taught(self, message: DiagnosticArray) -> None:
        self._server.post(self._desk.answers.taught, result_of_message(message))

    def _check_states(self) -> None:
        # The latched state of a node that has ended no longer applies.
        for part, topic in _STATES.items():
            if self.count_publishers(self.resolve_topic_name(topic)) == 0:
                self._mail.newest(part, self._desk.set_state, part, "")

    def _look_for_recorders(self) -> None:
        found = [
            f"{namespace.rstrip('/')}/{name}"
            for name, namespace in self.get_node_names_and_namespaces()
            if name.startswith(_RECORDERS) and name != self._server.recorder.node_name
        ]
        self._mail.newest("recorders", self._desk.recordings.seen, found, time.monotonic())

    def _read_sequences(self, config: BridgeConfig) -> dict[str, Sequence]:
        found: dict[str, Sequence] = {}
        folder = Path(config.sequence_folder).expanduser()
        for path in sorted(folder.glob("*.yaml")) if config.sequence_folder else ():
            try:
                found[stored_name(path.stem)] = parse_file(path.read_text(encoding="utf-8"), str(path))
            except (OSError, ValueError) as error:
                self.get_logger().error(f"this sequence is left out: {error}")
        return found

    # --- to the graph (GraphPort; called in the server's thread) ---------------------------------------------------

    def _make_outlets(self) -> None:
        self._goal = self.create_publisher(PointStamped, "gantry/goal", qos.COMMAND)
        self._command = self.create_publisher(String, "gantry/command", qos.COMMAND)
        self._teach_picture = self.create_publisher(Image, "panel/teach/image_raw", qos.RESULTS)
        self._teach_request = self.create_publisher(String, "panel/teach/request", qos.RESULTS)
        self._sequence = self.create_publisher(String, "gantry/sequence", qos.COMMAND)
        self._stop_request = self.create_publisher(Empty, "gantry/stop_request", qos.RESULTS)
        self._guard = stop_path(self.context.get_domain_id(), self._stop_request.topic_name)
        self._heartbeat = self.create_publisher(Header, "heartbeat", qos.RESULTS)
        self._stop_service = self.create_client(Trigger, "gantry/stop")
        self._enable_service = self.create_client(SetBool, "gantry/enable")
        self._triggers = {
            name: self.create_client(Trigger, topic) for name, topic in _SERVICES.items() if topic != "gantry/enable"
        }

    @property
    def runs_by_simulated_time(self) -> bool:
        return self._simulated

    def ros_ns(self) -> int:
        return int(self.get_clock().now().nanoseconds)

    def stop(self, answered: Callable[[bool, str], None]) -> None:
        stopped = send_stop(self._guard, "stop requested")  # first, because it does not need the middleware
        self._stop_request.publish(Empty())
        if self._stop_service.service_is_ready():
            asked = self._stop_service.call_async(Trigger.Request())
            asked.add_done_callback(lambda future: answered(True, ""))
        elif stopped:
            answered(True, "")
        elif self._stop_request.get_subscription_count() == 0:
            answered(False, "no driver listens")
        self.get_logger().warning("stop")

    def heartbeat(self) -> None:
        self._heartbeat.publish(header(self.ros_ns(), self.get_fully_qualified_name()))

    def send_command(self, text: str) -> None:
        if self._command.get_subscription_count() == 0:
            raise GraphError("no gantry controller listens")
        self._command.publish(String(data=text))

    def send_sequence(self, text: str) -> None:
        if self._sequence.get_subscription_count() == 0:
            raise GraphError("no sequencer listens")
        self._sequence.publish(String(data=text))

    def send_teaching(self, text: str, stamp_ns: int, encoding: str, picture: npt.NDArray[Any]) -> None:
        if not (self._teach_request.get_subscription_count() and self._teach_picture.get_subscription_count()):
            raise GraphError("no recognition listens that could be taught a panel")
        self._teach_picture.publish(image_message(picture, encoding, header(stamp_ns, CAMERA_LEFT)))
        self._teach_request.publish(String(data=text))

    def send_goal(self, frame: str, point: tuple[float, float], stamp_ns: int) -> None:
        if self._goal.get_subscription_count() == 0:
            raise GraphError("no gantry controller listens")
        self._goal.publish(point_message([*point, 0.0], header(stamp_ns, frame)))

    def call(self, service: str, answered: Callable[[bool, str], None]) -> None:
        switch = service in ("enable", "disable")
        client = self._enable_service if switch else self._triggers[service]
        if not client.service_is_ready():
            raise GraphError(f"the service {_SERVICES[service]} is not there")
        request = SetBool.Request(data=service == "enable") if switch else Trigger.Request()

        def done(future: Any) -> None:
            answer = future.result()
            answered(bool(answer.success), str(answer.message))

        client.call_async(request).add_done_callback(done)


def _face(control: Control, label: str) -> Face:
    x, y, z = (v * 1e-3 for v in (*control.position_mm, control.height_mm))
    width, height = (v * 1e-3 for v in control.size_mm)
    circle = control.shape == "circle"
    return Face(
        name=control.name, kind=control.kind, label=label, circle=circle, centre=(x, y, z), size=(width, height)
    )


def _read_layout(config: BridgeConfig) -> PanelLayout | None:
    try:
        return load_layout(Path(config.layout)) if config.layout else None
    except (OSError, LayoutError) as error:
        raise ConfigError(f"layout: {error}") from error


def _open_audit(config: BridgeConfig) -> AuditFile | None:
    try:
        if not config.audit_file:
            return None
        return AuditFile(Path(config.audit_file).expanduser(), 1e6 * config.audit_max_mb)
    except AuditError as error:
        raise ConfigError(f"audit_file = {config.audit_file!r}: {error}; look at it and move it away") from error
    except OSError as error:
        raise ConfigError(f"audit_file = {config.audit_file!r}: {error}") from error


def _make(**options: Any) -> BridgeNode:
    node = BridgeNode(**options)
    signal.signal(signal.SIGUSR1, lambda number, frame: node.issue_token())
    return node


def main() -> int:
    if refusal := ask_for_real_time(BRIDGE):
        print(f"ui_bridge: {refusal}; under load a motion may be stopped, see README, Hardware", file=sys.stderr)
    return run(_make)


if __name__ == "__main__":
    raise SystemExit(main())
