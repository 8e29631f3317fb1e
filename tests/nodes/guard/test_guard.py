"""The guard lifts the stylus when a node ends, hangs or floods in contact, and when a guard ends."""

from __future__ import annotations

import os
import signal
import struct
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from nodes.guard_rig import HOMED, BringUpRig, GuardRig, children
from rclpy.serialization import serialize_message
from std_srvs.srv import SetBool
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from gantry_driver.core.states.stylus_state import STYLUS_DOWN_M
from icu_common.adapters.direct_stop.line import send_stop, stop_path
from icu_common.core.geometry.frames import JOINTS

pytestmark = [pytest.mark.long, pytest.mark.alone]  # the board and the driver keep real time

HELD_S, LIFTS_S = 1.0, 2.0
"""Limits in seconds on a busy computer with two cores, by the board's own record; benchmarks/driver/bench_guard.py has
those of a free one. The test reads the board's clock after the fault, because it may be delayed between the two."""
PRESSING_S = 2.0
"""Maximum seconds of contact after the cause, whatever it is."""

Start = Callable[..., GuardRig]


@pytest.fixture
def start(ros: Any, tmp_path: Path) -> Iterator[Start]:
    rigs: list[GuardRig] = []

    def make(*board: str, **parameters: Any) -> GuardRig:
        rigs.append(GuardRig(ros, tmp_path, *board, **parameters))
        rigs[-1].op.ready()
        return rigs[-1]

    yield make
    for rig in rigs:
        rig.close()


@pytest.mark.parametrize("during", ["press", "drag"])
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP])
def test_a_node_that_ends_or_hangs_in_contact_is_held_and_lifted(
    start: Start, during: str, number: signal.Signals
) -> None:
    rig = start()
    getattr(rig, during)()
    since = rig.entry()
    rig.node.send_signal(number)
    begun_s = rig.now_s()
    rig.until_lifted()
    assert rig.held_s(since) - begun_s < HELD_S and rig.lift_s(since) - begun_s < LIFTS_S
    x, y, z = rig.board.mpos()
    assert z == pytest.approx(HOMED[2], abs=0.06) and y == pytest.approx(HOMED[1] + 50, abs=0.02)
    assert x < HOMED[0] + 290, "it stopped before the end of its path"
    assert rig.board.counters().get("alarms", 0) == 0


def test_the_successor_of_a_node_publishes_the_state(start: Start) -> None:
    rig = start()
    rig.drag()
    rig.node.kill()
    rig.node.wait(5.0)
    rig.until_lifted()
    rig.op.states.clear()
    rig.start()
    rig.op.state("stopped: the driver's node has ended")
    rig.op.until(lambda: rig.op.call("reset").success)
    rig.op.state("disabled")  # the machine is still homed; a person enables it
    assert rig.op.call("enable", SetBool, data=True).success
    rig.op.state("idle")
    rig.op.go((0.1, 0.1, 0.0))
    rig.op.until(lambda: rig.op.results[-1].outcome.value == "reached")
    assert rig.board.mpos()[:2] == pytest.approx((HOMED[0] + 100, HOMED[1] + 100), abs=0.02)


def test_a_node_that_goes_on_after_a_stop_knows_of_it(start: Start) -> None:
    rig = start()
    rig.press()
    rig.node.send_signal(signal.SIGSTOP)
    rig.until_lifted()
    rig.node.send_signal(signal.SIGCONT)
    rig.op.state("stopped: the driver's node has been silent for 0.")


def test_a_node_that_ends_at_rest_leaves_the_machine_as_it_is(start: Start) -> None:
    rig = start()
    rig.op.go((0.1, 0.1, 0.0))
    rig.op.until(lambda: rig.op.results and rig.op.results[-1].outcome.value == "reached")
    since = rig.entry()
    rig.node.kill()
    rig.node.wait(5.0)
    rig.op.states.clear()
    rig.start()
    rig.op.state("disabled")
    assert not [e for e in rig.board.log(since) if e["kind"] == "realtime" and e["byte"] in (ord("!"), 0x18)]
    assert len(rig.guards()) == 1


