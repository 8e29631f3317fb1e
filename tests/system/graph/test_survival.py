"""The table of kills: any program of the running graph may die at any time.

While bring-up is held, nothing returns before it was missed. Then the others must report what is gone, and the machine
must be safe. After that bring-up restarts it, and everything must work again.
"""

from __future__ import annotations

import os
import re
import signal
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PoseStamped
from rcl_interfaces.msg import Log
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import String
from std_srvs.srv import SetBool
from support.ros_rig import keeping_all
from system.terminal_operator import Operator

from icu_common.core.goals.results import Outcome
from icu_common.nodes import qos

pytestmark = [pytest.mark.system, pytest.mark.alone, pytest.mark.timeout(300), pytest.mark.long]
UP_M = 0.0005
WELL = DiagnosticStatus.OK
GONE = r"{} has ended"


@dataclass(frozen=True, kw_only=True)
class Row:
    """The killed program, the moment, and the messages meanwhile and afterwards: patterns for (sender, text)."""

    killed: tuple[str, ...]
    during: str
    said: tuple[tuple[str, str], ...]
    said_after: tuple[tuple[str, str], ...] = ()
    stays_homed: bool = True


TABLE = (
    Row(
        killed=("stereo", "dense_stereo", "corners_right", "hand_eye", "sequencer", "gantry_controller"),
        during="touch",
        said=tuple(
            ("ui_bridge", GONE.format(name))
            for name in ("stereo", "dense_stereo", "/stereo/right/corners_right", "/calibration/hand_eye")
            + ("/gantry/sequencer", "gantry controller")
        ),
        # The driver stops and lifts without the controller's sign, or without a heartbeat.
        said_after=(
            ("driver", "stopped"),
            ("controller", "stopped: (gantry_controller has sent no sign|operator's heartbeat)"),
        ),
    ),
    Row(
        killed=("camera", "corners_left", "stylus_tracker", "recognition"),
        during="approach",
        said=(
            ("result", "the camera has stalled: no image|no recognition of the panel for"),
            ("controller", "waiting: no image from the left camera"),
            ("stereo", "no pictures with corners"),
            ("/stereo/right/corners_right", "0 pictures"),
            ("ui_bridge", GONE.format("stylus_tracker")),
            ("ui_bridge", GONE.format("/panel/recognition")),
        ),
    ),
    Row(
        killed=("serial_driver", "ui_bridge"),
        during="move",
        said=(("result", "no joint_states"), ("controller", "waiting: no joint_states")),
        stays_homed=False,
    ),
    Row(
        killed=("mock_grbl", "bench"),
        during="homing",
        said=(
            ("driver", "disconnected: "),
            ("controller", "waiting: driver disconnected"),
            ("ui_bridge", "simulated time has not advanced for 5 s"),
        ),
        stays_homed=False,
    ),
)


