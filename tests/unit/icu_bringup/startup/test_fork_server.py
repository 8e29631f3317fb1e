"""Programs that are forked from one process with their imports are as those that are executed."""

from __future__ import annotations

import os
import signal
import socket
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from icu_bringup.adapters.fork_server import ForkServer, is_forkable
from icu_bringup.adapters.processes import ProcessGroup

pytestmark = pytest.mark.slow

DEADLINE_S = 60.0
PROGRAM = f"""#!{sys.executable}
import os, signal, sys, threading
print("arguments", sys.argv[1:], __name__)
print("parent", os.getppid(), "session", os.getsid(0) == os.getpid(), "input", os.read(0, 1))
print("variables", os.environ.get("OF_GROUP"), os.environ.get("ICU_AFTER_CRASH"))
print("numpy is there", "numpy" in sys.modules)
print("mask", signal.pthread_sigmask(signal.SIG_BLOCK, []), "threads", len(os.listdir("/proc/self/task")))
os.write(int(os.environ["ICU_READY_FD"]), b"1")
print("error line", file=sys.stderr)
if sys.argv[1] == "exit":
    import atexit
    atexit.register(os.abort)  # a thread that crashes while the interpreter is taken down
    sys.exit(int(sys.argv[2]))
if sys.argv[1] == "leave":
    import subprocess
    child = subprocess.Popen([sys.executable, "-c", "import sys; sys.stdin.read()"], stdin=subprocess.PIPE)
    print("child", child.pid, flush=True)
if sys.argv[1] == "raise":
    raise ValueError("a traceback")
print("waits", flush=True)
try:
    signal.pause()
except KeyboardInterrupt:
    print("interrupted")
"""


class Group:
    def __init__(self, folder: Path) -> None:
        self.stopped = False
        self.output: list[tuple[str, str]] = []
        self.events: list[tuple[str, str]] = []
        environment = {**os.environ, "OF_GROUP": "yes", "PYTHONUNBUFFERED": "1"}
        self.server = ForkServer(environment)
        self.group = ProcessGroup(
            environment,
            lambda name, line: self.output.append((name, line)),
            lambda name, text: self.events.append((name, text)),
            forks=self.server,
        )
        self.script = folder / "lib" / "of_the_test" / "program"
        self.script.parent.mkdir(parents=True)
        self.script.write_text(PROGRAM)
        self.script.chmod(0o755)

    def start(self, name: str, *arguments: str) -> None:
        self.group.start(name, [str(self.script), *arguments], tells_ready=True)

    def until(self, condition: Callable[[], object]) -> None:
        deadline = time.monotonic() + DEADLINE_S
        while not condition():
            assert time.monotonic() < deadline, f"{self.output} {self.events}"
            self.group.watch(0.02)

    def stop(self) -> list[str]:
        self.stopped = True
        return self.group.stop()

    def lines(self, name: str) -> list[str]:
        return [line for of, line in self.output if of == name]


@pytest.fixture
def group(tmp_path: Path) -> Iterator[Group]:
    # A shell that starts the tests in its background lets them, and what they start, ignore SIGINT.
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    group = Group(tmp_path)
    yield group
    if not group.stopped:
        group.group.stop()
    signal.signal(signal.SIGINT, before)


def test_a_forked_program_is_as_one_that_was_executed(group: Group) -> None:
    group.start("a", "wait", "-r", "x:=y")
    group.until(lambda: ("a", "waits") in group.output)
    pid = group.group.running()["a"]
    assert group.lines("a") == [
        "arguments ['wait', '-r', 'x:=y'] __main__",
        f"parent {os.getpid()} session True input b''",
        "variables yes None",
        "numpy is there False",
        "mask set() threads 1",
        "error line",
        "waits",
    ]
    words = Path(f"/proc/{pid}/cmdline").read_bytes().rstrip(b"\0").split(b"\0")
    assert [os.fsdecode(word) for word in words] == [sys.executable, str(group.script), "wait", "-r", "x:=y"]
    assert Path(f"/proc/{pid}/comm").read_text() == "program\n"
    group.until(lambda: group.group.ready_count() == 1)
    assert group.stop() == []
    assert group.lines("a")[-1] == "interrupted"
    assert not Path(f"/proc/{pid}").exists()


