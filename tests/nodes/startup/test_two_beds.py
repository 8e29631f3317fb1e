"""Two robots in two namespaces on one host: what is ordered at one bed moves nothing at the other."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import time
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from geometry_msgs.msg import PointStamped
from std_msgs.msg import Header, String
from std_srvs.srv import SetBool, Trigger
from support.line_socket import BoardSocket
from support.ros_rig import Ros

from icu_bringup.nodes.beds_node import BedsNode
from icu_common.nodes import qos
from icu_common.nodes.messages.heads import header
from icu_common.nodes.messages.places import point_message

pytestmark = pytest.mark.long

ROOT = Path(__file__).resolve().parents[3]
BEDS = ("bed_1", "bed_2")


class Bed:
    """One robot, and its operator at a terminal."""

    def __init__(self, name: str, ros: Ros, folder: Path) -> None:
        self.ros = ros
        folder.mkdir()
        program = ROOT / "ros2_ws/install/icu_bringup/lib/icu_bringup/bring_up"
        parts = [text for part in ("mock_grbl", "serial_driver", "gantry_controller") for text in ("--only", part)]
        places = ["--config", ROOT / "config", "--state", folder / "state", "--run-dir", folder / "run"]
        # The operator's heartbeat and goals come from the thread that waits: on a busy machine they may be late.
        patience = {
            "serial_driver": {"heartbeat_timeout_s": 2.0, "goal_max_age_s": 5.0, "status_timeout_s": 10.0},
            "gantry_controller": {"heartbeat_timeout_s": 2.0, "goal_max_age_s": 5.0, "joints_timeout_s": 5.0},
        }
        for part, settings in patience.items():
            parts += [text for key, value in settings.items() for text in ("--set", f"{part}.{key}={value}")]
        environment = {
            **os.environ,
            "ROS_DOMAIN_ID": str(ros.context.get_domain_id()),
            "ROS_LOG_DIR": str(folder / "ros_log"),
        }
        with (folder / "output").open("wb") as out:
            self.process = subprocess.Popen(
                [str(program), "--profile", "test", "--namespace", name, *parts, *map(str, places)],
                env=environment,
                stdout=out,
                stderr=subprocess.STDOUT,
            )
        self.board_path = folder / "run" / "board"
        self.node = ros.plain(f"operator_of_{name}")
        self.states = ros.collect(self.node, String, f"/{name}/gantry/driver_state", qos.LATCHED)
        self._prefix = f"/{name}"
        self.beat = self.node.create_publisher(Header, f"/{name}/operator/heartbeat", qos.COMMAND)
        self.goal = self.node.create_publisher(PointStamped, f"/{name}/gantry/goal", qos.COMMAND)

    @property
    def state(self) -> str:
        return self.states[-1].data if self.states else ""

    def home(self) -> None:
        self.node.create_timer(0.1, self._beat)
        self.call("gantry/enable", SetBool, SetBool.Request(data=True))
        self.call("gantry/home", Trigger, Trigger.Request())
        self.ros.spin_until(lambda: self.state == "idle", 30.0, lambda: self.state)

    def _beat(self) -> None:
        self.beat.publish(Header(stamp=self.node.get_clock().now().to_msg(), frame_id="operator"))

    def call(self, name: str, kind: Any, request: Any) -> None:
        client = self.node.create_client(kind, f"{self._prefix}/{name}")
        self.ros.spin_until(client.service_is_ready, 30.0, lambda: name)

        self.ros.spin_until(lambda: self.ros.ask(client, request).success, 30.0, lambda: (name, self.state))

    def end(self) -> int:
        self.process.send_signal(signal.SIGINT)
        return self.process.wait(40.0)


@pytest.fixture
def beds(ros: Ros, tmp_path: Path) -> Iterator[list[Bed]]:
    made = [Bed(name, ros, tmp_path / name) for name in BEDS]
    try:
        yield made
    finally:
        for bed in made:
            with contextlib.suppress(ProcessLookupError):
                os.kill(bed.process.pid, signal.SIGINT)
        for bed in made:
            bed.process.wait(40.0)


@pytest.mark.timeout(150)
def test_no_crosstalk(beds: list[Bed], ros: Ros) -> None:
    first, second = beds
    page = ros.node(BedsNode, {"beds": [f"{b}=http://127.0.0.1:8080" for b in BEDS], "port": 0})
    boards = [BoardSocket(bed.board_path) for bed in beds]
    try:
        first.home()
        ros.spin_until(lambda: second.state == "unhomed", 30.0, lambda: second.state)
        assert not [line for line in boards[1].lines() if line["text"].startswith(("$H", "F", "G"))]
        second.home()
        ros.spin_until(lambda: first.goal.get_subscription_count() == 1, 20.0)
        resting = boards[1].mpos()
        before = len(boards[1].lines())
        x, y, _ = boards[0].mpos()
        sent_s: list[float] = []

        def there() -> bool:
            # Again: what was a second on its way is taken no more.
            if not sent_s or time.monotonic() > sent_s[-1] + 5.0:
                stamp = first.node.get_clock().now().nanoseconds
                first.goal.publish(point_message((0.05, 0.02, 0.0), header(stamp, "base_link")))
                sent_s.append(time.monotonic())
            return bool(boards[0].mpos()[:2] == pytest.approx((x + 50, y + 20), abs=0.05))

        ros.spin_until(there, 30.0)
        assert boards[1].mpos() == resting and boards[1].lines()[before:] == []

        first.call("gantry/stop", Trigger, Trigger.Request())
        ros.spin_until(lambda: first.state.startswith("stopped"), 20.0, lambda: first.state)
        assert second.state == "idle"

        def shown() -> dict[str, str]:
            with urllib.request.urlopen(page.server.address + "state", timeout=20) as answer:
                beds = json.loads(answer.read())
            return {name: bed["states"]["driver"] for name, bed in beds.items()}

        ros.spin_until(
            lambda: shown()["bed_1"].startswith("stopped") and shown()["bed_2"] == "idle", 20.0, lambda: shown()
        )
        assert [bed.end() for bed in beds] == [0, 0]
    finally:
        for board in boards:
            board.close()
