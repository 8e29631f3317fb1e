"""The serial driver's node on mock_grbl: topics, services, refusals, the heartbeat, the way out on SIGTERM."""

from __future__ import annotations

import math
import os
import signal
import struct
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from builtin_interfaces.msg import Duration as DurationMessage
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState, GetState
from nodes.driver_operator import HOMED, IN_PROCESS, NO_PANEL, PATIENCE, Operator
from nodes.grbl_board import GrblBoard
from rclpy.duration import Duration
from rclpy.parameter import Parameter
from rclpy.serialization import serialize_message
from sensor_msgs.msg import JointState
from std_msgs.msg import Empty, Header
from std_srvs.srv import SetBool
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from gantry_driver.adapters import serial_link
from gantry_driver.nodes import serial_driver_node
from gantry_driver.nodes.serial_driver_node import LINK_CHECK_S, SerialDriverNode
from icu_common.adapters.real_time import steady_s
from icu_common.core.geometry.frames import JOINTS
from icu_common.core.reasons.codes import DriverCode
from icu_common.nodes.qos import RESULTS

pytestmark = [pytest.mark.long, pytest.mark.alone]  # the board and the driver keep real time
SLOW_M_S = 0.03
"""Length of a path on which the machine is stopped: it must not have ended, even if the stopping program is held up for
seconds."""


@pytest.fixture
def operator(ros: Any, tmp_path: Path) -> Iterator[Callable[..., Operator]]:
    boards: list[GrblBoard] = []

    def make(*arguments: str, **parameters: Any) -> Operator:
        board = GrblBoard(tmp_path, *arguments)
        boards.append(board)
        values = {"port": str(board.port), "trajectory_programs": "operator", **PATIENCE, **IN_PROCESS, **NO_PANEL}
        ros.node(SerialDriverNode, {**values, **parameters})
        return Operator(ros, board)

    yield make
    ros.close()
    ros.nodes.clear()
    for board in boards:
        board.close()


def test_home_and_two_points_with_joint_states_and_diagnostics(operator: Callable[..., Operator]) -> None:
    op = operator()
    op.state("unhomed")
    assert op.joints == [], "no position is published before it is known"
    op.ready()
    op.until(lambda: op.joints)
    assert list(op.joints[-1].name) == list(JOINTS)
    assert list(op.joints[-1].position) == pytest.approx([0.0, 0.0, 0.0], abs=1e-6)
    op.go((0.1, 0.05, 0.0), (0.1, 0.05, 0.01), frame_id="first")
    op.until(lambda: len(op.results) == 2)
    assert [(r.goal_id, r.outcome.value) for r in op.results] == [("first", "accepted"), ("first", "reached")]
    assert op.results[-1].error_m < 2e-5 and op.results[-1].duration_s > 0.1
    # The answer is another topic than the readings, and may be read first.
    op.until(lambda: list(op.joints[-1].position) == pytest.approx([0.1, 0.05, 0.01], abs=2e-5))
    ages_s: list[float] = []

    def young() -> bool:  # the next one is, where this one has waited here
        stamp = op.joints[-1].header.stamp
        ages_s.append(op.node.get_clock().now().nanoseconds / 1e9 - (stamp.sec + stamp.nanosec / 1e9))
        return ages_s[-1] < 1.0

    op.until(young)
    assert min(ages_s) >= 0
    assert op.board.mpos() == pytest.approx((HOMED[0] + 100, HOMED[1] + 50, HOMED[2] - 10), abs=0.02)
    op.diagnostics.clear()
    op.until(lambda: op.diagnostics)
    status = op.diagnostics[-1].status[0]
    values = {pair.key: pair.value for pair in status.values}
    assert status.name == "serial_driver: board" and status.message == "idle"
    assert values["sent"] == values["acknowledged"] == values["executed"] and int(values["sent"]) >= 6
    assert values["receive_buffer_bytes"] == "128" and values["dialect"] == "GRBL" and values["homed"] == "True"