@pytest.mark.parametrize("board", ["is reset by the edge of DTR", "--keep-running"])
def test_a_guard_that_is_killed_in_contact_is_started_again_and_lifts(start: Start, board: str) -> None:
    rig = start(*([board] if board.startswith("--") else []))
    rig.press()
    rig.op.states.clear()
    (first,) = rig.guards()
    begun_s = rig.now_s()
    os.kill(first, signal.SIGKILL)
    assert rig.until_lifted() - begun_s < PRESSING_S
    assert any(text.startswith("disconnected: the guard has ended") for text in rig.op.states)
    rig.op.state("stopped: the stylus stayed down while no driver was connected")
    assert rig.guards() not in ([], [first])


@pytest.fixture
def supervised(ros: Any, tmp_path: Path) -> Iterator[BringUpRig]:
    rig = BringUpRig(ros, tmp_path)
    try:
        rig.op.ready()
        yield rig
    finally:
        rig.close()


@pytest.mark.parametrize("first", ["guard", "node"])
def test_a_guard_and_a_node_that_are_killed_together_leave_the_stylus_down_for_less_than_two_seconds(
    supervised: BringUpRig, first: str
) -> None:
    rig = supervised
    rig.press()
    (guard,) = rig.guards()
    x, y, _ = rig.board.mpos()
    rig.op.states.clear()
    since, begun_s = rig.entry(), rig.now_s()
    if first == "node":
        rig.kill_node()
        rig.op.until(lambda: children(rig.node.pid, "gantry_guard"))  # it waits for the end of the first guard
    os.kill(guard, signal.SIGKILL)
    if first == "guard":
        rig.kill_node()
    # A guard that is killed at the end of its lift leaves less than what counts as extended.
    assert rig.until_lifted(up_mm=1000.0 * STYLUS_DOWN_M) - begun_s < PRESSING_S
    rig.op.until(lambda: any(text.startswith(("stopped: ", "unhomed")) for text in rig.op.states))
    assert rig.board.mpos()[:2] == pytest.approx((x, y), abs=0.02), "nothing but the stylus has moved"
    moves = {e["text"] for e in rig.board.log(since) if e["kind"] == "line" and e["text"].endswith("G1")}
    assert moves == {"F1800Z-1G53G1"}


def test_a_guard_and_a_node_that_are_killed_together_in_travel_are_held(supervised: BringUpRig) -> None:
    rig = supervised
    rig.op.go((0.05, 0.05, 0.0), (0.3, 0.05, 0.0), last_m_s=0.05)
    rig.op.until(lambda: rig.board.mpos()[0] > HOMED[0] + 60.0)
    since, begun_s = rig.entry(), rig.now_s()
    rig.op.states.clear()
    os.kill(rig.guards()[0], signal.SIGKILL)
    rig.kill_node()
    rig.op.state("unhomed")
    assert rig.held_s(since) - begun_s < HELD_S
    assert rig.board.mpos()[0] < HOMED[0] + 290, "it stopped before the end of its path"


def test_a_goal_under_way_is_aborted_when_the_guard_ends(start: Start) -> None:
    rig = start("--keep-running")
    rig.drag()
    os.kill(rig.guards()[0], signal.SIGKILL)
    rig.op.until(lambda: rig.op.results[-1].outcome.value == "aborted")
    assert rig.op.results[-1].reason == "link lost: the guard has ended"
    rig.until_lifted()


@pytest.mark.parametrize("hung", [False, True])
def test_a_stop_reaches_the_guard_past_the_graph(start: Start, hung: bool) -> None:
    rig = start(node_silence_s=0.5)
    rig.press()
    if hung:
        rig.node.send_signal(signal.SIGSTOP)
    path = stop_path(rig.ros.context.get_domain_id(), "/stop_request")
    assert send_stop(path, "the page's STOP")
    rig.until_lifted()
    rig.node.send_signal(signal.SIGCONT)
    rig.op.state("stopped: the page's STOP")


