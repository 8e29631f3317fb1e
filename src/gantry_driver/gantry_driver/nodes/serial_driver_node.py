"""The serial driver's node: topics and services on one side, the guard of the machine on the other.

The guard is a separate process with the serial port and the protocol; the node finds or starts it. Callbacks convert
messages and send commands, one thread reads from the guard, and another one publishes. So neither a busy executor nor
a slow transport delays a stop. If this process ends or hangs, the guard holds the machine and lifts the stylus itself.

It is a lifecycle node: configured, it owns the port and monitors the board; active, it carries out motions. With the
parameter ``autostart`` it takes both steps itself. Its topics and services exist in every state; a rejection gives the
reason.
"""

from __future__ import annotations

import gc
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterable
from queue import SimpleQueue
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PointStamped, PoseWithCovarianceStamped
from rclpy.lifecycle import LifecycleState, TransitionCallbackReturn
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool, Empty, Header, String
from std_srvs.srv import SetBool, Trigger
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from gantry_driver.adapters.guard.client import GuardLink
from gantry_driver.core.configuration.machine_config import DriverConfig
from gantry_driver.core.grbl.trajectory_bytes import max_bytes, read_head, refusal
from gantry_driver.core.grbl.trajectory_gcode import Waypoint
from gantry_driver.core.guard.messages import config_values
from gantry_driver.core.machine.attendance import SIGN_S, Attendance, silent_text
from gantry_driver.core.states.machine_states import Answered, Event, Note, Position, StateChanged
from gantry_driver.core.states.reasons import STOP_REQUESTED
from gantry_driver.nodes.panel_plane import plane_of_message
from icu_common.adapters.direct_stop.line import stop_path
from icu_common.adapters.real_time import DRIVER, ask_for_real_time, is_real_time
from icu_common.adapters.steps.step_ledger import BYTES_READ, BYTES_WRITTEN
from icu_common.core.admission.heartbeats import HeartbeatSources
from icu_common.core.admission.sources import base_name, distrust_text
from icu_common.core.configuration.text_bounds import plain
from icu_common.core.geometry.frames import JOINTS
from icu_common.core.goals.intent import Intent, read_frame
from icu_common.core.reasons.message import Message
from icu_common.core.reasons.state_text import because, state_name
from icu_common.nodes.admission.sources import SourceWatch
from icu_common.nodes.diagnostics import sender_values
from icu_common.nodes.graph_node import GraphLifecycleNode, this_process
from icu_common.nodes.messages.answers import answer_text
from icu_common.nodes.messages.heads import header, stamp_ns
from icu_common.nodes.messages.joints import joint_message
from icu_common.nodes.messages.results import diagnostic_status, result_message
from icu_common.nodes.parameters import LiveParameters
from icu_common.nodes.qos import COMMAND, LATCHED, RESULTS, SENSOR
from icu_common.nodes.runtime import run
from icu_common.nodes.state_codes import code_values
from icu_common.nodes.timers import every, runs_by_clock_topic, seconds_of

STEPS = "driver:steps"
"""Ledger entry for the number of steps of simulated time that the guard has processed."""
CONTROLLER = "gantry_controller"
"""Node whose trajectories may be drags and turns."""
LINK_CHECK_S = 0.5
PUBLISH_WITHIN_S = 2.0
"""Maximum seconds to publish the remaining messages when the driver ends."""
LINK_ENDED = Message("driver.thread_guard_ended")
LEVELS = {
    **dict.fromkeys(("idle", "moving", "homing"), "ok"),
    **dict.fromkeys(("disabled", "unhomed", "connecting", "stopped"), "warn"),
}


