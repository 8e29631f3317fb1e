"""Processes of a graph under a clock of the test's own, with their output and events."""

from __future__ import annotations

import os
import signal
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from icu_bringup.adapters import processes
from icu_bringup.adapters.processes import ProcessGroup

PYTHON = [sys.executable, "-u", "-S", "-c"]


@pytest.fixture(autouse=True)
def interruptible() -> Iterator[None]:
    """A shell that starts the tests in its background lets them, and what they start, ignore SIGINT."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


class Clock:
    """Bring-up's clock, which runs only where the test says so: however long a busy computer takes, nothing is late."""

    now = 0.0

    def monotonic(self) -> float:
        return self.now


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    clock = Clock()
    monkeypatch.setattr(processes, "time", clock)
    return clock


class Watch:
    def __init__(self, **options: float) -> None:
        self.output: list[tuple[str, str]] = []
        self.events: list[tuple[str, str]] = []
        self.group = ProcessGroup(
            os.environ,
            lambda name, line: self.output.append((name, line)),
            lambda name, text: self.events.append((name, text)),
            **options,  # type: ignore[arg-type]
        )

    def until(self, condition: Callable[[], object], within_s: float = 30.0) -> None:
        deadline = time.monotonic() + within_s
        while not condition():
            assert time.monotonic() < deadline, f"output {self.output}, events {self.events}"
            self.group.watch(0.05)

    def until_ready(self) -> None:
        self.until(lambda: self.group._programs[0].ready)

    def until_it_shows_life(self) -> None:
        self.until(lambda: self.group._programs[0].silence_s == 0.0)


def alive(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return state_of(pid) != "Z"


def state_of(pid: int) -> str:
    return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