def test_large_trajectories_from_another_process_delay_no_stop(start: Start) -> None:
    rig = start()
    rig.press()
    source = f"""
import time, rclpy
from rclpy.event_handler import PublisherEventCallbacks
from trajectory_msgs.msg import JointTrajectory
from icu_common.nodes.qos import COMMAND
rclpy.init()
node = rclpy.create_node("foreign")
matched = rclpy.task.Future()
events = PublisherEventCallbacks(matched=matched.set_result)
publisher = node.create_publisher(JointTrajectory, "trajectory", COMMAND, event_callbacks=events)
rclpy.spin_until_future_complete(node, matched, timeout_sec=20.0)
assert matched.done(), "the driver does not subscribe"
data = open({str(rig.folder / "large")!r}, "rb").read()
for _ in range(40):
    publisher.publish(data)
    print("sent", flush=True)
    time.sleep(0.05)  # the stimulus: 20 of them a second
"""
    point = JointTrajectoryPoint(positions=[0.1, 0.1, 0.0])
    short = bytes(serialize_message(JointTrajectory(joint_names=list(JOINTS), points=[point, point])))
    (rig.folder / "large").write_bytes(short[: -2 * 64 - 4] + struct.pack("<I", 200_000) + 200_000 * short[-64:])
    environment = {**os.environ, "ROS_DOMAIN_ID": str(rig.ros.context.get_domain_id())}
    since = rig.entry()  # the foreign publisher may stop the machine before its first trajectory
    with subprocess.Popen([sys.executable, "-c", source], env=environment, stdout=subprocess.PIPE) as foreign:
        try:
            assert foreign.stdout is not None and foreign.stdout.readline() == b"sent\n"
            assert rig.op.call("stop").success
            begun_s = rig.now_s()  # the service answers after the guard has received the stop
            rig.until_lifted()
            assert rig.held_s(since) - begun_s < HELD_S and rig.lift_s(since) - begun_s < LIFTS_S
        finally:
            foreign.kill()
    rig.op.state("stopped: ")  # by the service, or because two programs publish trajectories


def test_a_second_driver_of_the_port_says_that_it_is_in_use(start: Start) -> None:
    rig = start()
    first = rig.node
    rig.op.states.clear()
    rig.start()
    rig.op.state(f"disconnected: {rig.board.port}: in use by another program, as while a driver runs")
    first.terminate()
    assert first.wait(20.0) == 0
    rig.op.state("unhomed")


def test_the_guard_loads_neither_ros_nor_numpy() -> None:
    modules = "gantry_driver.cli.gantry_guard, gantry_driver.adapters.guard.server"
    code = f"import sys, {modules}; print(sorted({{name.partition('.')[0] for name in sys.modules}}))"
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    loaded = set(eval(found)) - sys.stdlib_module_names
    start_up = subprocess.run(
        [sys.executable, "-c", "import sys; print(sorted({name.partition('.')[0] for name in sys.modules}))"],
        capture_output=True,
        text=True,
        check=True,
    )
    assert loaded - set(eval(start_up.stdout)) == {"gantry_driver", "icu_common", "serial"}


def test_a_running_guard_has_loaded_neither_ros_nor_numpy(start: Start) -> None:
    rig = start()
    (guard,) = rig.guards()
    maps = Path(f"/proc/{guard}/maps").read_text()
    assert "libpython" in maps or "python" in maps
    assert not [word for word in ("numpy", "rclpy", "librcl", "fastdds", "fastrtps") if word in maps]


NOTE_LEVELS = """
import fcntl, os, struct, sys, termios

ioctl = fcntl.ioctl
names = {termios.TIOCM_DTR: "dtr", termios.TIOCM_RTS: "rts"}

def note(fd, request, argument=0, *more):
    if request not in (termios.TIOCMBIS, termios.TIOCMBIC):
        return ioctl(fd, request, argument, *more)
    name = names[struct.unpack("I", argument)[0]]
    level, program = request == termios.TIOCMBIS, " ".join(sys.orig_argv)
    with open(os.environ["LEVELS_FILE"], "a") as file:
        print(f"{name}={level} {os.readlink(f'/proc/self/fd/{fd}')} {program}", file=file)
    return argument

fcntl.ioctl = note
"""
"""Module that Python loads at its start: it notes which levels a program sets, because a pseudo-terminal has none."""


@pytest.mark.parametrize(("dtr", "rts"), [(True, True), (False, True), (True, False)])
def test_the_guard_opens_the_port_with_the_levels_of_the_nodes_settings(
    start: Start, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, dtr: bool, rts: bool
) -> None:
    levels = tmp_path / "levels"
    (tmp_path / "early").mkdir()
    (tmp_path / "early" / "sitecustomize.py").write_text(NOTE_LEVELS)
    monkeypatch.setenv("LEVELS_FILE", str(levels))
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(tmp_path / "early"), os.environ.get("PYTHONPATH", "")]))
    rig = start(dtr=str(dtr).lower(), rts=str(rts).lower())
    noted = levels.read_text().splitlines()
    assert all("gantry_guard" in line and os.path.realpath(rig.board.port) in line for line in noted), noted
    assert [line.split()[0] for line in noted] == [f"dtr={dtr}", f"rts={rts}"]
