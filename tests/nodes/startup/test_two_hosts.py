"""Robot and operator on two hosts, here two network namespaces: found by peer or server, link cut and restored."""

from __future__ import annotations

import hashlib
import json
import os
import queue
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from support.deadlines import wait_until
from support.line_socket import BoardSocket
from support.ros_rig import domain_of_worker

pytestmark = pytest.mark.long

ROOT = Path(__file__).resolve().parents[3]
ROBOT, DESK = "198.51.100.1", "198.51.100.2"  # addresses for documentation (RFC 5737)
LEASE_S = 10.0
"""Seconds without a sign after which DDS forgets a participant (fastdds_profile.xml)."""


def ip(*words: str) -> str:
    return subprocess.run(["ip", *words], check=True, capture_output=True, text=True).stdout


class TwoHosts:
    """Two network namespaces joined by a cable, each with the shared memory and machine id of its own."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        mark = f"icu{os.getpid() % 100000}"
        self.robot, self.desk = f"{mark}r", f"{mark}d"
        self.processes: list[subprocess.Popen[bytes]] = []
        try:
            for name in (self.robot, self.desk):
                ip("netns", "add", name)
                ip("-n", name, "link", "set", "lo", "up")
            ip("link", "add", f"{mark}a", "netns", self.robot, "type", "veth", "peer", f"{mark}b", "netns", self.desk)
            self.cable = f"{mark}a"
            for name, end, address in ((self.robot, f"{mark}a", ROBOT), (self.desk, f"{mark}b", DESK)):
                ip("-n", name, "address", "add", f"{address}/24", "dev", end)
                ip("-n", name, "link", "set", end, "up")
            for name, end in ((self.robot, f"{mark}a"), (self.desk, f"{mark}b")):
                self._wait_for_cable(name, end)
        except (OSError, subprocess.CalledProcessError) as error:
            self.close()
            pytest.skip(f"no network namespaces here: {getattr(error, 'stderr', '') or error}")

    @staticmethod
    def _wait_for_cable(name: str, end: str) -> None:
        # Fast DDS uses the interfaces that it finds running at its start.
        up = lambda: ip("-n", name, "-brief", "link", "show", "dev", end).split()[1] == "UP"  # noqa: E731
        wait_until(up, "the cable is up", 5.0)

    def start(self, host: str, *command: str, environment: dict[str, str], **options: Any) -> subprocess.Popen[bytes]:
        # Fast DDS takes two hosts with one machine id for the same, and would use shared memory between them.
        own = "mount -t tmpfs tmpfs /dev/shm && "
        if Path("/etc/machine-id").exists():
            identity = self._folder / f"{host}.id"
            identity.write_text(hashlib.md5(host.encode()).hexdigest() + "\n")
            own += f"mount --bind {identity} /etc/machine-id && "
        process = subprocess.Popen(
            ["ip", "netns", "exec", host, "sh", "-c", own + 'exec "$@"', "sh", *command], env=environment, **options
        )
        self.processes.append(process)
        return process

    def ready_to_cut(self) -> Callable[[], None]:
        """Return what cuts the link at once: a program that starts only then may take long on a busy machine."""
        knife = subprocess.Popen(["ip", "-n", self.robot, "-batch", "-"], stdin=subprocess.PIPE)
        self.processes.append(knife)

        def cut() -> None:
            assert knife.stdin is not None
            knife.stdin.write(f"link set {self.cable} down\n".encode())
            knife.stdin.close()

        return cut

    def join(self) -> None:
        ip("-n", self.robot, "link", "set", self.cable, "up")

    def close(self) -> None:
        for process in reversed(self.processes):
            if process.poll() is None:
                process.send_signal(signal.SIGINT)
            try:
                process.wait(20.0)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
        for name in (self.robot, self.desk):
            subprocess.run(["ip", "netns", "delete", name], check=False, capture_output=True)


class Desk:
    """The operator's process: what it said, and waiting for what it will say."""

    def __init__(self, process: subprocess.Popen[bytes], robot_log: Path) -> None:
        self.process, self.robot_log = process, robot_log
        self.heard: list[dict[str, Any]] = []
        self._lines: queue.SimpleQueue[dict[str, Any]] = queue.SimpleQueue()
        threading.Thread(target=self._read, daemon=True).start()

    def _read(self) -> None:
        assert self.process.stdout is not None
        for line in self.process.stdout:
            self._lines.put(json.loads(line))

    def do(self, **order: Any) -> None:
        assert self.process.stdin is not None
        self.process.stdin.write(json.dumps(order).encode() + b"\n")
        self.process.stdin.flush()

    def until(self, condition: Callable[[dict[str, Any]], bool], within_s: float) -> dict[str, Any]:
        """Return the next line that the condition holds for."""
        deadline = time.monotonic() + within_s
        while True:
            try:
                line = self._lines.get(timeout=max(deadline - time.monotonic(), 0.01))
            except queue.Empty:
                pytest.fail(f"not within {within_s:g} s; heard {self.heard[-8:]}; {self.robot_log.read_text()[-2000:]}")
            self.heard.append(line)
            if condition(line):
                return line

    def sees(self, state: str, within_s: float) -> None:
        """Wait until the driver's newest state begins so."""
        newest = [line["state"] for line in self.heard if "state" in line][-1:]
        if not (newest and newest[0].startswith(state)):
            self.until(lambda line: str(line.get("state", "")).startswith(state), within_s)

    def ask(self, name: str, within_s: float = 20.0, **order: Any) -> None:
        """Call a service until it accepts: discovery, a heartbeat or a lift may still be in progress."""

        def accepted() -> bool:
            self.do(**(order or {"call": name}))
            return bool(self.until(lambda line: line.get("answer") == name, within_s)["success"])

        wait_until(accepted, f"{name} is accepted", within_s, lambda: self.heard[-5:])

    def homes(self) -> None:
        """Home; once more where the desk was held up: it was an operator who has gone then, as it should be."""
        ends = ("idle", "stopped: operator's heartbeat lost")
        for _ in range(3):
            self.ask("gantry/home")
            if self.until(lambda line: str(line.get("state", "")).startswith(ends), 30.0)["state"] == "idle":
                return
            self.ask("gantry/reset", 30.0)
        pytest.fail(f"it does not home: {self.heard[-8:]}")

    def go(self, x_m: float, y_m: float) -> str:
        """Send a goal and return its id."""
        self.do(go=[x_m, y_m])
        return str(self.until(lambda line: "sent" in line, 5.0)["sent"])

    def goes(self, x_m: float, y_m: float, within_s: float = 20.0) -> None:
        """Go there; the controller may get the heartbeat and the end of homing later than the desk."""
        early = ("rejected no operator heartbeat", "rejected the driver is 'homing'; expected 'idle'")

        def reached() -> bool:
            end = self.ends(self.go(x_m, y_m))
            assert end == "reached" or end.startswith(early), end
            return end == "reached"

        wait_until(reached, "the goal is reached", within_s)

    def ends(self, goal: str) -> str:
        """Return how a goal ended."""
        final = self.until(lambda line: line.get("id") == goal and line["result"] != "accepted", 30.0)
        return f"{final['result']} {final['reason']}".strip()