def test_bad_goals_are_refused_with_the_reason_and_nothing_moves(operator: Callable[..., Operator]) -> None:
    op = operator().ready()
    since = op.board.log()[-1]["n"]
    now = op.node.get_clock().now()
    old = (now - Duration(seconds=5.0)).to_msg()
    cases: list[tuple[Callable[[], None], str]] = [
        (lambda: op.go((math.nan, 0.0, 0.0)), "is not finite"),
        (lambda: op.go((0.1, math.inf, 0.0)), "is not finite"),
        (lambda: op.go((0.4, 0.1, 0.0)), "gantry_x_joint = 0.4 m is outside 0 to 0.359 m"),
        (lambda: op.go((0.1, 0.1, -0.01)), "stylus_joint = -0.01 m is outside 0 to 0.059 m"),
        (lambda: op.go((0.1, 0.1), names=("gantry_x_joint", "elbow")), "joint names"),
        (lambda: op.go((0.1, 0.1), names=JOINTS), "2 positions for 3 joints"),
        (lambda: op.go(), "0 points"),
        (lambda: op.go((0.1, 0.1, 0.0), stamp=old), "stale"),
    ]
    for number, (send, reason) in enumerate(cases, 1):
        send()
        op.until(lambda n=number: len(op.results) == n)
        assert op.results[-1].outcome.value == "rejected" and reason in op.results[-1].reason
    op.go((0.01, 0.0, 0.0), stamp=op.node.get_clock().now().to_msg())
    op.until(lambda: op.results and op.results[-1].outcome.value == "reached")
    moves = [line["text"] for line in op.board.lines(since) if "G53" in line["text"]]
    assert moves == ["F9000X-349G53G1"], "the sentinel alone moved"
    assert op.results[-1].goal_id.isdigit() and len(op.results[-1].goal_id) > 15


def test_a_trajectory_that_is_too_large_is_refused_before_it_is_unpacked(
    operator: Callable[..., Operator], monkeypatch: pytest.MonkeyPatch
) -> None:
    unpacked: list[int] = []
    unpack = serial_driver_node.deserialize_message

    def note(data: bytes, kind: Any) -> Any:
        unpacked.append(len(data))
        return unpack(data, kind)

    monkeypatch.setattr(serial_driver_node, "deserialize_message", note)
    op = operator().ready()
    point = JointTrajectoryPoint(positions=[0.1, 0.1, 0.0])
    message = JointTrajectory(joint_names=list(JOINTS), header=Header(frame_id="many"), points=[point, point])
    short = bytes(serialize_message(message))
    head, size = short[: len(short) - 2 * 64], 64  # a point of three positions alone, with its padding
    assert head[-4:] == struct.pack("<I", 2) and len(head) % 8 == 4, "points begin where doubles are aligned"
    op.until(lambda: op.trajectory.get_subscription_count() == 1)
    op.trajectory.publish(head[:-4] + struct.pack("<I", 200_000) + 200_000 * short[-size:])
    op.until(lambda: op.results)
    assert (op.results[-1].goal_id, op.results[-1].outcome.value) == ("many", "rejected")
    assert op.results[-1].reason == "the trajectory has 200000 points (limits 1 to 2000)"
    message.joint_names[0] = 4000 * "j"
    message.points = [JointTrajectoryPoint(positions=100 * [0.1])] * 500
    op.trajectory.publish(message)
    op.until(lambda: len(op.results) == 2)
    assert "bytes (limit 388096)" in op.results[-1].reason and unpacked == []
    op.trajectory.publish(b"\x00\x01\x00\x00\xff")  # too short to name a goal for an answer
    op.go((0.01, 0.0, 0.0), frame_id="sentinel")
    op.until(lambda: op.results[-1].outcome.value == "reached")
    assert [r.goal_id for r in op.results[2:]] == ["sentinel", "sentinel"] and len(unpacked) == 1


def test_not_enabled_or_without_heartbeat_nothing_moves(operator: Callable[..., Operator]) -> None:
    op = operator(heartbeat_timeout_s=0.6)
    op.beating = False
    op.state("unhomed")
    answer = op.call("home")
    assert not answer.success and answer.message == "refused: not enabled"
    op.call("enable", SetBool, data=True)
    answer = op.call("home")
    assert not answer.success and "no operator's heartbeat" in answer.message
    old = Header(stamp=(op.node.get_clock().now() - Duration(seconds=3.0)).to_msg())
    op.until(lambda: op.heartbeat.get_subscription_count() == 1)
    op.heartbeat.publish(old)
    refusals: list[Any] = []

    def lost() -> bool:
        refusals.append(op.call("home"))
        return "heartbeat lost" in refusals[-1].message

    op.until(lost)
    assert not any(answer.success for answer in refusals), "a heartbeat that was long under way does not count"
    assert not any(line["text"] == "$H" for line in op.board.lines())