class Scene:
    """The graph, the operator, and everything that is said."""

    def __init__(self, graph: Any, operator: Operator) -> None:
        self.graph, self.operator = graph, operator
        self.heard: list[tuple[str, str]] = []
        self.well: dict[str, float] = {}
        self.interrupted = False
        """Whether a heartbeat that was held up ended the last row's gesture before anything else could."""
        node, every = operator.node, keeping_all(qos.RESULTS)
        node.create_subscription(DiagnosticArray, "/diagnostics", self._diagnostics, every)
        node.create_subscription(Log, "/rosout", lambda m: self.heard.append((m.name, m.msg)), every)
        # The stereo node only works while a program subscribes.
        node.create_subscription(PoseStamped, "/stereo/panel_plane", lambda m: None, qos.RESULTS)
        self._hear("controller", "/gantry/state")
        self._hear("driver", "/gantry/driver_state")
        self._hear("hand_eye", "/calibration/state")

    def _hear(self, who: str, topic: str) -> None:
        take = lambda m: self.heard.append((who, m.data))  # noqa: E731
        self.operator.node.create_subscription(String, topic, take, keeping_all(qos.LATCHED))

    def _diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            self.heard.append((status.name, status.message))
            if status.level == WELL:
                self.well[re.split("[/:]", status.name.partition(": ")[0].replace(" ", "_"))[-1]] = time.monotonic()

    def until(self, condition: Callable[[], Any], within_s: float, what: str | Callable[[], str]) -> None:
        name = what if callable(what) else lambda: what
        self.operator.ros.spin_until(
            condition, within_s, lambda: f"{name()}; last heard {self.heard[-30:]}; {self.graph.tail()}"
        )

    def prepare(self) -> None:
        """Prepare the graph; meanwhile the operator's clock advances, so its heartbeats carry the current time."""
        with ThreadPoolExecutor(max_workers=1) as pool:
            done = pool.submit(self.graph.prepare)
            self.until(done.done, 200.0, "prepared")
        done.result()

    def pids(self) -> dict[str, int]:
        """Return the processes that bring-up has started, by their names."""
        parent = self.graph.process.pid
        found = {}
        for child in Path(f"/proc/{parent}/task/{parent}/children").read_text().split():
            try:
                line = Path(f"/proc/{child}/cmdline").read_text(errors="replace").replace("\0", " ")
            except OSError:
                continue  # it has ended meanwhile
            if "icu_bringup.cli.fork_server" in line or "gantry_driver.cli.gantry_guard" in line:
                continue  # not a node: the launcher, and the driver's guard
            name = re.search(r"__node:=(\S+)", line)
            found[name[1] if name else "mock_grbl" if "mock_grbl" in line else line] = int(child)
        return found

    def truth(self) -> dict[str, Any]:
        bench = self.graph.bench()
        try:
            return bench.ask(do="truth")
        finally:
            bench.close()

    def stylus_is_up(self) -> bool:
        return float(self.truth()["tip_base_m"][2]) > -UP_M

    @contextmanager
    def bring_up_held(self) -> Iterator[None]:
        os.kill(self.graph.process.pid, signal.SIGSTOP)
        try:
            yield
        finally:
            os.kill(self.graph.process.pid, signal.SIGCONT)

    def begin(self, during: str) -> str:
        """Bring the machine into the middle of something and return the goal's id, empty without one."""
        operator = self.operator
        if during == "move":
            return operator.start_long_move()
        if during == "homing":
            self.prepared(SetBool, "/gantry/enable", SetBool.Request(data=True))
            # A restarted driver receives the heartbeat a moment after its services exist.
            self.until(lambda: operator.call("/gantry/home").success, 10.0, "homing is accepted")
            self.until(lambda: operator.driver_state == "homing", 10.0, "homing")
        if during in ("rest", "homing"):
            return ""
        operator.go(0.02, 0.02)
        goal = f"{during}-{len(operator.results)}"
        gesture = "press:RUN_STOP" if during == "approach" else "hold:RUN_STOP:20"
        operator.command.publish(String(data=f"{gesture} id={goal}"))
        phase = "moving" if during == "approach" else "touching"
        self.until(lambda: operator.state == phase, 15.0, f"{gesture}: {operator.results[-2:]}")
        if during == "touch":
            self.until(lambda: self.truth()["contact"], 10.0, "the stylus is on the panel")
        return goal

    def prepared(self, kind: Any, name: str, request: Any) -> None:
        client = self.operator.node.create_client(kind, name)
        self.until(client.service_is_ready, 15.0, f"{name} is offered")
        future = client.call_async(request)
        self.until(future.done, 10.0, f"{name} answers")
        assert future.result().success, future.result().message

    def play(self, row: Row) -> str:
        """Carry a row out; return the line of the printed table."""
        started = time.monotonic()
        goal = self.begin(row.during)
        pids, heard, log = self.pids(), len(self.heard), len(self.graph.output)
        assert set(row.killed) <= set(pids), (row.killed, pids)

        # The killed program may hold up a heartbeat. The driver has stopped then, which others report instead; where
        # the result is reported, the row has to be played again.
        states = len(self.operator.driver_states)
        held_up = "stopped: operator's heartbeat"

        def missing(said: tuple[tuple[str, str], ...]) -> list[tuple[str, str]]:
            results = [r.reason for r in self.operator.results if r.goal_id == goal and r.outcome.final]
            new = [*self.heard[heard:], *(("result", reason) for reason in results)]
            left = [(w, p) for w, p in said if not any(w == who and re.search(p, text) for who, text in new)]
            stopped = any(state.data.startswith(held_up) for state in self.operator.driver_states[states:])
            ended = any("the driver aborted the motion: operator's heartbeat lost" in reason for reason in results)
            self.interrupted = stopped and ended and "result" in dict(row.said)
            return [(w, p) for w, p in left if w != "result"] if self.interrupted else left

        def all_said() -> bool:
            left = missing(row.said)
            stopped = self.operator.driver_state.startswith(held_up)
            if stopped and "controller" in dict(left) and "serial_driver" not in row.killed:
                self.operator.call("/gantry/reset")
            return not left

        with self.bring_up_held():
            for name in row.killed:
                os.kill(pids[name], signal.SIGKILL)
            killed = time.monotonic()
            self.until(all_said, 15.0, lambda: f"{missing(row.said)} is not said; {self.operator.results[-3:]}")
            said = time.monotonic()
            if not row.said_after and "bench" not in row.killed:
                self.until(self.stylus_is_up, 5.0, "the stylus is up")
        self.until(lambda: not missing(row.said_after), 25.0, lambda: f"{missing(row.said_after)} is not said")
        self.until(lambda: "bench" in row.killed or self.stylus_is_up(), 5.0, "the stylus is up")

        def restarted() -> bool:
            events = [f"{name} ! ended with signal SIGKILL, restarted " for name in row.killed]
            return all(event in self.graph.output[log:] for event in events)

        self.until(restarted, 10.0, f"bring-up has restarted {row.killed}")
        self.until(lambda: set(row.killed) <= set(self.pids()), 10.0, "they run again")
        again = time.monotonic()
        reporters = [name for name in row.killed if name not in ("ui_bridge", "mock_grbl")]

        def unwell() -> list[str]:
            return [name for name in reporters if self.well.get(name, 0.0) < again]

        if self.operator.driver_state.startswith("stopped") and row.stays_homed:
            self.operator.reset()
        if row.stays_homed:
            self.until(lambda: not unwell(), 25.0, lambda: f"{unwell()} do not report that they are well")
        if "serial_driver" in row.killed:  # else its predecessor's services, which no program serves, would be called
            restart = self.operator.driver_states
            # The guard keeps the port and the position for a node that starts in time.
            there = re.compile("unhomed|stopped: the driver's node has ended")
            self.until(lambda: any(there.match(s.data) for s in restart[states:]), 25.0, "the driver is there again")
            if self.operator.driver_state.startswith("stopped"):
                self.operator.call("/gantry/reset")  # it is disabled then, as after each start
        if "ui_bridge" in row.killed:
            self.until(lambda: "Operator page:" in self.graph.output[log:], 25.0, "the page is there again")
        if row.stays_homed:
            self.until(lambda: self.operator.state == "ready", 25.0, "ready again")
        back = time.monotonic()
        return (
            f"{', '.join(row.killed):62} {row.during:9} said after {said - killed:4.1f} s, back after "
            f"{back - killed:4.1f} s, {time.monotonic() - started:4.1f} s in all"
        )