def test_exit_codes_and_signals_reach_bring_up(group: Group) -> None:
    group.start("misconfigured", "exit", "2")
    group.start("raises", "raise")
    group.start("killed", "wait")
    group.until(lambda: ("killed", "waits") in group.output)
    os.kill(group.group.running()["killed"], signal.SIGKILL)
    group.until(lambda: len(group.events) == 3)
    assert {name: text.split(",")[0] for name, text in group.events} == {
        "misconfigured": "ended with exit code 2 and is not restarted: mend its configuration",
        "raises": "ended with exit code 1",
        "killed": "ended with signal SIGKILL",
    }
    assert "ValueError: a traceback" in group.lines("raises")
    group.until(lambda: group.lines("killed").count("waits") == 2)
    assert "variables yes 1" in group.lines("killed"), "it is told that its predecessor crashed"


def test_without_the_server_programs_start_all_the_same(group: Group) -> None:
    group.start("a", "wait")
    group.until(lambda: ("a", "waits") in group.output)
    group.server._process.kill()
    group.until(lambda: not group.server.runs)
    assert group.group.running().keys() == {"a"}, "what it has started goes on"
    group.start("b", "wait")
    group.until(lambda: ("b", "waits") in group.output)


def test_a_server_that_ends_before_it_forks_is_an_end_of_the_program(group: Group) -> None:
    group.server._process.send_signal(signal.SIGSTOP)
    group.start("a", "wait")
    group.server._process.kill()
    group.until(lambda: ("a", "waits") in group.output)
    assert group.events == [("a", "ended with exit code 1, restarted at once")]


def test_requests_wait_until_the_server_takes_them(group: Group) -> None:
    """It may be importing for a second, and a system may allow ten requests that are not read."""
    group.server._process.send_signal(signal.SIGSTOP)
    group.server._socket.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 4096)
    names = [f"program_{number}" for number in range(12)]
    for name in names:
        group.start(name, "wait", "x" * 1000)
    assert 0 < len(group.server._unsent) < len(names)
    group.server._process.send_signal(signal.SIGCONT)
    group.until(lambda: all((name, "waits") in group.output for name in names))
    assert group.stop() == [] and group.group.running() == {}


def test_stop_leaves_no_program_that_was_still_to_be_forked(group: Group) -> None:
    group.server._process.send_signal(signal.SIGSTOP)
    group.start("a", "wait")
    begun = time.monotonic()
    group.server._process.send_signal(signal.SIGCONT)
    assert group.stop() == []
    assert time.monotonic() - begun < DEADLINE_S / 2
    assert group.server._process.poll() is not None
    assert group.group.running() == {}


def test_only_scripts_of_this_interpreter_are_forked(tmp_path: Path) -> None:
    for first, forkable in ((f"#!{sys.executable}", True), ("#!/bin/sh", False), ("#!/usr/bin/env python3", False)):
        (tmp_path / "script").write_text(f"{first}\n")
        assert is_forkable([str(tmp_path / "script")]) is forkable
    assert not is_forkable([str(tmp_path / "missing")])


def test_what_a_killed_program_leaves_behind_is_no_child_for_ever(group: Group) -> None:
    """Its child ends with it; bring-up, which is the parent then, takes the exit code."""
    group.start("parent", "leave")
    group.until(lambda: any(line.startswith("child") for line in group.lines("parent")))
    child = int(next(line for line in group.lines("parent") if line.startswith("child")).split()[1])
    os.kill(group.group.running()["parent"], signal.SIGKILL)
    group.until(lambda: not Path(f"/proc/{child}").exists())
    group.until(lambda: ("parent", "ended with signal SIGKILL, restarted at once") in group.events)
