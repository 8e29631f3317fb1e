"""Several programs in one process: each node keeps its own name, namespace, remappings and parameters."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from rcl_interfaces.srv import GetParameters
from sensor_msgs.msg import Image, PointCloud2
from support.ros_rig import Ros

from icu_common.nodes import qos
from icu_common.nodes.messages.cameras import image_message
from icu_common.nodes.messages.heads import header

pytestmark = pytest.mark.long

ROOT = Path(__file__).resolve().parents[3]


def start(ros: Ros, folder: Path, table: list[list[object]]) -> subprocess.Popen[str]:
    (folder / "table.json").write_text(json.dumps(table))
    environment = dict(os.environ, ROS_DOMAIN_ID=str(ros.context.get_domain_id()), ROS_LOG_DIR=str(folder / "log"))
    return subprocess.Popen(
        [sys.executable, "-m", "icu_bringup.cli.composed", str(folder / "table.json")],
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )


def test_two_nodes_in_one_process(ros: Ros, tmp_path: Path) -> None:
    table: list[list[object]] = [
        [
            "corners",
            ["--ros-args", "-r", f"__node:=corners_{side}", "-r", f"__ns:=/stereo/{side}"]
            + ["-r", f"image_raw:=/eye_{side}", "-p", f"max_corners:={count}"],
        ]
        for side, count in (("left", 11), ("right", 22))
    ]
    probe = ros.plain()
    process = start(ros, tmp_path, table)
    try:
        clients = {
            s: probe.create_client(GetParameters, f"/stereo/{s}/corners_{s}/get_parameters") for s in ("left", "right")
        }
        ros.spin_until(lambda: all(c.service_is_ready() for c in clients.values()), 60.0)
        values = {}
        for side, client in clients.items():
            values[side] = ros.ask(client, GetParameters.Request(names=["max_corners"])).values[0].integer_value
        assert values == {"left": 11, "right": 22}
        picture = probe.create_publisher(Image, "/eye_right", qos.IMAGES)
        found = {s: ros.collect(probe, PointCloud2, f"/stereo/{s}/corners", qos.RESULTS) for s in ("left", "right")}
        ros.spin_until(lambda: picture.get_subscription_count() == 1, 30.0)
        noise = np.random.default_rng(1).integers(0, 256, (60, 80), np.uint8)
        message = image_message(noise, "mono8", header(5, "eye"))

        def answered() -> bool:  # again and again: the node works for listeners only, and may not know of them yet
            picture.publish(message)
            return bool(found["right"])

        ros.spin_until(answered, 30.0)
        assert found["right"][0].width == 22 and not found["left"]
        process.send_signal(signal.SIGINT)
        output, _ = process.communicate(timeout=40)
        assert process.returncode == 0, output
    finally:
        if process.poll() is None:
            process.kill()
            process.communicate()


@pytest.mark.parametrize(("setting", "reason"), [("no_such_setting:=1", "no_such_setting"), ("k:=5.0", "Max: 0.24")])
def test_a_wrong_value_ends_the_process_with_its_reason(ros: Ros, tmp_path: Path, setting: str, reason: str) -> None:
    process = start(ros, tmp_path, [["corners", ["--ros-args", "-p", setting]]])
    output, _ = process.communicate(timeout=60)
    assert process.returncode == 2 and reason in output and "Traceback" not in output


@pytest.mark.parametrize("together", [True, False])
def test_a_parameter_file_that_cannot_be_read_ends_the_process_with_file_and_line(
    ros: Ros, tmp_path: Path, together: bool
) -> None:
    """As bring-up's other lines are hidden, the reason must be in the one that begins with "error:"."""
    wrong = tmp_path / "mine.yaml"
    wrong.write_text("/**:\n  ros__parameters:\n    travel_mm: [360.0, 220, 60.0]\n")
    given = ["--ros-args", "--params-file", str(wrong)]
    if together:
        process = start(ros, tmp_path, [["corners", given]])
    else:
        command = [sys.executable, "-m", "icu_bringup.nodes.beds_node", *given]
        process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    output, _ = process.communicate(timeout=60)
    assert process.returncode == 2 and "Traceback" not in output
    (reason,) = [line for line in output.splitlines() if line.startswith("error: ")]
    assert f"{wrong}'. Error: Sequence should be of same type" in reason and "line_num 3" in reason