@pytest.fixture
def hosts(tmp_path: Path) -> Iterator[TwoHosts]:
    if shutil.which("ip") is None:
        pytest.skip("no ip program (Debian and Ubuntu: apt install iproute2)")
    if os.geteuid() != 0:
        pytest.skip("network namespaces need root")
    made = TwoHosts(tmp_path)
    try:
        yield made
    finally:
        made.close()


def environments(found_by: str, folder: Path) -> tuple[dict[str, str], dict[str, str]]:
    """Return the robot's and the desk's environment."""
    shared = {**os.environ, "ROS_DOMAIN_ID": str(domain_of_worker()), "ROS_LOG_DIR": str(folder / "log")}
    for name in ("ROS_AUTOMATIC_DISCOVERY_RANGE", "FASTRTPS_DEFAULT_PROFILES_FILE", "ROS_STATIC_PEERS"):
        shared.pop(name, None)
    if found_by == "server":
        shared["ROS_DISCOVERY_SERVER"] = f"{ROBOT}:11811"
        return shared, shared
    return {**shared, "ROS_STATIC_PEERS": DESK}, {**shared, "ROS_STATIC_PEERS": ROBOT}


@pytest.mark.timeout(150)
@pytest.mark.parametrize("found_by", ["peer", "server"])
def test_the_link_is_cut_and_restored(found_by: str, hosts: TwoHosts, tmp_path: Path) -> None:
    on_robot, on_desk = environments(found_by, tmp_path)
    if found_by == "server":
        # `fastdds discovery` is a script that starts this one and does not end it.
        places = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
        if (program := shutil.which("fast-discovery-server", path=places)) is None:
            pytest.skip("no fast-discovery-server program")
        server_command = [program, "-i", "0", "-l", ROBOT, "-p", "11811"]
        hosts.start(hosts.robot, *server_command, environment=on_robot, stdout=subprocess.DEVNULL)
    log = tmp_path / "robot.log"
    bring_up = ROOT / "ros2_ws/install/icu_bringup/lib/icu_bringup/bring_up"
    parts = [text for name in ("mock_grbl", "serial_driver", "gantry_controller") for text in ("--only", name)]
    for setting in ("goal_max_age_s=5.0", "joints_timeout_s=5.0"):  # on a busy machine
        parts += ["--set", f"gantry_controller.{setting}"]
    parts += ["--set", "serial_driver.goal_max_age_s=5.0", "--set", "serial_driver.status_timeout_s=10.0"]
    folders = ["--state", str(tmp_path / "state"), "--run-dir", str(tmp_path / "run"), "--config", str(ROOT / "config")]
    with log.open("wb") as out:
        hosts.start(
            hosts.robot,
            str(bring_up),
            "--profile",
            "test",
            "--verbose",
            *parts,
            *folders,
            environment=on_robot,
            stdout=out,
            stderr=subprocess.STDOUT,
        )
    script = str(Path(__file__).with_name("remote_operator.py"))
    desk = Desk(
        hosts.start(
            hosts.desk, sys.executable, script, environment=on_desk, stdin=subprocess.PIPE, stdout=subprocess.PIPE
        ),
        log,
    )
    board = BoardSocket(tmp_path / "run" / "board")
    try:
        cut = hosts.ready_to_cut()
        desk.until(lambda line: line.get("listeners") == 2, 60.0)  # driver and controller
        desk.ask("gantry/enable", enable=True)
        desk.homes()
        desk.goes(0.01, 0.01)
        start_mm = board.mpos()

        desk.go(0.34, 0.2)
        desk.until(lambda line: line.get("state") == "moving", 10.0)
        before = board.holds()
        cut_s = time.monotonic()
        cut()
        holds = wait_until(lambda: board.holds()[len(before) :], "the driver holds", 20.0)
        # By the board's clock: it does not matter when this process gets it.
        held_s = holds[0] + board.clock_s()[0] - cut_s
        print(f"{found_by}: hold {1e3 * held_s:.0f} ms after the cut")
        assert held_s < 1.0
        if found_by == "peer":  # a server does not inform its clients that another one has ended
            desk.until(lambda line: line.get("listeners") == 0, 4 * LEASE_S)
        resting_mm = board.at_rest()
        assert start_mm[0] < resting_mm[0] < start_mm[0] + 330.0, "it was held on its way"

        hosts.join()
        desk.sees("stopped: operator's heartbeat lost", 30.0)
        desk.ask("gantry/reset", 30.0)
        desk.sees("idle", 10.0)
        assert board.mpos() == resting_mm, "nothing resumes by itself"
        desk.goes(0.02, 0.01)
        x_mm, y_mm, _ = board.mpos()
        assert (x_mm - start_mm[0], y_mm - start_mm[1]) == pytest.approx((10.0, 0.0), abs=0.05)
    finally:
        board.close()
