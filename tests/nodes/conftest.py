"""Nodes in one process: a private context, a domain of the worker's own, waiting on conditions."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import rclpy
from nodes.bag_programs import Command, Start
from rclpy.context import Context
from rclpy.duration import Duration
from ros_rig import Ros, domain_of_worker

from icu_common.nodes import qos
from icu_common.nodes.runtime import prepare_transport


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
    # A command dies on its way after a second. Whoever sends it here may be held up for longer before it is taken.
    monkeypatch.setattr(qos.COMMAND, "lifespan", Duration(seconds=60))
    prepare_transport()
    context = Context()
    rclpy.init(context=context, domain_id=domain)
    rig = Ros(context)
    try:
        yield rig
    finally:
        rig.close()
        rclpy.shutdown(context=context)


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
