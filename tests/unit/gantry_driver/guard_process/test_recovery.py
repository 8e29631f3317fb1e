"""A killed guard whose node is gone as well: the next guard process opens the port by the record, and only lifts."""

from __future__ import annotations

import contextlib
import dataclasses
import json
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from nodes.grbl_board import GrblBoard

from gantry_driver.adapters.guard.places import guard_path, stylus_path
from gantry_driver.adapters.guard.port_record import record_path
from gantry_driver.core.configuration.envelope_config import EnvelopeConfig
from gantry_driver.core.configuration.machine_config import DriverConfig
from gantry_driver.core.grbl.trajectory_gcode import Waypoint
from gantry_driver.core.guard.messages import FrameReader, config_values, frame, waypoint_values
from icu_common.adapters.direct_stop.line import send_stop
from icu_common.core.geometry.frames import JOINTS
from icu_common.core.reasons.message import decoded

pytestmark = pytest.mark.long

DOWN_M = 0.02
PRESSING_S = 2.0
NO_PANEL = EnvelopeConfig(free_space_m=0.2, crossing_m=0.2)
Condition = Callable[[], Any]


class Place:
    """A board, its guards, and a node that speaks their protocol."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.board = GrblBoard(folder, "--keep-running")
        self.port = str(self.board.port)
        self.path = guard_path(self.port)
        self.config = DriverConfig(
            port=self.port,
            enabled_at_start=True,
            envelope=NO_PANEL,
            node_silence_s=0.5,
            heartbeat_timeout_s=2.0,
            status_timeout_s=10.0,
            hold_timeout_s=10.0,
            max_rest_extended_s=60.0,
        )
        self.guards: list[subprocess.Popen[str]] = []
        self.node: socket.socket | None = None
        self.reader = FrameReader()
        self.states: list[str] = []

    def guard(self, *options: str) -> subprocess.Popen[str]:
        command = [sys.executable, "-m", "gantry_driver.cli.gantry_guard", "--port", self.port, *options]
        self.guards.append(subprocess.Popen(command, stderr=subprocess.PIPE, text=True))
        return self.guards[-1]

    def connect(self, config: DriverConfig | None = None) -> None:
        """Connect as a node."""
        self.node, self.reader = socket.socket(socket.AF_UNIX), FrameReader()
        made = self.node
        self.until(lambda: made.connect_ex(bytes(self.path)) == 0)
        made.setblocking(False)
        values = {"time_s": None, "enabled": True, "active": True, "left_down": False}
        stop_path = str(self.folder / "stop")
        self.send(do="hello", config=config_values(config or self.config), stop_path=stop_path, **values)

    def send(self, **message: Any) -> None:
        assert self.node is not None
        self.node.sendall(frame(message))

    def until(self, condition: Condition, within_s: float = 30.0) -> Any:
        """Serve the guard until the condition holds."""
        end = time.monotonic() + within_s
        while not (value := condition()):
            assert time.monotonic() < end, f"{self.states[-4:]}"
            if self.node is not None:
                with contextlib.suppress(OSError):
                    self.send(do="heartbeat", age_s=0.0)
                    while data := self.node.recv(65536):
                        self.take(data)
            time.sleep(0.005)  # the interval of the signs of life
        return value

    def take(self, data: bytes) -> None:
        for message in self.reader.feed(data):
            self.states += [decoded(c["text"]) for name, c in message.get("events", []) if name == "StateChanged"]

    def state(self, begin: str) -> None:
        self.until(lambda: self.states and self.states[-1].startswith(begin))

    def press(self) -> subprocess.Popen[str]:
        """Start a guard, home and press; return the guard."""
        guard = self.guard()
        self.connect()
        self.state("unhomed")
        self.send(do="home")
        self.state("idle")
        self.go((0.1, 0.05, 0.0), (0.1, 0.05, DOWN_M))
        self.until(lambda: self.z_mm() < -1000.0 * DOWN_M)
        self.state("idle")
        self.until(lambda: stylus_path(self.port).read_text() == "down\n" and record_path(self.path).is_file())
        return guard

    def go(self, *points: tuple[float, float, float]) -> None:
        way = waypoint_values([Waypoint(positions_m=point) for point in points])
        self.send(do="run", goal_id="1", names=list(JOINTS), points=way, age_s=0.0)

    def kill(self, guard: subprocess.Popen[str]) -> float:
        """End node and guard; return the board's time."""
        assert self.node is not None
        since_s = float(self.board.ask("state")["t"])
        guard.kill()
        guard.wait(5.0)
        self.node.close()
        self.node = None
        return since_s

    def z_mm(self) -> float:
        return float(self.board.mpos()[2])

    def lifted_s(self) -> float:
        """Return the board's time at which the stylus was found up."""
        return float(self.until(lambda: self.z_mm() > -1.05 and self.board.ask("state")["t"]))

    def lines(self, since: int) -> list[str]:
        """Return the lines that move an axis."""
        return [e["text"] for e in self.board.log(since) if e["kind"] == "line" and e["text"].endswith("G1")]

    def entry(self) -> int:
        return int(self.board.log()[-1]["n"])

    def close(self) -> None:
        if self.node is not None:
            self.node.close()
        for guard in self.guards:
            if guard.poll() is None:
                guard.terminate()
                guard.wait(20.0)
            assert guard.stderr is not None
            guard.stderr.close()
        for path in (record_path(self.path), stylus_path(self.port)):
            path.unlink(missing_ok=True)
        self.board.close()


