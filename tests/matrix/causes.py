"""Causes each fault, and ends it."""

from __future__ import annotations

import contextlib
import os
import random
import resource
import signal
import socket
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from urllib.parse import urlsplit

from matrix.cells import CLOCK, GUARD, Cell
from matrix.stage import Stage

from gantry_driver.adapters.guard.places import guard_path
from gantry_driver.core.guard.messages import frame

STOPPED_S = {"stop 1 s": 1.0, "stop 60 s": 60.0}
FLOOD_S = 3.0
WATCH_S = 6.0
"""Seconds for which a run is watched after its cause, besides those of a stop."""
_QUIET = ("/parameter_events", "/rosout", "/clock")
FLOOD_COUNT = 2000


class NoInput(Exception):
    """A program that has no topic to flood."""


Begin = Callable[[], float]
"""Causes a fault and returns the seconds that it lasts."""


@contextlib.contextmanager
def prepared(stage: Stage, cell: Cell, rng: random.Random) -> Iterator[Begin]:
    """Prepare a cell's fault before the machine is in its phase; yield what causes it, and end it."""
    if cell.fault == "kill":
        yield lambda: _signalled(_pid(stage, cell), signal.SIGKILL, 0.0)
    elif cell.fault in STOPPED_S:
        pid = _pid(stage, cell)
        try:
            yield lambda: _signalled(pid, signal.SIGSTOP, STOPPED_S[cell.fault])
        finally:
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGCONT)
    elif cell.fault == "disk full":
        pid = _pid(stage, cell)
        try:
            yield lambda: _limited(pid)
        finally:
            with contextlib.suppress(ProcessLookupError):
                resource.prlimit(pid, resource.RLIMIT_FSIZE, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
    elif cell.program == GUARD:
        yield lambda: _to_guard(stage, cell.fault, rng)
    elif cell.program == "ui_bridge" and rng.random() < 0.5:
        yield lambda: _to_page(stage, cell.fault, rng)
    else:
        with _stranger(stage, cell, rng) as begin:
            yield begin


def _pid(stage: Stage, cell: Cell) -> int:
    return stage.pids()[cell.program]


def _signalled(pid: int, number: int, lasts_s: float) -> float:
    os.kill(pid, number)
    return lasts_s


def _limited(pid: int) -> float:
    resource.prlimit(pid, resource.RLIMIT_FSIZE, (0, resource.RLIM_INFINITY))
    return FLOOD_S


@contextlib.contextmanager
def _stranger(stage: Stage, cell: Cell, rng: random.Random) -> Iterator[Begin]:
    """Start a foreign program; it publishes only on request, so its start is no part of the measured time."""
    kind, topic, type_name = cell.fault, "/clock", "rosgraph_msgs/msg/Clock"
    if kind == CLOCK:
        kind = "clock"
    else:
        topic, type_name = _input_of(stage, cell.program, rng)
    command = [sys.executable, str(Path(__file__).with_name("stranger.py")), kind, topic, type_name]
    command += [f"{FLOOD_S:g}", str(rng.randrange(2**31))]
    pipe = subprocess.PIPE
    with subprocess.Popen(command, env=stage.graph.environment, stdin=pipe, stdout=pipe) as process:
        assert process.stdout is not None and process.stdin is not None
        told = process.stdin

        def begin() -> float:
            told.write(b"begin\n")
            told.flush()
            return FLOOD_S

        try:
            assert process.stdout.readline() == b"ready\n", command
            yield begin
        finally:
            process.kill()


def _input_of(stage: Stage, program: str, rng: random.Random) -> tuple[str, str]:
    found = stage.operator.node.get_subscriber_names_and_types_by_node(program, stage.namespace(program))
    inputs = sorted((topic, types[0]) for topic, types in found if topic not in _QUIET)
    if not inputs:
        raise NoInput(program)
    return rng.choice(inputs)


def _to_guard(stage: Stage, fault: str, rng: random.Random) -> float:
    """Send frames or noise to the guard's socket; a second connection is refused, but its bytes arrive."""
    data = FLOOD_COUNT * frame({"do": "beat"}) if fault == "flood" else rng.randbytes(65536)
    for _ in range(50 if fault == "flood" else 5):
        with contextlib.suppress(OSError), socket.socket(socket.AF_UNIX) as connection:
            connection.settimeout(0.1)
            connection.connect(bytes(guard_path(str(stage.graph.run_dir / "grbl"))))
            connection.sendall(data)
    return 0.0


def _to_page(stage: Stage, fault: str, rng: random.Random) -> float:
    """Send requests with wrong tokens, or noise, to the page's server."""
    parts = urlsplit(stage.graph.page_address())
    for _ in range(200 if fault == "flood" else 20):
        request = f"GET /?token={rng.getrandbits(256):064x} HTTP/1.1\r\nHost: {parts.netloc}\r\n\r\n".encode()
        with contextlib.suppress(OSError), socket.create_connection(("127.0.0.1", parts.port or 80), 0.5) as made:
            made.sendall(request if fault == "flood" else rng.randbytes(4096))
            made.settimeout(0.05)
            made.recv(4096)
    return 0.0