def test_whoever_reads_pictures_asks_for_none_again(running_graph: Any, operator: Operator) -> None:
    """A reliable reader of a fast topic that was restarted after a kill may hang forever, in Fast DDS."""
    kinds = ("image_raw", "camera_info", "corners")
    topics = [f"/stereo/{side}/{kind}" for side in ("left", "right") for kind in kinds]
    expected = {
        "/stereo/left/image_raw": {"corners_left", "stereo", "stylus_tracker", "recognition"},
        "/stereo/right/image_raw": {"corners_right", "stereo", "stylus_tracker"},
    }
    # Without a reader of its points stereo takes no images, nor corners, without whose reader none are found.
    operator.ros.collect(operator.node, PointCloud2, "/stereo/points2", qos.RESULTS)
    found = operator.node.get_subscriptions_info_by_topic
    for topic, names in expected.items():
        operator.ros.spin_until(lambda t=topic, n=names: n <= {info.node_name for info in found(t)}, 20.0)
    asking = [
        f"{info.node_name}: {topic}"
        for topic in topics
        for info in found(topic)
        if info.qos_profile.reliability is not qos.PICTURES.reliability
    ]
    assert not asking


def test_any_program_may_be_killed_at_any_time(running_graph: Any, operator: Operator) -> None:
    scene = Scene(running_graph, operator)
    every = set(scene.pids())
    assert every == {name for row in TABLE for name in row.killed}
    for row in TABLE:
        for _ in range(3):
            print("\n" + scene.play(row), end="", flush=True)
            if not scene.interrupted:
                break
        assert not scene.interrupted, f"{row.killed}: never ended by what was killed itself"
    scene.prepare()
    scene.until(lambda: operator.state == "ready", 30.0, "ready again")
    scene.until(lambda: len(scene.pids()) == len(every), 10.0, "all run")
    for number in range(2):
        start = len(running_graph.truth_log())
        operator.command.publish(String(data=f"press:RUN_STOP id=after-{number}"))
        result = operator.answer(f"after-{number}")
        assert result.outcome is Outcome.REACHED, f"{result}\n{running_graph.tail()}"
        events = running_graph.truth_log()[start:]
        assert [e["control"] for e in events if e["event"] == "press"] == ["RUN_STOP"]
