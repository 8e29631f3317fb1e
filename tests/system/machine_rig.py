"""The page's bridge with the true driver, controller and mock board, and a camera; no perception.

Between the browser and the bridge lies a link that can be slowed or cut.
"""

from __future__ import annotations

import re
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

from system.conftest import ROOT, RunningGraph, wait_for
from system.shaped_link import ShapedLink

_PERCEPTION = ("bench", "camera", "corners_left", "corners_right", "stereo", "dense_stereo", "stylus_tracker")
_LEFT_OUT = (*_PERCEPTION, "recognition", "hand_eye", "ui_bridge")


class MachineRig:
    """Everything as processes; :meth:`halted_s` is what counts."""

    def __init__(
        self, folder: Path, domain: int, picture: Path | None = None, rate: float = 15.0, **link: float
    ) -> None:
        extra = [text for name in _LEFT_OUT for text in ("--without", name)]
        # So slow that a move continues for long after a loaded page has seen that it began.
        extra += ["--set", "gantry_controller.motion.travel_speed_m_s=0.06"]
        self.graph = RunningGraph(folder, domain, *extra)
        self.folder = folder
        self._processes: list[subprocess.Popen[bytes]] = []
        self._environment = self.graph.environment
        shown = ["--picture", str(picture)] if picture else []
        self.camera = self._start(
            "system/barcode_camera.py", "--rate", f"{rate:g}", *shown, "--ros-args", "-r", "__ns:=/stereo"
        )
        self.link = ShapedLink(self.graph.port, **link)
        self.start_bridge()
        try:
            self.board = self.graph.board()
            self.clock_s, _ = self.board.clock_s()
        except BaseException:  # what is left behind would slow down all that follow
            self._end()
            raise

    def _start(self, script: str, *arguments: str, **options: Any) -> subprocess.Popen[bytes]:
        command = [sys.executable, str(ROOT / "tests" / script), *arguments]
        process = subprocess.Popen(command, env=self._environment, **options)
        self._processes.append(process)
        return process

    def start_bridge(self) -> None:
        values: dict[str, Any] = {
            "port": self.graph.port,
            "token_file": self.folder / "token",
            "audit_file": self.folder / "audit.jsonl",
            "passwords_file": self.folder / "passwords",  # there is one where a test has written it
        }
        values["extra_origins"] = f"http://127.0.0.1:{self.link.port}"
        given = [text for name, value in values.items() for text in ("-p", f"{name}:={value}")]
        given += ["-r", "heartbeat:=operator/heartbeat", "-r", "left/image_raw:=stereo/left/image_raw"]
        self._output = self.folder / f"bridge_{time.monotonic_ns()}.log"
        program = ROOT / "ros2_ws/install/scope_ui_bridge/lib/scope_ui_bridge/ui_bridge"
        with self._output.open("wb") as out:
            self.bridge = subprocess.Popen(
                [str(program), "--ros-args", *given], env=self._environment, stdout=out, stderr=subprocess.STDOUT
            )
        self._processes.append(self.bridge)

    def address(self) -> str:
        """Return the page's address with its newest token."""
        found = wait_for(
            lambda: re.findall(r"http://\S+\?token=\S+", self._output.read_text()), 60.0, "the page's address"
        )
        return str(found[-1])

    def new_address(self) -> str:
        """Ask for another sign-in."""
        before = self._output.read_text().count("?token=")
        self.bridge.send_signal(signal.SIGUSR1)
        wait_for(lambda: self._output.read_text().count("?token=") > before, 30.0, "another token")
        return self.address()

    def by_link(self, address: str) -> str:
        """Return the same address through the link that can be cut."""
        return address.replace(f":{self.graph.port}/", f":{self.link.port}/")

    def halted_s(self, since: int, within_s: float = 5.0) -> float:
        """Return our time at which the driver's hold came to the board, after log entry ``since``."""
        return float(wait_for(lambda: self.board.holds(since), within_s, "the driver's hold")[0]) + self.clock_s

    def close(self) -> None:
        self.board.close()
        self._end()

    def _end(self) -> None:
        self.link.close()
        for process in self._processes:
            if process.poll() is None:
                process.send_signal(signal.SIGCONT)
                process.send_signal(signal.SIGINT)
        for process in self._processes:
            try:
                process.wait(10.0)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
        self.graph.stop()
