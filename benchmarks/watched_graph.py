"""Watch the running graph from outside: resource use of its processes, and age of its results."""

from __future__ import annotations

import contextlib
import os
import re
import statistics
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))
from diagnostic_msgs.msg import DiagnosticArray
from sensor_msgs.msg import PointCloud2
from system.conftest import RunningGraph as RunningGraph

from icu_common.nodes import qos
from icu_common.nodes.messages.heads import stamp_ns
from icu_common.nodes.runtime import prepare_transport


@dataclass(frozen=True, slots=True, kw_only=True)
class Usage:
    """Current resource use of one process."""

    cpu_s: float
    memory_mb: float
    files: int
    threads: int


def usage(pid: int) -> Usage:
    """Read the use of one process; memory is the proportional share (PSS), in which a shared page counts once."""
    folder = Path(f"/proc/{pid}")
    fields = (folder / "stat").read_text().rsplit(")", 1)[1].split()
    share = re.search(r"^Pss:\s+(\d+) kB", (folder / "smaps_rollup").read_text(), re.MULTILINE)
    assert share is not None
    return Usage(
        cpu_s=(int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK"),
        memory_mb=int(share[1]) / 1024,
        files=len(list((folder / "fd").iterdir())),
        threads=int(fields[17]),
    )


def programs(parent: int) -> dict[str, int]:
    """Return names (as in graph.yaml) and process ids of the programs that bring-up has started.

    Their child programs are included, such as the guard, a child of the driver.
    """
    found = {}
    for child in _children(parent):
        try:
            words = Path(f"/proc/{child}/cmdline").read_bytes().decode().split("\0")
        except FileNotFoundError:
            continue  # the process has ended meanwhile
        named = [word.removeprefix("__node:=") for word in words if word.startswith("__node:=")]
        named += [name for word in words if (name := _MODULES.get(word))]
        if len(words) > 1:  # a program that has ended has none
            found[named[0] if named else Path(words[1]).name] = child
        found |= programs(child)
    return found


_MODULES = {"icu_bringup.cli.fork_server": "starter", "gantry_driver.cli.gantry_guard": "gantry_guard"}
"""Names of programs started as modules."""


def _children(parent: int) -> list[int]:
    """Return the children of a process; Linux lists them by the thread that started them."""
    found: list[int] = []
    for listed in Path(f"/proc/{parent}/task").glob("*/children"):
        with contextlib.suppress(FileNotFoundError, ProcessLookupError):
            found += map(int, listed.read_text().split())
    return sorted(found)


class Watcher:
    """A node outside the graph that records the age of corners on arrival, and the nodes' reports.

    Without ``corners`` it only receives the reports: a subscriber to corners makes the graph compute them.
    """

    def __init__(self, corners: bool = True) -> None:
        self._node = Node("watcher")
        self.ages_ms: list[float] = []
        self.reports: dict[str, tuple[float, dict[str, str]]] = {}
        """Time (monotonic s) and values of each node's last report, by the name of its status."""
        if corners:
            self._node.create_subscription(PointCloud2, "/stereo/left/corners", self._on_corners, qos.RESULTS)
        self._node.create_subscription(DiagnosticArray, "/diagnostics", self._on_report, qos.RESULTS)
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self._node)

    def _on_corners(self, cloud: PointCloud2) -> None:
        self.ages_ms.append((self._node.get_clock().now().nanoseconds - stamp_ns(cloud.header.stamp)) / 1e6)

    def _on_report(self, message: DiagnosticArray) -> None:
        for status in message.status:
            self.reports[status.name] = time.monotonic(), {pair.key: pair.value for pair in status.values}

    def spin(self, seconds: float, until: Callable[[], Any] = lambda: False) -> None:
        """Spin the node for a duration, or until a condition holds."""
        end = time.monotonic() + seconds
        while time.monotonic() < end and not until():
            self._executor.spin_once(timeout_sec=0.05)

    def close(self) -> None:
        self._executor.shutdown()
        self._node.destroy_node()


@contextmanager
def watched(
    folder: Path,
    domain: int,
    *extra: str,
    corners: bool = True,
    started: Callable[[int], None] = lambda pid: None,
    within_s: float = 180.0,
    real_time: bool = True,
) -> Iterator[tuple[RunningGraph, Watcher]]:
    """Start the graph on the simulated bench, home and calibrate it, and return a watcher.

    ``extra`` is passed to bring_up. ``started`` is called with its process before that starts others. ``corners`` is
    for :class:`Watcher`, ``within_s`` limits the preparation. Delays and rates can be measured in ``real_time`` only.
    """
    os.environ["ROS_DOMAIN_ID"] = str(domain)
    prepare_transport()
    graph = RunningGraph(folder, domain, *["--real-time"] * real_time, *extra)
    started(graph.process.pid)
    rclpy.init()
    watcher = Watcher(corners)
    try:
        graph.prepare(within_s)
        yield graph, watcher
    finally:
        watcher.close()
        rclpy.try_shutdown()  # Ctrl-C has already shut it down
        if graph.process.poll() is None:
            graph.stop()


def press(graph: RunningGraph, control: str) -> dict[str, float]:
    """Press a control by the command-line program; return time and error.

    Raises
    ------
    RuntimeError
        If it was not reached, with the program's output.
    """
    done = graph.command("gantry_driver", "gantry_goal", "--control", control)
    found = re.search(r"reached(?: \(\w+\))?: .* error ([\d.]+) mm.* ([\d.]+) s", done.stdout)
    if done.returncode != 0 or found is None:
        raise RuntimeError(f"{control} was not pressed: {done.stdout}{done.stderr}")
    return {"error_mm": float(found[1]), "duration_s": float(found[2])}


def median(values: list[float]) -> float:
    """Return the median, NaN if there are no values."""
    return statistics.median(values) if values else float("nan")
