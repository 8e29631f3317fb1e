"""Nodes in one process: a private context, a domain of the worker's own, waiting on conditions."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from nodes.bag_programs import Command, Start
from rclpy.duration import Duration
from support.ros_rig import Ros, domain_of_worker, participant

from icu_common.nodes import qos


@pytest.fixture
def domain() -> int:
    """The ROS domain of a test; a file may have one of its own."""
    return domain_of_worker()


@pytest.fixture
def hang_up() -> Iterator[None]:
    """Let SIGHUP end what a test starts; under ``nohup`` tests ignore it, and what they start would, too."""
    before = signal.signal(signal.SIGHUP, lambda *_: None)
    yield
    signal.signal(signal.SIGHUP, before)


@pytest.fixture
def ros(domain: int, tmp_path: Any, monkeypatch: pytest.MonkeyPatch) -> Iterator[Ros]:
    """A private rclpy context on a domain of its own, discovery on this host only."""
    monkeypatch.setenv("ROS_LOG_DIR", str(tmp_path / "ros_log"))
    # A command dies on its way after a second. The sender here may be held up for longer before it is taken.
    monkeypatch.setattr(qos.COMMAND, "lifespan", Duration(seconds=60))
    with participant(domain) as rig:
        yield rig


@pytest.fixture
def command(ros: Ros, tmp_path: Path) -> Iterator[Start]:
    """Start bag programs that do not outlive the test."""
    started: list[Command] = []

    def start(name: str, *arguments: str) -> Command:
        started.append(Command(ros, tmp_path, name, arguments))
        return started[-1]

    yield start
    for program in started:
        with program.process:
            program.process.kill()
