"""Measure the serial driver against send-response senders on the same mock board: throughput and stop latency.

Throughput: 1,500 short moves through the real adapter to ``mock_grbl`` at 115,200 baud, with 0, 4 and 16 ms between the
board's answer and the host (a USB adapter's timer). Bytes are counted at the board, in its own time, from the first to
the last accepted line. The peers send the same lines on the same port: a minimal send-response loop, and
``pygrbl-streamer``, a published sender that also counts characters, with its default settings.

Stop latency: from the call of the service, the publication of the topic and the delivery of SIGTERM to ``!``, while a
path is being streamed and the cameras' part of the graph is running: simulated pair, corners, stereo, stylus,
recognition, page. The node runs in its own process. On the signal that process does not end, so that it can be measured
again. Two times are recorded: when the driver's write to the port has returned, and when the board has the byte.
Between them is the pseudo-terminal. An ordinary kernel thread transfers its bytes and competes with the cameras for the
processor; a serial port has no such thread. The node requests real-time scheduling as the program does. So do the two
processes that measure: the one that requests the stop, and the board that records the byte's arrival.
"""

from __future__ import annotations

import argparse
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from itertools import groupby
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np
import serial
from pygrbl_streamer import GrblStreamer

from gantry_driver.adapters.guard.places import guard_path
from gantry_driver.core.configuration.machine_config import DriverConfig
from gantry_driver.core.grbl.session import HOLD
from gantry_driver.core.grbl.trajectory_gcode import Waypoint, write_motion
from gantry_driver.core.wire.stages import make_script
from icu_common.adapters.real_time import DRIVER, ask_for_real_time
from icu_common.core.geometry.frames import JOINTS

sys.path.append(str(Path(__file__).resolve().parents[1]))
sys.path.append(str(Path(__file__).resolve().parents[2] / "tests"))
from nodes.grbl_board import GrblBoard, LinkRig
from rows import Row, bound, row, write

WIRE_BYTES_S = 11_520.0
MOVES, PEER_MOVES = 1500, 300
STEP_M = 0.000025
LATENCIES_MS = {0: 0.95, 4: 0.95, 16: 0.50}
"""Extra latency in ms, and the goal as a share of the wire's throughput."""
START = "-356,-216,-1.5"
"""Position of the axes at power-up: near the switches, so that homing is short."""


def path(count: int) -> list[tuple[float, float, float]]:
    return [(round(STEP_M * number, 6), 0.0, 0.0) for number in range(1, count + 1)]


def lines(count: int) -> list[str]:
    points = [Waypoint(positions_m=point) for point in path(count)]
    config = DriverConfig()
    motion = write_motion(JOINTS, points, (0.0, 0.0, 0.0), config)
    return make_script(motion, config, framed=True, frame_mm=None).lines(config)


@contextmanager
def board(latency_ms: float) -> Iterator[GrblBoard]:
    with tempfile.TemporaryDirectory() as folder:
        mock = GrblBoard(Path(folder), "--latency", str(latency_ms), f"--start={START}")
        try:
            yield mock
        finally:
            mock.close()


def rate(mock: GrblBoard, count: int) -> float:
    """Return bytes per second of the moves that the board accepted; raise if it has not accepted all of them."""
    moves = [entry for entry in mock.lines() if entry["text"].endswith("G53G1")]
    lost = mock.counters().get("bytes_lost_overflow", 0)
    if [entry["text"] for entry in moves] != [t for t in lines(count) if t.endswith("G53G1")] or lost:
        raise RuntimeError(f"the board took {len(moves)} of {count} moves and lost {lost} bytes")
    return sum(len(entry["text"]) + 1 for entry in moves[1:]) / (moves[-1]["t"] - moves[0]["t"])


def ours(latency_ms: float) -> tuple[float, float]:
    """Return bytes per second and this process's share of one core."""
    with board(latency_ms) as mock:
        rig = LinkRig(mock.port)
        try:
            rig.home(30.0)
            begin, busy = time.monotonic(), time.process_time()
            rig.go(*path(MOVES), slow_after=MOVES)
            rig.until(lambda: len(rig.results) == 2, 60.0)
            share = (time.process_time() - busy) / (time.monotonic() - begin)
            if rig.results[-1].outcome.value != "reached":
                raise RuntimeError(f"the path was {rig.results[-1]}")
        finally:
            rig.close()
        return rate(mock, MOVES), share


def send_response(latency_ms: float) -> float:
    """Send one line and wait for its answer, as most small senders do."""
    with board(latency_ms) as mock, serial.Serial(str(mock.port), 115200, timeout=30.0, exclusive=True) as port:
        port.read_until(b"unlock]\r\n")
        for text in ("$H", *lines(PEER_MOVES)):
            port.write(text.encode() + b"\n")
            if (answer := port.read_until(b"\n")) != b"ok\r\n":
                raise RuntimeError(f"{text} was answered by {answer!r}")
        return rate(mock, PEER_MOVES)


def published(latency_ms: float) -> float:
    with board(latency_ms) as mock, GrblStreamer(str(mock.port)) as sender:
        if not (sender.home(wait_idle=True) and sender.stream(lines(MOVES))):
            raise RuntimeError("pygrbl-streamer has not finished")
        return rate(mock, MOVES)


