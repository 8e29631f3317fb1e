"""gantry_monitor with the real driver and a mock board: the line that a person sees."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

from nodes.grbl_board import GrblBoard

from gantry_driver.nodes.serial_driver_node import SerialDriverNode


def test_state_and_counts_are_shown(ros: Any, tmp_path: Path) -> None:
    board = GrblBoard(tmp_path)
    renamed = ["--ros-args", "-r", "gantry/driver_state:=driver_state"]
    process = None
    try:
        ros.node(SerialDriverNode, {"port": str(board.port), "status_timeout_s": 10.0})  # the board may be held up
        process = subprocess.Popen(
            [sys.executable, "-m", "gantry_driver.cli.gantry_monitor", "--seconds", "6", *renamed],
            env={**os.environ, "ROS_DOMAIN_ID": str(ros.context.get_domain_id())},
            text=True,
            stdout=subprocess.PIPE,
        )
        assert process.stdout is not None
        os.set_blocking(process.stdout.fileno(), False)
        ros.spin_until(lambda: process.poll() is not None, 60.0)
        output = process.stdout.read()
    finally:
        if process is not None:
            process.kill()
            process.communicate()
        ros.close()
        ros.nodes.clear()
        board.close()
    assert process.returncode == 0
    last = output.splitlines()[-1]
    pattern = r"unhomed  \|  no position  \|  sent 3  acknowledged 3  .*refused 0  lost 0  \|  \d+ B/s, answer in"
    assert re.match(pattern, last), output