def test_disabling_and_enabling_are_seen_in_the_state(operator: Callable[..., Operator]) -> None:
    op = operator().ready()
    assert op.call("enable", SetBool, data=False).message == "disabled"
    op.state("disabled")
    op.go((0.1, 0.1, 0.0))
    op.until(lambda: op.results)
    assert (op.results[-1].outcome.value, op.results[-1].reason) == ("rejected", "not enabled")
    assert op.call("enable", SetBool, data=True).message == "enabled"
    op.state("idle")


def test_trajectory_of_a_program_that_is_not_allowed_moves_nothing(operator: Callable[..., Operator]) -> None:
    op = operator(trajectory_programs="gantry_controller").ready()
    op.go((0.0, 0.0, 0.06), (0.158, 0.0, 0.06), frame_id="deep")
    op.until(lambda: op.results)
    reason = "from /operator: trajectory_programs allows gantry_controller"
    assert [(r.goal_id, r.outcome.value, r.reason) for r in op.results] == [("deep", "rejected", reason)]
    assert op.board.mpos() == pytest.approx(HOMED, abs=0.01) and op.states[-1] == "idle"


@pytest.mark.parametrize(("topic", "kind"), [("trajectory", JointTrajectory), ("heartbeat", Header)])
def test_second_program_stops_a_motion_in_contact_and_the_stylus_is_lifted(
    operator: Callable[..., Operator], ros: Any, topic: str, kind: Any
) -> None:
    op = operator().ready()
    foreign = ros.plain("foreign")
    op.go((0.0, 0.0, 0.02), (0.021, 0.012, 0.02), (0.35, 0.2, 0.02), last_m_s=SLOW_M_S)
    op.until(lambda: op.joints and op.joints[-1].position[0] > 0.02)
    outlet = foreign.create_publisher(kind, topic, RESULTS)
    text = f"two programs publish {topic}: /foreign and /operator"
    op.state(f"stopped: {text}")
    op.until(lambda: op.results and op.results[-1].outcome.value == "aborted")
    assert op.results[-1].reason == text
    op.until(lambda: op.board.mpos()[2] > HOMED[2] - 0.05)
    op.until(lambda: op.call("reset").success)
    op.go((0.1, 0.1, 0.0))
    op.until(lambda: op.results[-1].reason == text and op.results[-1].outcome.value == "rejected")
    foreign.destroy_publisher(outlet)

    def obeys() -> bool:
        op.go((0.1, 0.1, 0.0))
        op.until(lambda: op.results[-1].outcome.value != "accepted")
        return op.results[-1].outcome.value == "reached"

    op.until(obeys)


def test_lost_heartbeat_stops_and_lifts(operator: Callable[..., Operator]) -> None:
    op = operator().ready()
    op.go((0.0, 0.0, 0.02), (0.021, 0.012, 0.02), (0.35, 0.2, 0.02), last_m_s=SLOW_M_S)
    op.until(lambda: op.joints and op.joints[-1].position[0] > 0.02)
    op.beating = False
    op.state("stopped: operator's heartbeat lost")
    op.until(lambda: op.results and op.results[-1].outcome.value == "aborted")
    op.until(lambda: op.board.mpos()[2] > HOMED[2] - 0.05)
    x, y, _ = op.board.mpos()
    assert -359 + 20 < x < -359 + 345
    op.until(lambda: op.call("reset").success)
    op.state("idle")
    op.go((0.1, 0.1, 0.0))
    op.until(lambda: op.results and op.results[-1].outcome.value == "rejected")
    assert "heartbeat lost" in op.results[-1].reason
    assert op.board.mpos()[:2] == pytest.approx((x, y))


