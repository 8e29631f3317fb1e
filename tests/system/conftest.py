"""The whole graph as separate processes on the simulated bench, for tests that use it as a user does."""

from __future__ import annotations

import contextlib
import json
import os
import re
import select
import signal
import socket
import subprocess
import time
from collections.abc import Callable, Generator, Iterator
from pathlib import Path
from typing import Any

import pytest
from support.line_socket import BoardSocket, LineSocket
from support.ros_rig import domain_of_worker
from system.operator_browser import browser  # noqa: F401
from system.terminal_operator import operator  # noqa: F401

from icu_common.core.admission.heartbeats import PROGRAMS

ROOT = Path(__file__).resolve().parents[2]
INSTALL = ROOT / "ros2_ws" / "install"


def executable(package: str, name: str) -> str:
    """Return the path of a built program, as a user would start it."""
    path = INSTALL / package / "lib" / package / name
    if not path.is_file():
        pytest.fail(f"{path.relative_to(ROOT)} is not built; run scripts/setup.sh dev")
    return str(path)


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def wait_for(condition: Callable[[], Any], within_s: float, what: str, describe: Callable[[], Any] = lambda: "") -> Any:
    """Return the first true value of ``condition()``; fail with what was seen after ``within_s``."""
    deadline = time.monotonic() + within_s
    while True:
        late = time.monotonic() > deadline  # who was held up looks once more
        if value := condition():
            return value
        if late:
            pytest.fail(f"{what}: not within {within_s:g} s; {describe()}")
        select.select([], [], [], 0.05)


class RunningGraph:
    """A graph that bring-up started; its output, its page, its truth."""

    def __init__(self, folder: Path, domain: int, *extra: str) -> None:
        self.folder = folder
        self.prepared = False
        self.run_dir = folder / "run"
        self.scopes = folder / "scopes"
        """Where layouts go that are taught on the page."""
        self.port = free_port()
        self.environment = {
            **os.environ,
            "ROS_DOMAIN_ID": str(domain),
            "ROS_LOG_DIR": str(folder / "ros_log"),
            "PYTHONUNBUFFERED": "1",
        }
        self._log_path = folder / "bring_up.log"
        command = [
            executable("icu_bringup", "bring_up"),
            "--profile",
            "test",
            "--verbose",
            "--config",
            str(ROOT / "config"),
        ]
        command += ["--state", str(folder / "state"), "--run-dir", str(self.run_dir)]
        command += ["--set", f"ui_bridge.port={self.port}", "--set", f"recognition.teach_folder={self.scopes}", *extra]
        with self._log_path.open("wb") as log:
            self.process = subprocess.Popen(command, env=self.environment, stdout=log, stderr=subprocess.STDOUT)

    @property
    def output(self) -> str:
        return self._log_path.read_text(errors="replace")

    def tail(self) -> str:
        lines = self.output.splitlines()
        events = [line for line in lines[:-40] if " ! " in line or "WARN" in line or "ERROR" in line]
        return "\n".join(["events and last lines of the graph:", *events[-40:], *lines[-40:]])

    def wait(self, condition: Callable[[], Any], within_s: float, what: str) -> Any:
        """Wait for a condition; fail early when bring-up has ended."""

        def checked() -> Any:
            if self.process.poll() is not None:
                pytest.fail(f"bring_up ended with {self.process.returncode}; {self.tail()}")
            return condition()

        return wait_for(checked, within_s, what, self.tail)

    def command(self, package: str, name: str, *arguments: str, within_s: float = 60.0) -> subprocess.CompletedProcess:
        """Run one of the project's command line programs against this graph."""
        return subprocess.run(
            [executable(package, name), *arguments],
            env=self.environment,
            capture_output=True,
            text=True,
            timeout=within_s,
            check=False,
        )

    def prepare(self, within_s: float = 180.0) -> None:
        """Enable, home and calibrate, as `make demo` does."""
        done = self.command("gantry_driver", "gantry_prepare", within_s=within_s)
        assert done.returncode == 0, f"{done.stdout}{done.stderr}\n{self.tail()}"
        self.prepared = True

    def page_address(self) -> str:
        """Return the page's address with its one-shot sign-in."""
        found = self.wait(lambda: re.findall(r"https?://\S+\?token=\S+", self.output), 60.0, "the page's address")
        return str(found[-1])

    def new_page_address(self) -> str:
        """Ask for another sign-in, as docs/how-to/deployment.md says."""
        before = self.output.count("?token=")
        os.kill(self._pid_of("ui_bridge"), signal.SIGUSR1)
        self.wait(lambda: self.output.count("?token=") > before, 30.0, "another sign-in")
        return self.page_address()

    def _pid_of(self, program: str) -> int:
        """Return the process of one program of this graph: a child of bring-up with its name."""
        for status in Path("/proc").glob("[0-9]*/status"):
            with contextlib.suppress(OSError):
                parent = re.search(r"^PPid:\t(\d+)", status.read_text(), re.MULTILINE)
                command = (status.parent / "cmdline").read_bytes().decode(errors="replace").split("\0")
                if parent and int(parent[1]) == self.process.pid and any(Path(c).name == program for c in command):
                    return int(status.parent.name)
        pytest.fail(f"{program} does not run; {self.tail()}")

    def bench(self) -> LineSocket:
        """Connect to the physical truth."""
        return LineSocket(self.run_dir / "bench")

    def board(self) -> BoardSocket:
        """Connect to the mock board's control socket."""
        return BoardSocket(self.run_dir / "board")

    def truth_log(self) -> list[dict[str, Any]]:
        """Return what happened physically: contacts, releases, reactions."""
        return [json.loads(line) for line in (self.run_dir / "truth.jsonl").read_text().splitlines()]

    def board_log(self) -> list[dict[str, Any]]:
        """Return what the mock board received."""
        return [json.loads(line) for line in (self.run_dir / "board.jsonl").read_text().splitlines()]

    def stop(self) -> int:
        """Press Ctrl-C and return bring-up's exit code."""
        self.process.send_signal(signal.SIGINT)
        try:
            return self.process.wait(60.0)
        except subprocess.TimeoutExpired:
            self.process.kill()
            pytest.fail(f"bring_up did not end within 60 s; {self.tail()}")