def throughput(repeats: int) -> list[Row]:
    rows: list[Row] = []
    for latency_ms, goal in LATENCIES_MS.items():
        measured = [(*ours(latency_ms), send_response(latency_ms), published(latency_ms)) for _ in range(repeats)]
        best, simple = max(m[0] for m in measured), max(m[2] for m in measured)
        what = f"{latency_ms} ms latency: 1500 moves"
        rows.append(bound(f"{what}, share of the wire's 11520 B/s", best / WIRE_BYTES_S, goal, at_least=True))
        rows.append(row(f"{what} [B/s]", best, simple, "send-response (own, pyserial)", 1.0, higher_is_better=True))
        other = max(m[3] for m in measured)
        rows.append(row(f"{what} [B/s]", best, other, "pygrbl-streamer", 0.95, higher_is_better=True))
        rows.append(bound(f"{what}: share of one core", min(m[1] for m in measured), 0.5))
    return rows


# --- stop ---------------------------------------------------------------------------------------------------------


def ordinary() -> None:
    os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))


@contextmanager
def camera_graph() -> Iterator[None]:
    """Run the graph's cameras and perception as ``make demo`` does, without the programs that move the machine."""
    root = Path(__file__).resolve().parents[2]
    with tempfile.TemporaryDirectory() as folder:
        command = [
            str(root / "ros2_ws/install/icu_bringup/lib/icu_bringup/bring_up"),
            "--config",
            str(root / "config"),
            "--real-time",
        ]
        command += ["--state", f"{folder}/state", "--run-dir", f"{folder}/run", "--set", "ui_bridge.port=0"]
        for program in ("serial_driver", "gantry_controller", "hand_eye"):
            command += ["--without", program]
        with Path(folder, "log").open("wb") as log:
            process = subprocess.Popen(command, stdout=log, stderr=subprocess.STDOUT, preexec_fn=ordinary)
        try:
            yield
            if process.poll() is not None:
                raise RuntimeError(f"the camera graph has ended: {Path(folder, 'log').read_text()[-2000:]}")
        finally:
            process.send_signal(signal.SIGINT)
            process.wait(30.0)


def run_guard(port: str, holds: str) -> int:
    """Run the guard as the node starts it, and record each hold that it writes."""
    from gantry_driver.cli import gantry_guard

    def write_and_note(fd: int, data: bytes) -> int:
        written = write_bytes(fd, data)
        if data == HOLD:
            write_bytes(notes, f"{time.monotonic()}\n".encode())
        return written

    notes, write_bytes = os.open(holds, os.O_WRONLY), os.write
    os.write = write_and_note
    sys.argv = ["gantry_guard", "--port", port]
    return gantry_guard.main()


def run_node(port: str) -> int:
    """Run the driver's node as in the graph, except that a signal does not end it."""
    import rclpy
    from rclpy.experimental import EventsExecutor
    from rclpy.parameter import Parameter
    from rclpy.signals import SignalHandlerOptions

    from gantry_driver.nodes.serial_driver_node import make_node
    from icu_common.nodes.runtime import prepare_transport

    ask_for_real_time(DRIVER)
    prepare_transport(shared_memory=False)
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)

    def note(number: int, frame: FrameType | None) -> None:
        """Do nothing: the node receives the signal by its wake-up descriptor."""

    signal.signal(signal.SIGTERM, note)
    values = {"port": port, "enabled_at_start": True, "trajectory_programs": "*"}
    node = make_node(parameter_overrides=[Parameter(name, value=value) for name, value in values.items()])
    executor = EventsExecutor()
    executor.add_node(node)
    parent = os.getppid()
    while os.getppid() == parent:
        executor.spin_once(timeout_sec=0.1)
    node.close()
    return 0


