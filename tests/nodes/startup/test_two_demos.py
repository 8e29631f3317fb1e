"""Two simulated graphs on one computer: each has a ROS domain, a page's port and a state folder of its own."""

from __future__ import annotations

import contextlib
import json
import os
import re
import shutil
import signal
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest
from support.deadlines import wait_until

pytestmark = pytest.mark.long

ROOT = Path(__file__).resolve().parents[3]
DEADLINE_S = 90.0
PARTS = ("camera", "corners_left", "corners_right", "stereo", "dense_stereo", "stylus_tracker", "recognition", "bench")
"""Not needed here: the machine, its controller and the page are."""
# A computer of its own: loopback, names of sockets, and shared memory.
COMPUTER = ["unshare", "--user", "--map-root-user", "--net", "--mount", "--ipc", "--", "bash", "-c"]
SET_UP = "set -e; mount -t tmpfs tmpfs /dev/shm; ip link set lo up; "
OPEN = """
import sys, urllib.request as r
print(r.build_opener(r.HTTPCookieProcessor()).open(sys.argv[1]).read().decode())
"""
HOLDS = "exec sleep infinity"


class Computer:
    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._holder = subprocess.Popen([*COMPUTER, f"{SET_UP} echo up; {HOLDS}"], stdout=subprocess.PIPE, text=True)
        assert self._holder.stdout is not None
        if self._holder.stdout.readline() != "up\n":
            self._holder.wait()
            pytest.skip("no namespaces here")
        self.environment = {k: v for k, v in os.environ.items() if not k.startswith("ROS_DOMAIN")}
        self.environment |= {"HOME": str(folder), "ROS_LOG_DIR": str(folder / "ros"), "PYTHONUNBUFFERED": "1"}
        self.environment.pop("XDG_STATE_HOME", None)
        self.processes: list[subprocess.Popen[bytes]] = []

    def command(self, *words: str) -> list[str]:
        target = str(self._holder.pid)
        enter = ["nsenter", "--preserve-credentials", "-t", target, "--user", "--net", "--mount", "--ipc"]
        return [*enter, f"--wd={ROOT}", *words]

    def start(self, output: Path, *words: str, **more: str) -> subprocess.Popen[bytes]:
        with output.open("wb") as out:
            self.processes.append(
                subprocess.Popen(
                    self.command(*words), env=self.environment | more, stdout=out, stderr=subprocess.STDOUT
                )
            )
        return self.processes[-1]

    def close(self) -> None:
        for process in self.processes:
            process.send_signal(signal.SIGINT)
        for process in self.processes:
            try:
                process.wait(DEADLINE_S)
            except subprocess.TimeoutExpired:
                process.kill()
        self._holder.kill()
        self._holder.wait()


@pytest.fixture
def computer(tmp_path: Path) -> Iterator[Computer]:
    if not shutil.which("unshare") or not shutil.which("nsenter"):
        pytest.skip("no unshare and nsenter here")
    machine = Computer(tmp_path)
    with contextlib.closing(machine):
        yield machine


def program(package: str, name: str) -> str:
    return str(ROOT / "ros2_ws/install" / package / "lib" / package / name)


def test_two_demos_run_side_by_side(computer: Computer, tmp_path: Path) -> None:
    parts = [word for part in PARTS for word in ("--without", part)]
    outputs = [tmp_path / "first", tmp_path / "second"]
    for output in outputs:
        computer.start(output, program("icu_bringup", "bring_up"), "--config", str(ROOT / "config"), *parts)
        wait_until(
            lambda output=output: "?token=" in output.read_text(), "the page's address", DEADLINE_S, output.read_text
        )
    first, second = (output.read_text() for output in outputs)
    assert "http://127.0.0.1:8080/?token=" in first and "ROS domain" not in first
    assert "http://127.0.0.1:8081/?token=" in second
    assert "Another graph runs in ROS domain 0, this one in 1: " in second and "export ROS_DOMAIN_ID=1" in second
    assert "Port 8080 is in use by another program, so the page has port 8081." in second
    state = tmp_path / ".local/state/icu_gantry"
    assert (state / "audit.jsonl").exists() and (state / "domain-1" / "audit.jsonl").exists()

    prepare = tmp_path / "prepare"
    process = computer.start(prepare, program("gantry_driver", "gantry_prepare"), "--json", ROS_DOMAIN_ID="1")
    looks = lambda: '"stage": "cameras"' in prepare.read_text() or process.poll() is not None  # noqa: E731
    wait_until(looks, "the preparation waits for cameras", DEADLINE_S, prepare.read_text)
    stages = [json.loads(line)["stage"] for line in prepare.read_text().splitlines()]
    assert "homing" in stages and stages[-1] == "cameras", prepare.read_text()

    def driver_states() -> list[str]:
        logs = [(folder / "logs" / "bring_up.log").read_text() for folder in (state, state / "domain-1")]
        return [re.findall(r"\[gantry\.serial_driver\]: (\w+)", text)[-1] for text in logs]

    # The log may come a moment after the preparation has received the state.
    wait_until(lambda: driver_states() == ["unhomed", "idle"], "only the second is homed", DEADLINE_S, driver_states)
    for text in (first, second):
        address = re.findall(r"http://\S+token=\S+", text)[0]
        page = subprocess.run(
            computer.command("python3", "-c", OPEN, address), capture_output=True, timeout=DEADLINE_S, check=False
        )
        assert b"<html" in page.stdout, page.stderr.decode()
    third = subprocess.run(
        computer.command(
            program("icu_bringup", "bring_up"), "--config", str(ROOT / "config"), "--set", "ui_bridge.port=8081"
        ),
        env=computer.environment,
        capture_output=True,
        text=True,
        timeout=DEADLINE_S,
        check=False,
    )
    assert third.returncode == 2 and "error: the page's port 8081 is in use by another program" in third.stderr