# A loaded machine shows its pictures late and keeps its pages waiting; what happens then is tested elsewhere.
PATIENT = {
    "frame_max_age_s": 4.0,
    "frame_stale_s": 5.0,
    "recognition_max_age_s": 8.0,
    "keepalive_fresh_s": 1.0,
    "silence_stop_s": 2.0,
    "picture_stop_s": 2.0,
    "jog_hold_s": 1.0,
    "lease_timeout_s": 30.0,
    "answer_timeout_s": 30.0,
}


@pytest.fixture(scope="session")
def started_graph(tmp_path_factory: pytest.TempPathFactory) -> Iterator[RunningGraph]:
    """A graph as it is after its start: neither homed nor calibrated; the tests of a session share it."""
    with _graph(tmp_path_factory.mktemp("graph"), domain_of_worker(50, 40)) as graph:
        yield graph


@pytest.fixture
def new_graph(tmp_path: Path) -> Iterator[RunningGraph]:
    """A graph of the test's own, neither homed nor calibrated."""
    with _graph(tmp_path / "graph", domain_of_worker(50, 40) + 1) as graph:
        yield graph


@pytest.fixture
def workshop_graph(tmp_path: Path) -> Iterator[RunningGraph]:
    """A graph like ``new_graph`` in the room that `make demo` has."""
    with _graph(tmp_path / "graph", domain_of_worker(50, 40) + 1, "--room", "workshop") as graph:
        yield graph


@contextlib.contextmanager
def _graph(folder: Path, domain: int, *extra: str) -> Iterator[RunningGraph]:
    patience = [text for name, value in PATIENT.items() for text in ("--set", f"ui_bridge.{name}={value}")]
    # The tests also run command-line programs next to their operator.
    programs = f"{PROGRAMS} operator"
    nodes = ("serial_driver", "gantry_controller")
    patience += [text for node in nodes for text in ("--set", f"{node}.heartbeat_programs={programs}")]
    folder.mkdir(exist_ok=True)
    graph = RunningGraph(folder, domain, *patience, *extra)
    try:
        yield graph
    finally:
        if graph.process.poll() is None:
            graph.stop()


@pytest.fixture(scope="session")
def running_graph(started_graph: RunningGraph) -> RunningGraph:
    """The graph, prepared (homed, calibrated, panel recognised) by whoever needed it first."""
    if not started_graph.prepared:
        started_graph.prepare()
    return started_graph


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """Show the graph's output with a failure: the fault may be its own."""
    report = yield
    fixtures = getattr(item, "funcargs", {})
    names = ("started_graph", "running_graph", "new_graph", "workshop_graph")
    graph = next((fixtures[name] for name in names if name in fixtures), None)
    if report.failed and graph is not None:
        report.sections.append(("graph", graph.tail()))
    return report


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Put the tests on the shared graph last: it runs until the session ends, and would slow down all others."""
    items.sort(key=lambda item: "started_graph" in getattr(item, "fixturenames", ()))