def stops(count: int) -> list[Row]:
    """Return p50 and p99 of each path of a stop, next to a running camera graph."""
    import rclpy
    from rclpy.experimental import EventsExecutor
    from sensor_msgs.msg import PointCloud2
    from std_msgs.msg import Empty, Header, String
    from std_srvs.srv import Trigger
    from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

    from icu_common.nodes.qos import COMMAND, LATCHED, RESULTS, SENSOR
    from icu_common.nodes.runtime import prepare_transport

    scheduling = "normal" if ask_for_real_time(DRIVER) else "real-time"
    prepare_transport()
    rclpy.init()
    node = rclpy.create_node("stop_bench")
    executor = EventsExecutor()
    executor.add_node(node)
    states: list[str] = [""]
    node.create_subscription(String, "driver_state", lambda message: states.append(message.data), LATCHED)
    heartbeat = node.create_publisher(Header, "heartbeat", SENSOR)
    node.create_timer(0.1, lambda: heartbeat.publish(Header(stamp=node.get_clock().now().to_msg())))
    topic = node.create_publisher(Empty, "stop_request", RESULTS)
    trajectory = node.create_publisher(JointTrajectory, "trajectory", COMMAND)
    seen: list[float] = []
    corners = "/stereo/left/corners"
    node.create_subscription(PointCloud2, corners, lambda message: seen.append(time.monotonic()), SENSOR)
    services = {name: node.create_client(Trigger, name) for name in ("home", "stop", "reset")}

    def until(condition: Callable[[], Any], within_s: float = 30.0) -> None:
        end = time.monotonic() + within_s
        while not condition():
            if time.monotonic() > end:
                said = [name for name, _ in groupby(states)][-12:]
                raise RuntimeError(f"not within {within_s} s: the driver said {said}")
            executor.spin_once(timeout_sec=0.01)

    def call(name: str) -> None:
        future = services[name].call_async(Trigger.Request())
        until(future.done)

    with camera_graph(), tempfile.NamedTemporaryFile("r") as holds, board(0) as mock:
        ask_for_real_time(DRIVER, mock.process.pid)
        until(lambda: len(seen) > 20, 60.0)
        guard = subprocess.Popen([sys.executable, __file__, "--guard", str(mock.port), holds.name])
        until(guard_path(str(mock.port)).exists)
        child = subprocess.Popen([sys.executable, __file__, "--node", str(mock.port)], stderr=subprocess.DEVNULL)
        try:
            until(lambda: all(service.service_is_ready() for service in services.values()))
            until(lambda: topic.get_subscription_count() and trajectory.get_subscription_count())
            until(lambda: states[-1] == "unhomed")
            while states[-1] != "idle":
                call("home")
                until(lambda: states[-1] in ("idle", "unhomed"))
            ways: dict[str, Callable[[], Any]] = {
                "service": lambda: services["stop"].call_async(Trigger.Request()),
                "topic": lambda: topic.publish(Empty()),
                "SIGTERM": lambda: os.kill(child.pid, signal.SIGTERM),
            }
            asked: dict[str, list[float]] = {name: [] for name in ways}
            (offset_s, clock_width_s), rng, far = mock.clock_s(), np.random.default_rng(1), False
            seen.clear()
            began = time.monotonic()
            for turn in range(count * len(ways)):
                name = list(ways)[turn % len(ways)]
                far = not far
                message = JointTrajectory(joint_names=list(JOINTS[:1]))
                ends = np.linspace(0.0, 0.35, 300) if far else np.linspace(0.35, 0.0, 300)
                message.points = [JointTrajectoryPoint(positions=[float(x)]) for x in ends]
                trajectory.publish(message)
                until(lambda: states[-1] == "moving")
                pause_until = time.monotonic() + rng.uniform(0.02, 0.12)
                until(lambda moment=pause_until: time.monotonic() > moment)
                asked[name].append(time.monotonic())
                ways[name]()
                until(lambda: states[-1].startswith("stopped"))
                while states[-1].startswith("stopped"):
                    # Real-time processes that poll without a pause use up the kernel's real-time share.
                    asked_at = time.monotonic()
                    call("reset")
                    until(lambda at=asked_at: states[-1] == "idle" or time.monotonic() > at + 0.05)
            pictures = len(seen) / (time.monotonic() - began)
            written = [float(text) for text in holds]
            heard = [t + offset_s for t in mock.holds()]
        finally:
            for process in (child, guard):
                process.kill()
                process.wait()
    node.destroy_node()
    rclpy.shutdown()
    if pictures < 1.0:
        raise RuntimeError(f"{pictures:.1f} pictures a second came through the camera graph: it did not run")
    load = os.getloadavg()[0]
    print(f"beside a camera graph with {pictures:.1f} pictures a second, {scheduling} scheduling, load {load:.1f}")
    rows = []
    for name, moments in asked.items():
        places = {"the port": (written, 0.0), "the board, by a pseudo-terminal": (heard, clock_width_s)}
        for place, (times, width_s) in places.items():
            took = [1e3 * (min(t for t in times if t > moment - width_s) - moment) for moment in moments]
            p50, p99 = np.percentile(took, [50, 99])
            print(f"stop by {name} to the byte at {place}: {len(took)} stops, longest {max(took):.2f} ms")
            rows.append(bound(f"stop by {name} to {place}, p50 [ms]", float(p50), 10.0))
            rows.append(bound(f"stop by {name} to {place}, p99 [ms]", float(p99), 10.0))
    return rows


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--node", metavar="PORT", help="run only the driver's node, for the stops")
    parser.add_argument("--guard", nargs=2, metavar=("PORT", "FILE"), help="run only its guard, which notes its holds")
    parser.add_argument("--repeats", type=int, default=3, help="turns of each throughput, the best counts (3)")
    parser.add_argument("--stops", type=int, default=100, help="stops by each way (100)")
    parser.add_argument("--only", choices=("throughput", "stops"), help="half of it")
    given = parser.parse_args()
    if given.node:
        return run_node(given.node)
    if given.guard:
        return run_guard(*given.guard)
    rows = throughput(given.repeats) if given.only != "stops" else []
    rows += stops(given.stops) if given.only != "throughput" else []
    # Both need the processor within 1 to 2 ms: on a busy machine they measure its load.
    busy = f"load {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores"
    write("serial_driver", rows, title=f"serial driver: throughput and stop latency ({busy})")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