@pytest.mark.parametrize("way", ["topic", "service"])
def test_stop_is_latched_until_reset(operator: Callable[..., Operator], way: str) -> None:
    op = operator().ready()
    op.go((0.051, 0.0, 0.0), (0.35, 0.0, 0.0), last_m_s=SLOW_M_S)
    op.until(lambda: op.joints and op.joints[-1].position[0] > 0.05)
    if way == "topic":
        op.until(lambda: op.stop.get_subscription_count() == 1)
        op.stop.publish(Empty())
    else:
        assert op.call("stop").success
    op.state("stopped: stop requested")
    op.until(lambda: op.results and op.results[-1].outcome.value == "aborted")
    assert op.results[-1].reason == "stop requested"
    op.until(lambda: op.reported("stopped: stop requested").get("code") == DriverCode.STOP_REQUESTED)
    op.go((0.1, 0.0, 0.0))
    op.until(lambda: op.results and op.results[-1].outcome.value == "rejected")
    assert "stopped" in op.results[-1].reason
    op.until(lambda: op.call("reset").success)
    op.state("idle")
    op.go((0.1, 0.1, 0.0))
    op.until(lambda: op.results and op.results[-1].outcome.value == "reached")
    assert op.board.mpos()[:2] == pytest.approx((HOMED[0] + 100, HOMED[1] + 100), abs=0.02)


def test_settings_that_differ_block_motion_until_accepted(operator: Callable[..., Operator]) -> None:
    op = operator("--set", "110=500")
    op.state("mismatch: $110 is 500.000; expected 12000 (the configuration)")
    op.until(lambda: op.reported(op.states[-1]).get("code") == DriverCode.SETTINGS_DIFFER)
    op.call("enable", SetBool, data=True)
    assert "mismatch" in op.call("home").message
    answer = op.call("accept_settings")
    assert answer.success
    op.state("unhomed")
    assert not op.call("accept_settings").success


def test_an_error_after_a_warning_is_told_too(operator: Callable[..., Operator]) -> None:
    op = operator("--set", "1=25")  # warned of: motors let go
    op.ready()
    op.board.fault("error", number=33)
    op.go((0.1, 0.1, 0.0), frame_id="first")
    op.state("stopped: error:33")
    op.until(lambda: op.results and op.results[-1].outcome.final)
    assert op.results[-1].reason.startswith("error:33")


def test_times_and_velocities_become_feeds(operator: Callable[..., Operator]) -> None:
    op = operator().ready()
    since = op.board.log()[-1]["n"]
    message = JointTrajectory(joint_names=["gantry_x_joint"])
    first = JointTrajectoryPoint(positions=[0.05], time_from_start=DurationMessage(sec=1))
    second = JointTrajectoryPoint(positions=[0.06], velocities=[0.02])
    message.points = [first, second]
    op.until(lambda: op.trajectory.get_subscription_count() == 1)
    op.trajectory.publish(message)
    op.until(lambda: op.results and op.results[-1].outcome.value == "reached")
    moves = [line["text"] for line in op.board.lines(since) if "G53" in line["text"]]
    assert moves == ["F3000X-309G53G1", "F1200X-299G53G1"]


def test_parameters_have_ranges_and_a_bad_one_is_refused(operator: Callable[..., Operator], ros: Any) -> None:
    operator()
    driver = next(node for node in ros.nodes if isinstance(node, SerialDriverNode))
    descriptor = driver.describe_parameter("heartbeat_timeout_s")
    assert descriptor.floating_point_range[0].from_value == 0.1 and "[s]" in descriptor.description
    outcome = driver.set_parameters([Parameter("heartbeat_timeout_s", value=60.0)])[0]
    assert not outcome.successful
    assert driver.set_parameters([Parameter("feed_m_s", value=0.05)])[0].successful
    assert driver.get_parameter("feed_m_s").value == 0.05
    outcome = driver.set_parameters([Parameter("machine.travel_mm", value=[500.0, 220.0, 60.0])])[0]
    assert not outcome.successful and "read-only" in outcome.reason
    assert list(driver.get_parameter("machine.travel_mm").value) == [360.0, 220.0, 60.0]


