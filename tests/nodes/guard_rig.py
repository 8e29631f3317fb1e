"""A driver's node in a process of its own, its guard, and the board's own record of holds and lifts."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import yaml
from nodes.driver_operator import HOMED, NO_PANEL, PATIENCE, Operator
from nodes.grbl_board import GrblBoard

from gantry_driver.adapters.guard.places import guard_path

DOWN_M = 0.02
UP_MM = 0.05


INSTALL = Path(__file__).resolve().parents[2] / "ros2_ws" / "install"


def guards_of(port: Path) -> list[int]:
    """Return the process numbers of a port's guards; one that only waits for another one's end is none."""
    wanted, found = {str(guard_path(str(port))), str(port)}, []
    for process in Path("/proc").glob("[0-9]*"):
        try:
            words = (process / "cmdline").read_bytes().decode(errors="replace").split("\0")
            waits = "--recover" in words and not _has_open(process, port)
        except OSError:
            continue
        if "gantry_guard" in "".join(words[:3]) and wanted & {*words} and not waits:
            found.append(int(process.name))
    return found


def _has_open(process: Path, port: Path) -> bool:
    return any(os.readlink(fd) == str(port.resolve()) for fd in (process / "fd").iterdir())  # noqa: PTH115


def children(parent: int, word: str) -> list[int]:
    """Return the child processes whose command line contains a word."""
    found = []
    for child in Path(f"/proc/{parent}/task/{parent}/children").read_text().split():
        try:
            line = Path(f"/proc/{child}/cmdline").read_bytes().decode(errors="replace")
        except OSError:
            continue
        if word in line:
            found.append(int(child))
    return found


class GuardRig:
    """One board, one node, one guard."""

    def __init__(self, ros: Any, folder: Path, *board: str, **parameters: Any) -> None:
        self.ros, self.folder = ros, folder
        self.board = GrblBoard(folder, *board)
        fixed = {"port": self.board.port, "trajectory_programs": "operator", **PATIENCE, **NO_PANEL}
        self.parameters = {**fixed, **parameters}
        self.nodes: list[subprocess.Popen[bytes]] = []
        self.node = self.start()
        self.op = Operator(ros, self.board)

    def start(self) -> subprocess.Popen[bytes]:
        """Start another node; running ones stay."""
        command = [sys.executable, "-m", "gantry_driver.nodes.serial_driver_node", "--ros-args"]
        for name, value in self.parameters.items():
            command += ["-p", f"{name}:={value}"]
        environment = {**os.environ, "ROS_DOMAIN_ID": str(self.ros.context.get_domain_id())}
        with (self.folder / f"node{len(self.nodes)}.log").open("wb") as log:
            self.node = subprocess.Popen(command, env=environment, stdout=log, stderr=log)
        self.nodes.append(self.node)
        return self.node

    def guards(self) -> list[int]:
        """Return the process numbers of the port's guards."""
        return guards_of(self.board.port)

    def press(self) -> None:
        """Rest with the stylus extended."""
        self.op.go((0.1, 0.05, 0.0), (0.1, 0.05, DOWN_M), frame_id="press")
        self.op.until(lambda: self.op.results and self.op.results[-1].outcome.value == "reached")
        assert self.z_mm() < HOMED[2] - 1000.0 * DOWN_M + 0.1

    def drag(self) -> None:
        """Move sideways with the stylus extended, slowly, so that the motion takes seconds."""
        self.op.go((0.05, 0.05, 0.0), (0.05, 0.05, DOWN_M), (0.061, 0.05, DOWN_M), (0.3, 0.05, DOWN_M), last_m_s=0.03)
        self.op.until(lambda: self.board.mpos()[0] > HOMED[0] + 65.0)

    def z_mm(self) -> float:
        return float(self.board.mpos()[2])

    def now_s(self) -> float:
        """Return the board's time."""
        return float(self.board.ask("state")["t"])

    def entry(self) -> int:
        return int(self.board.log()[-1]["n"])

    def until_lifted(self, within_s: float = 15.0, up_mm: float = UP_MM) -> float:
        """Return the board's time at which the stylus was found up; serve the graph meanwhile."""
        end = time.monotonic() + within_s
        while True:
            state = self.board.ask("state")
            if self.z_mm() > HOMED[2] - up_mm:
                return float(state["t"])
            assert time.monotonic() < end, f"z = {self.z_mm():.2f} mm, {self.op.states[-4:]}"
            self.ros.executor.spin_once(timeout_sec=0.005)

    def held_s(self, since: int) -> float:
        """Return the board's time of the first hold after an entry of its log."""
        return next(float(e["t"]) for e in self.board.log(since) if e["kind"] == "realtime" and e["byte"] == ord("!"))

    def lift_s(self, since: int) -> float:
        """Return the board's time at which it received the line that lifts the stylus."""
        lines = (e for e in self.board.log(since) if e["kind"] == "line" and e["text"].endswith("Z-1G53G1"))
        return next(float(e["t"]) for e in lines)

    def close(self) -> None:
        for node in self.nodes:
            if node.poll() is None:
                node.send_signal(signal.SIGCONT)
                node.terminate()
                try:
                    node.wait(20.0)
                except subprocess.TimeoutExpired:
                    node.kill()
                    node.wait(5.0)
        for process in self.guards():
            os.kill(process, signal.SIGTERM)
        self.board.close()


class BringUpRig(GuardRig):
    """The same, with the node under bring-up, as users start it."""

    def start(self) -> subprocess.Popen[bytes]:
        """Start bring-up with the driver as its only program."""
        config = self.folder / "config"
        (config / "scopes").mkdir(parents=True)
        (config / "scopes" / "none.yaml").write_text("{}\n")
        driver = {"package": "gantry_driver", "executable": "serial_driver"}
        values = {name: str(value) if isinstance(value, Path) else value for name, value in self.parameters.items()}
        graph = {
            "scope": "none",
            "profiles": {"driver": {"about": "the driver alone"}},
            "programs": {"serial_driver": {**driver, "set": values}},
        }
        (config / "graph.yaml").write_text(yaml.safe_dump(graph))
        command = [str(INSTALL / "icu_bringup/lib/icu_bringup/bring_up"), "--profile", "driver", "--verbose"]
        command += ["--config", str(config), "--state", str(self.folder / "state"), "--run-dir", str(self.folder)]
        environment = {**os.environ, "ROS_DOMAIN_ID": str(self.ros.context.get_domain_id())}
        with (self.folder / "bring_up.log").open("wb") as log:
            self.node = subprocess.Popen(command, env=environment, stdout=log, stderr=log)
        self.nodes.append(self.node)
        return self.node

    def kill_node(self) -> None:
        """Kill the node that bring-up has started."""
        (node,) = children(self.node.pid, "serial_driver")
        os.kill(node, signal.SIGKILL)


__all__ = ["DOWN_M", "HOMED", "BringUpRig", "GuardRig", "children", "guards_of"]