@pytest.fixture
def place(tmp_path: Path) -> Iterator[Place]:
    made = Place(tmp_path)
    yield made
    made.close()


@pytest.mark.parametrize("option", ["--recover", "--stay"])
def test_the_next_guard_lifts_without_a_node_and_moves_nothing_else(place: Place, option: str) -> None:
    guard = place.press()
    at, since = place.board.mpos(), place.entry()
    begun_s = place.kill(guard)
    place.guard(option)
    assert place.lifted_s() - begun_s < PRESSING_S
    assert place.board.mpos()[:2] == at[:2] and place.lines(since) == ["F1800Z-1G53G1"]
    place.states.clear()
    place.connect()
    place.state("stopped: the stylus stayed down while no driver was connected")
    place.until(lambda: place.send(do="reset") or place.states[-1] == "unhomed")  # the lift may not be complete yet
    assert place.lines(since) == ["F1800Z-1G53G1"], "only a person homes"


def test_a_guard_that_lifts_without_a_node_allows_no_motion_and_takes_a_stop(place: Place) -> None:
    begun_s = place.kill(place.press())
    place.guard("--recover")
    assert place.lifted_s() - begun_s < PRESSING_S
    assert send_stop(place.folder / "stop", "the page's STOP"), "the socket for stops is that of the killed guard"


def test_of_several_guards_that_wait_one_opens_the_port(place: Place) -> None:
    guard = place.press()
    waiting = [place.guard("--recover") for _ in range(4)]
    place.until(lambda: all(waits_for_lock(w.pid) for w in waiting))
    since = place.entry()
    begun_s = place.kill(guard)
    assert place.lifted_s() - begun_s < PRESSING_S
    place.states.clear()
    place.connect()
    place.state("stopped: ")
    assert place.lines(since) == ["F1800Z-1G53G1"]
    assert sum(str(place.board.port.resolve()) in open_files(w.pid) for w in waiting) == 1
    place.send(do="close", reason="the test has ended")
    place.until(lambda: all(w.poll() is not None for w in waiting))
    assert [w.returncode for w in waiting] == 4 * [0] and place.lines(since) == ["F1800Z-1G53G1"]


def test_a_guard_that_closes_in_order_leaves_no_record_and_its_successor_ends(place: Place) -> None:
    guard = place.press()
    assert record_path(place.path).stat().st_mode & 0o777 == 0o600
    place.send(do="close", reason="the test has ended")
    assert guard.wait(20.0) == 0 and place.z_mm() > -1.05
    assert not record_path(place.path).exists()
    since = place.entry()
    ended = place.guard("--recover")
    assert ended.wait(20.0) == 0 and ended.stderr is not None and ended.stderr.read() == ""
    assert place.entry() == since, "it has not opened the port"


def test_the_record_has_the_newest_configuration(place: Place) -> None:
    place.press()
    slower = dataclasses.replace(place.config, stylus_feed_m_s=0.02)
    place.send(do="configure", config=config_values(slower))
    path = record_path(place.path)
    place.until(lambda: json.loads(path.read_text())["config"] == json.loads(json.dumps(config_values(slower))))


def test_a_stale_record_is_refused_with_its_reason_and_nothing_moves(place: Place) -> None:
    place.kill(place.press())
    path = record_path(place.path)
    path.write_text(json.dumps(json.loads(path.read_text()) | {"boot": "another"}))
    since, z = place.entry(), place.z_mm()
    refused = place.guard("--recover")
    assert refused.wait(20.0) == 1 and refused.stderr is not None
    reason = "it was written before the computer's last start"
    assert refused.stderr.read() == f"error: the record of a guard that was killed is not used, {reason}\n"
    assert place.entry() == since and place.z_mm() == z and not path.exists()
    place.guard()  # the node's configuration is fresh, and the stylus may still be down
    place.connect()
    place.lifted_s()


def test_a_guard_that_waits_ends_by_a_signal(place: Place) -> None:
    guard = place.press()
    waiting = place.guard("--recover")
    place.until(lambda: waits_for_lock(waiting.pid))
    waiting.terminate()
    assert waiting.wait(5.0) == 0 and guard.poll() is None


def waits_for_lock(pid: int) -> bool:
    return any(name.endswith(".lock") for name in open_files(pid))


def open_files(pid: int) -> list[str]:
    """Return the names of a process's open files."""
    found = []
    for fd in Path(f"/proc/{pid}/fd").iterdir():
        with contextlib.suppress(OSError):  # closed meanwhile
            found.append(str(fd.readlink()))
    return found