def test_reports_come_at_a_changed_rate_at_once(
    operator: Callable[..., Operator], ros: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    op = operator(status_rate_hz=1.0).ready()
    driver = next(node for node in ros.nodes if isinstance(node, SerialDriverNode))
    begun_s = steady_s()
    # A slower clock, by which who is held up for two seconds misses none of the times below.
    monkeypatch.setattr(serial_link, "steady_s", lambda: begun_s + (steady_s() - begun_s) / 5)
    assert driver.set_parameters([Parameter("status_rate_hz", value=50.0)])[0].successful
    # Shorter than the reports were apart before.
    assert driver.set_parameters([Parameter("status_timeout_s", value=0.6)])[0].successful
    op.joints.clear()
    op.states.clear()
    op.until(lambda: len(op.joints) > 10 or op.states)
    assert op.states == []


@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
def test_a_dead_port_thread_is_said_and_ends_the_node_within_a_second(
    operator: Callable[..., Operator], ros: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    checks: list[bool] = []
    check = SerialDriverNode._check_link
    monkeypatch.setattr(SerialDriverNode, "_check_link", lambda node: (checks.append(node._link.alive), check(node)))
    op = operator().ready()
    driver = next(node for node in ros.nodes if isinstance(node, SerialDriverNode))
    ended = threading.Event()

    def end(events: object) -> None:
        ended.set()
        raise SystemExit

    monkeypatch.setattr(driver._link, "_on_events", end)
    assert ended.wait(15.0)
    driver._link._thread.join(15.0)
    with pytest.raises(RuntimeError, match="the thread of the guard has ended"):
        op.until(lambda: False)
    # The first look after it, and they are less than a second apart, which is no matter of how busy the machine is.
    assert checks.count(False) == 1 and LINK_CHECK_S < 1.0
    assert round(LINK_CHECK_S * 1e9) in [timer.timer_period_ns for timer in driver.timers]
    ros.executor.remove_node(driver)
    op.state("disconnected: the thread of the guard has ended")


@pytest.mark.usefixtures("hang_up")
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_a_signal_to_end_holds_lifts_and_ends(number: signal.Signals, ros: Any, tmp_path: Path) -> None:
    """SIGHUP is what a terminal leaves behind that is closed, or whose connection is cut."""
    board = GrblBoard(tmp_path)
    command = [sys.executable, "-m", "gantry_driver.nodes.serial_driver_node", "--ros-args"]
    for name, value in {"port": board.port, "trajectory_programs": "operator", **PATIENCE, **NO_PANEL}.items():
        command += ["-p", f"{name}:={value}"]
    environment = {**os.environ, "ROS_DOMAIN_ID": str(ros.context.get_domain_id())}
    driver = subprocess.Popen(command, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        op = Operator(ros, board).ready()
        op.go((0.0, 0.0, 0.03), (0.051, 0.0, 0.03), (0.35, 0.0, 0.03), last_m_s=SLOW_M_S)
        op.until(lambda: op.joints and op.joints[-1].position[0] > 0.05)
        since = board.log()[-1]["n"]
        driver.send_signal(signal.SIGTSTP)  # Ctrl-Z: put aside, it could not hold
        driver.send_signal(number)
        assert driver.wait(30.0) == 0
        entries = board.log(since)
        hold = next(e["n"] for e in entries if e["kind"] == "realtime" and e["byte"] == ord("!"))
        reset = next(e["n"] for e in entries if e["kind"] == "realtime" and e["byte"] == 0x18)
        lift = next(e["n"] for e in entries if e["kind"] == "line" and e["text"].endswith("Z-1G53G1"))
        assert hold < reset < lift
        x, _, z = board.mpos()
        assert z == pytest.approx(HOMED[2], abs=0.01) and x < HOMED[0] + 345
        assert board.counters().get("alarms", 0) == 0
    finally:
        driver.kill()
        driver.wait(5.0)
        board.close()


def test_lifecycle_from_unconfigured_to_active_and_back(operator: Callable[..., Operator]) -> None:
    """The services that ``ros2 lifecycle`` calls; topics and services of the driver are there in every state."""
    op = operator(autostart=False, enabled_at_start=True, feed_m_s=0.03)  # still moving for long when it is deactivated

    def change(label: str) -> bool:
        request = ChangeState.Request(transition=Transition(label=label))
        client = op.node.create_client(ChangeState, "serial_driver/change_state")
        op.until(client.service_is_ready)
        future = client.call_async(request)
        op.until(future.done)
        return bool(future.result().success)

    def lifecycle() -> str:
        return str(op.call("serial_driver/get_state", GetState).current_state.label)

    op.state("disconnected: not opened yet")
    assert (
        lifecycle() == "unconfigured"
        and op.call("home").message == "refused: the driver is disconnected: not opened yet"
    )
    op.go((0.1, 0.1, 0.0))
    op.until(lambda: op.results)
    assert op.results[-1].reason == "the driver is disconnected: not opened yet"
    assert op.board.log()[-1]["kind"] != "opened" and not change("activate"), "the port is not touched"

    assert change("configure") and lifecycle() == "inactive"
    op.state("unhomed")
    op.until(lambda: op.heartbeat.get_subscription_count() == 1)
    op.until(lambda: op.call("home").message == "refused: the driver is inactive")

    assert change("activate") and lifecycle() == "active"
    op.ready().go((0.1, 0.0, 0.0), (0.1, 0.0, 0.02), (0.151, 0.0, 0.02), (0.3, 0.0, 0.02), last_m_s=0.01)
    op.until(lambda: op.board.mpos()[0] > HOMED[0] + 150)
    assert change("deactivate") and lifecycle() == "inactive"
    op.state("stopped: deactivated")
    op.until(lambda: op.call("reset").success)
    op.state("disabled: inactive")
    where = op.board.mpos()
    assert where[0] < HOMED[0] + 290 and where[2] == pytest.approx(HOMED[2], abs=0.02), "held, and the stylus lifted"
    op.go((0.0, 0.0, 0.0))
    op.until(lambda: op.results and op.results[-1].outcome.value == "rejected")
    assert change("activate")
    op.state("idle")

    assert change("deactivate") and change("cleanup") and lifecycle() == "unconfigured"
    op.state("disconnected: not opened yet")
    assert not op.board.ask("state")["open"], "another program can have the port"
    assert change("configure") and change("activate")
    op.state("unhomed")
    assert change("shutdown") and lifecycle() == "finalized"
    op.state("disconnected")
    assert op.call("home").success is False


def test_a_flood_of_goals_moves_what_the_first_one_says(operator: Callable[..., Operator]) -> None:
    op = operator().ready()  # a quarter of a minute for the first one: it must outlast the flood
    since = op.board.log()[-1]["n"]
    op.go(*[(0.3 - 0.1 * (k % 2), 0.0, 0.0) for k in range(20)], frame_id="first")
    op.until(lambda: op.results)
    for number in range(10):
        for _ in range(5):
            op.go((0.0, 0.001 * number, 0.0), frame_id=f"flood {number}")
        op.until(lambda n=number: op.results[-1].goal_id == f"flood {n}")
    op.until(lambda: any(r.goal_id == "first" and r.outcome.value == "reached" for r in op.results), 60.0)
    others = [r for r in op.results if r.goal_id != "first"]
    assert len(others) >= 10 and {r.outcome.value for r in others} == {"rejected"}
    assert {r.reason for r in others} == {"the driver is moving"}
    moves = [e["text"] for e in op.board.lines(since) if e["text"].endswith("G53G1")]
    assert len(moves) == 20 and not any("Y" in text for text in moves)
    assert op.board.mpos() == pytest.approx((-159.0, -219.0, -1.0), abs=0.02)


def test_the_program_has_real_time_scheduling_or_says_why_not() -> None:
    code = "from icu_common.adapters.real_time import *; print([ask_for_real_time(DRIVER), is_real_time()])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    allowed = done.stdout.strip() == "['', True]"
    assert allowed or done.stdout.startswith("['real-time scheduling is not allowed ("), done
    assert allowed or done.stdout.strip().endswith("False]"), done


def test_a_transport_that_stalls_delays_no_stop(operator: Callable[..., Operator]) -> None:
    op = operator().ready()
    driver = op.ros.nodes[0]
    go_on = threading.Event()
    publish = driver._joint_states.publish

    def stall(message: JointState) -> None:
        go_on.wait(20.0)
        publish(message)

    driver._joint_states.publish = stall
    op.go((0.051, 0.0, 0.0), (0.35, 0.0, 0.0), last_m_s=SLOW_M_S)  # still moving for long when it is stopped
    op.until(lambda: op.board.mpos()[0] > HOMED[0] + 50)
    op.stop.publish(Empty())
    op.until(lambda: any(e["kind"] == "realtime" and e["byte"] == ord("!") for e in op.board.log()))
    op.until(lambda: op.board.ask("state")["state"] == "Idle")
    assert op.board.mpos()[0] < HOMED[0] + 349 and not any(text.startswith("stopped") for text in op.states)
    go_on.set()
    op.state("stopped: stop requested")