class SerialDriverNode(GraphLifecycleNode):
    """Drives one gantry; see docs/reference/topics.md and states.md in that folder."""

    def __init__(self, **node_arguments: Any) -> None:
        super().__init__("serial_driver", **node_arguments)
        self._live = LiveParameters(self, DriverConfig, self._on_config, unrest=self._unrest)
        config = self._live.config
        self._joint_states = self.create_publisher(JointState, "joint_states", RESULTS)
        self._state = self.create_publisher(String, "driver_state", LATCHED)
        self._settings, self._settings_told = self.create_publisher(String, "machine_settings", LATCHED), ""
        self._results = self.create_publisher(DiagnosticArray, "trajectory_result", RESULTS)
        self._diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", RESULTS)
        self._old_wakeup_fd: int | None = None
        self._configured = False
        self._state_topic = self.resolve_topic_name("driver_state")
        self._values = sender_values(self)
        """Values of the board in the newest report."""
        self._outbox: SimpleQueue[Callable[[], None] | None] = SimpleQueue()
        self._publisher = threading.Thread(target=self._publish_all, name="publisher", daemon=True)
        self._publisher.start()
        stops = self.create_subscription(Empty, "stop_request", lambda _: self._link.stop(STOP_REQUESTED), RESULTS)
        self._stop_path = stop_path(self.context.get_domain_id(), stops.topic_name)
        self._link: GuardLink = self._make_link()
        self._heartbeats = HeartbeatSources(config.heartbeat_programs)
        self._sources = SourceWatch(self, self._on_sources)
        self._attendance = Attendance()
        self._sources.subscribe(JointTrajectory, "trajectory", self._on_trajectory_bytes, COMMAND, raw=True)
        self._sources.subscribe(PointStamped, "stylus_seen_clear", self._on_seen_clear, RESULTS)
        self._sources.subscribe(PoseWithCovarianceStamped, "panel/plane", self._on_plane, LATCHED)
        self._sources.subscribe(Bool, "attending", self._on_attending, RESULTS)
        self._sources.subscribe(Header, "heartbeat", self._on_heartbeat, SENSOR, self._heartbeats.judge)
        self._sources.watch_clock()
        self.create_service(Trigger, "home", self._on_home)
        self.create_service(Trigger, "stop", self._on_stop)
        self.create_service(Trigger, "reset", self._on_reset)
        self.create_service(Trigger, "accept_settings", self._on_accept)
        self.create_service(Trigger, "write_settings", self._on_write)
        self.create_service(SetBool, "enable", self._on_enable)
        every(self, SIGN_S, self._check_attendance)
        every(self, 1.0, self._publish_diagnostics)
        every(self, LINK_CHECK_S, self._check_link, wall=True)
        self.add_clock_listener(self._on_step)
        if config.autostart:
            self.trigger_configure()
            self.trigger_activate()

    def close(self) -> None:
        """Hold, lift the stylus, report it, and close the port."""
        self._close_link()
        self._outbox.put(None)
        self._publisher.join(PUBLISH_WITHIN_S)

    def _close_link(self) -> None:
        if self._old_wakeup_fd is not None:
            signal.set_wakeup_fd(self._old_wakeup_fd)
            self._old_wakeup_fd = None
        self._configured = False
        self._link.close(Message("driver.driver_ending"))

    # --- lifecycle -------------------------------------------------------------------------------------------------

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Open the port, or keep trying, and monitor the board."""
        if threading.current_thread() is threading.main_thread():
            self._old_wakeup_fd = signal.set_wakeup_fd(self._link.wakeup_fd, warn_on_full_buffer=False)
        self._link.start()
        self._configured = True
        return super().on_configure(state)

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Allow motion."""
        self._link.ask("activate", on=True)
        return super().on_activate(state)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Stop the machine; continue to monitor the board."""
        self._link.ask("activate", on=False)
        return super().on_deactivate(state)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Bring the machine to rest and release the port."""
        self._close_link()
        self._link = self._make_link()
        return super().on_cleanup(state)

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Do the same as for cleanup; this state is final."""
        return self.on_cleanup(state)

    def _make_link(self) -> GuardLink:
        return GuardLink(
            self._live.config,
            self._on_events,
            stop_path=self._stop_path,
            time_s=self._link_time(),
            on_turn=None if this_process.ledger is None else self._count_turn,
        )

    def _link_time(self) -> Callable[[], float] | None:
        """Return the source of the machine's time, which the guard gets in steps; None to use the guard's clock."""
        ledger = this_process.ledger
        if ledger is not None and this_process.simulated:
            return lambda: ledger.time_ns / 1e9
        return seconds_of(self) if runs_by_clock_topic(self) else None

    # --- from the graph ------------------------------------------------------------------------------------------

    def _on_sources(self, topic: str, text: str) -> None:
        self._link.rivals(topic, text)

    def _on_trajectory_bytes(self, data: bytes) -> None:
        """Unpack a trajectory, or reject it if it is too large."""
        most = self._live.config.max_points
        try:
            head = read_head(data)
        except ValueError as error:
            self.get_logger().warning(f"unreadable trajectory ignored: {error}", throttle_duration_sec=1.0)
            return
        if head.points > most or len(data) > max_bytes(most):
            reason = Message("path.trajectory_points_1_needed", points=head.points, max_points=most)
            if head.points <= most:
                reason = Message("driver.trajectory_bytes_limit", data=len(data), max_bytes=max_bytes(most))
            self._on_events([Answered(result=refusal(head, reason))])
            return
        self._on_trajectory(deserialize_message(data, JointTrajectory))

    def _on_trajectory(self, message: JointTrajectory) -> None:
        stamp = stamp_ns(message.header.stamp)
        age_s = (self._now_ns() - stamp) / 1e9 if stamp else 0.0
        goal_id, intent = read_frame(message.header.frame_id, stamp)
        names, points = list(message.joint_names), [_waypoint(point) for point in message.points]
        self._sources.look("trajectory")  # a message may arrive before the event of its publisher
        senders = self._sources.names("trajectory")
        distrust = distrust_text(senders, self._live.config.trajectory_programs)
        if any(base_name(sender) != CONTROLLER for sender in senders):
            intent = Intent.PRESS  # only the controller drags and turns
        self._link.run(goal_id, names, points, age_s=age_s, distrust=distrust, intent=intent.value)

    def _on_heartbeat(self, message: Header) -> None:
        if self._heartbeats.heard(message.frame_id, time.monotonic()):
            self._sources.look("heartbeat")
        stamp = stamp_ns(message.stamp)
        # A trajectory that was long in transit must not count as new; a stamp in the future counts as now.
        age_s = max(0.0, (self._now_ns() - stamp) / 1e9) if stamp else 0.0
        self._link.tell("heartbeat", age_s=age_s)

    def _on_attending(self, message: Bool) -> None:
        self._attendance.take(bool(message.data), self._now_ns() / 1e9)

    def _check_attendance(self) -> None:
        """Stop a machine that moves or presses for a controller that has ended or hangs."""
        silent_s = self._attendance.silent_s(self._now_ns() / 1e9)
        if silent_s > self._live.config.attendance_timeout_s:
            self._attendance.forget()
            if self._unrest():
                self._link.stop(silent_text(silent_s))

    def _on_seen_clear(self, message: PointStamped) -> None:
        age_s, height_m = (self._now_ns() - stamp_ns(message.header.stamp)) / 1e9, float(message.point.z)
        self._link.ask("seen_clear", height_m=height_m, age_s=age_s)

    def _on_plane(self, message: PoseWithCovarianceStamped) -> None:
        try:
            plane = plane_of_message(message)
        except ValueError as error:
            self.get_logger().error(f"panel/plane: ignored: {plain(str(error))}", throttle_duration_sec=5.0)
            return
        self._sources.look("panel/plane")  # a message may arrive before the event of its publisher
        senders = self._sources.names("panel/plane")
        if distrust := distrust_text(senders, self._live.config.trajectory_programs):
            self.get_logger().error(f"panel/plane: ignored: {distrust}", throttle_duration_sec=5.0)
            return
        age_s = (self._now_ns() - stamp_ns(message.header.stamp)) / 1e9
        self._link.tell("panel", plane=plane.values(), age_s=age_s)

    def _on_home(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        return _fill(response, self._link.ask("home"), Message("driver.accepted_homing"))

    def _on_stop(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._link.stop(STOP_REQUESTED)
        return _fill(response, "", Message("driver.stopping"))

    def _on_reset(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        return _fill(response, self._link.ask("reset"), Message("driver.accepted_reset"))

    def _on_accept(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        return _fill(response, self._link.ask("accept_settings"), Message("driver.accepted"))

    def _on_write(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        refusal = self._link.ask("write_settings")
        return _fill(response, refusal, Message("driver.accepted_writing_configured_settings_they"))

    def _on_enable(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        text = Message("driver.enabled" if request.data else "driver.disabled")
        return _fill(response, self._link.ask("enable", on=request.data), text)

    def _unrest(self) -> str:
        return str(self._link.ask("unrest"))

    def _on_config(self, config: DriverConfig) -> None:
        self._link.ask("configure", config=config_values(config))

    # --- to the graph ----------------------------------------------------------------------------------------------

    def _on_events(self, events: list[Event]) -> None:
        stamp = self._now_ns()
        self._outbox.put(lambda: self._publish_events(events, stamp))

    def _on_step(self, now_ns: int) -> None:
        """Send the new time to the guard."""
        ledger = this_process.ledger
        if ledger is not None:
            ledger.expect(STEPS)
        if not self._link.step(now_ns / 1e9) and ledger is not None:
            ledger.finish(STEPS)

    def _count_turn(self, steps: int, read: int, written: int) -> None:
        """Count the work of one turn of the guard, after its events have been published."""
        self._outbox.put(lambda: self._count(steps, read, written))

    def _count(self, steps: int, read: int, written: int) -> None:
        if (ledger := this_process.ledger) is not None:
            ledger.finish(BYTES_WRITTEN, written)
            ledger.finish(BYTES_READ, read)
            ledger.finish(STEPS, steps)

    def _publish_all(self) -> None:
        for publish in iter(self._outbox.get, None):
            publish()

    def _publish_events(self, events: list[Event], stamp: int) -> None:
        for event in events:
            if isinstance(event, Position):
                self._joint_states.publish(joint_message(JOINTS, event.reading_m, header(stamp, ""), event.probe))
            elif isinstance(event, StateChanged):
                if event.logged:
                    self.get_logger().info(event.text)
                self._diagnostics.publish(self._report(event.text, event.codes, stamp))  # before the text
                self._state.publish(String(data=event.text))
            elif isinstance(event, Answered):
                self._results.publish(result_message(event.result, stamp))
            elif isinstance(event, Note) and event.level == "error":
                self.get_logger().error(event.text)
            elif isinstance(event, Note):  # a separate call: rclpy raises if one line logs at two levels
                self.get_logger().warning(event.text)

    def _publish_diagnostics(self) -> None:
        status = self._link.ask("status")
        if not isinstance(status, dict):
            return  # a guard that does not answer is restarted, and the state reports it
        state, settings = str(status["state"]), str(status["settings"])
        values = [(str(name), str(value)) for name, value in status["values"]]
        if settings and settings != self._settings_told:
            self._settings_told = settings
            self._outbox.put(lambda: self._settings.publish(String(data=settings)))
        values += [
            ("trajectories_from", " ".join(self._sources.names("trajectory"))),
            ("heartbeats_from", " ".join(self._heartbeats.senders(self._sources.names("heartbeat")))),
        ]
        values += [("real_time", str(is_real_time())), *sender_values(self)]
        self._values, codes = values, [(str(name), str(value)) for name, value in status.get("codes", ())]
        message = self._report(state, codes, self._now_ns())
        self._outbox.put(lambda: self._diagnostics.publish(message))

    def _report(self, state: str, codes: Iterable[tuple[str, str]], stamp: int) -> DiagnosticArray:
        """Return a report of a state with its codes, and with the newest values of the board."""
        values = [*self._values, *code_values(self._state_topic, dict(codes))]
        level = LEVELS.get(state_name(state), "error")
        report = diagnostic_status(f"{self.get_name()}: board", level, state, values)
        return DiagnosticArray(header=header(stamp, ""), status=[report])

    def _check_link(self) -> None:
        if not self._publisher.is_alive():
            raise RuntimeError(
                "the thread that publishes has ended; the driver ends too, so that bring-up starts it anew"
            )
        if self._configured and not self._link.alive:
            self._state.publish(String(data=because("disconnected", LINK_ENDED)))
            raise RuntimeError(f"{LINK_ENDED}; the driver ends too, so that bring-up starts it anew")

    def _now_ns(self) -> int:
        return int(self.get_clock().now().nanoseconds)


def _waypoint(point: JointTrajectoryPoint) -> Waypoint:
    time_s = point.time_from_start.sec + point.time_from_start.nanosec / 1e9
    return Waypoint(positions_m=tuple(point.positions), velocities_m_s=tuple(point.velocities), time_s=time_s)


def _fill(response: Any, refusal: str, success: str) -> Any:
    text = Message("driver.refused", refusal=refusal) if refusal else success
    response.success, response.message = not refusal, answer_text(text)
    return response


def make_node(**node_arguments: Any) -> SerialDriverNode:
    """Return the node of a separate process; the garbage collector skips all objects that exist at this point."""
    node = SerialDriverNode(**node_arguments)
    gc.collect()
    gc.freeze()
    return node


def main() -> int:
    if refusal := ask_for_real_time(DRIVER):
        print(
            f"serial_driver: {refusal}; under load a stop may take longer, see docs/how-to/hardware.md", file=sys.stderr
        )
    signal.signal(signal.SIGTSTP, signal.SIG_IGN)  # A driver suspended by Ctrl-Z could not hold the machine.
    return run(make_node, shared_memory=False)


if __name__ == "__main__":
    raise SystemExit(main())
