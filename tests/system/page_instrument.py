"""The bridge and a synthetic instrument as two processes."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

from support.ros_rig import domain_of_worker
from system.conftest import executable, wait_for

ROOT = Path(__file__).resolve().parents[2]


class Instrument:
    """The bridge and a synthetic instrument as two processes."""

    def __init__(self, folder: Path, limits: dict[str, float], *scope: str) -> None:
        self.folder = folder
        self.limits = limits
        environment = {
            **os.environ,
            "ROS_DOMAIN_ID": str(domain_of_worker(10, 35)),
            "ROS_LOG_DIR": str(folder / "ros_log"),
            "PYTHONUNBUFFERED": "1",
        }
        self.environment = environment
        script = str(ROOT / "tests" / "system" / "synthetic_scope.py")
        self.scope = subprocess.Popen(
            [sys.executable, script, *scope], env=environment, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        try:
            self.start_bridge(0)
        except BaseException:  # what is left behind would answer to the next one's pages
            self.close()
            raise

    def start_bridge(self, port: int) -> None:
        arguments: dict[str, Any] = {"port": port, "token_file": self.folder / "token", **self.limits}
        arguments["audit_file"] = self.folder / "audit.jsonl"
        arguments["record_folder"] = self.folder / "sessions"
        arguments["layout"] = ROOT / "config" / "scopes" / "dso_bench_4.yaml"
        given = [text for name, value in arguments.items() for text in ("-p", f"{name}:={value}")]
        self.output = self.folder / f"bridge_{time.monotonic_ns()}.log"
        with self.output.open("wb") as out:
            self.bridge = subprocess.Popen(
                [executable("scope_ui_bridge", "ui_bridge"), "--ros-args", *given],
                env=self.environment,
                stdout=out,
                stderr=subprocess.STDOUT,
            )
        self.address()

    def address(self, number: int = 1) -> str:
        """Return the page's address with the token that was printed as ``number``-th."""

        def printed() -> str:
            assert self.bridge.poll() is None, self.output.read_text()
            found = re.findall(r"http://\S+\?token=\S+", self.output.read_text())
            return found[number - 1] if len(found) >= number else ""

        return str(wait_for(printed, 60.0, "the page's address"))

    def new_address(self) -> str:
        """Ask for another sign-in, as docs/how-to/deployment.md says."""
        before = self.output.read_text().count("?token=")
        self.bridge.send_signal(signal.SIGUSR1)
        return self.address(before + 1)

    def tell(self, line: str) -> None:
        """Change the instrument's world, and return when it has changed."""
        assert self.scope.stdin is not None and self.scope.stdout is not None
        self.scope.stdin.write(line + "\n")
        self.scope.stdin.flush()
        assert self.scope.stdout.readline() == "heard\n", "the instrument has ended"

    def close(self) -> None:
        for process in (self.bridge, self.scope):
            process.send_signal(signal.SIGCONT)
            process.send_signal(signal.SIGINT)
            try:
                process.wait(10.0)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
        for pipe in (self.scope.stdin, self.scope.stdout):
            if pipe is not None:
                pipe.close()
