"""Bag programs as processes that do not outlive a test."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

from support.ros_rig import Ros


class Command:
    """One of the bag programs as a process on the rig's domain."""

    def __init__(self, ros: Ros, folder: Path, name: str, arguments: Sequence[str]) -> None:
        environment = dict(os.environ, ROS_DOMAIN_ID=str(ros.context.get_domain_id()))
        environment |= {"ROS_LOG_DIR": str(folder / "log"), "PYTHONUNBUFFERED": "1"}
        self.process = subprocess.Popen(
            [sys.executable, "-m", f"icu_bringup.cli.{name}", *arguments],
            env=environment,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )

    def end(self, number: int | None = None, within_s: float = 40.0, code: int = 0) -> str:
        if number is not None:
            self.process.send_signal(number)
        output, _ = self.process.communicate(timeout=within_s)
        assert self.process.returncode == code, output
        return output


Start = Callable[..., Command]
