"""Delays of the guard's sockets: a question and its answer, and a stop until its byte is on the port."""

from __future__ import annotations

import contextlib
import os
import pty
import select
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import numpy.typing as npt

from gantry_driver.adapters.guard.client import GuardLink
from gantry_driver.adapters.guard.places import guard_path
from gantry_driver.core.configuration.machine_config import DriverConfig
from gantry_driver.core.guard.messages import config_values, frame
from icu_common.adapters.direct_stop.line import guard_folder, send_stop

COUNT = 3000
APART_S = 0.002
"""Seconds between two stops, which is no flood."""
WITHIN_S = 10.0
HOLD = b"!"


def questions(count: int = COUNT) -> npt.NDArray[np.float64]:
    """Return the seconds from a query to its answer over the guard's socket, (n,)."""
    link = GuardLink(
        DriverConfig(port=f"/dev/none{os.getpid()}"), lambda events: None, stop_path=guard_folder() / "bench"
    )
    link.start()
    try:
        end = time.monotonic() + WITHIN_S
        while link.ask("home").endswith("not opened yet"):
            if time.monotonic() > end:
                raise RuntimeError("the guard has not started")
            time.sleep(0.01)
        times = []
        for _ in range(count):
            begin = time.perf_counter()
            link.ask("home")
            times.append(time.perf_counter() - begin)
            time.sleep(0.001)
        return np.array(times)
    finally:
        link.close("the benchmark has ended")


def stops(count: int = COUNT) -> npt.NDArray[np.float64]:
    """Return the seconds from a stop's datagram to the hold's byte on the port, (n,).

    The port is a pseudo-terminal whose other end is this process. No board answers, so the guard keeps connecting; it
    writes a hold ahead of everything else all the same.
    """
    master, slave = pty.openpty()
    os.set_blocking(master, False)
    port, path = os.ttyname(slave), guard_folder() / f"stop_bench_{os.getpid()}"
    times = []
    try:
        with _guard(port, path):
            _until_opened(master)
            for _ in range(count):
                _drain(master)
                begin = time.perf_counter()
                if not send_stop(path, "stop requested"):
                    raise RuntimeError("no guard has received the stop")
                _await_hold(master)
                times.append(time.perf_counter() - begin)
                time.sleep(APART_S)
    finally:
        os.close(master)
        os.close(slave)  # open until now: without it, the other end is no terminal while the guard starts
    return np.array(times)


@contextlib.contextmanager
def _guard(port: str, stops_at: Path) -> Iterator[None]:
    """Run a guard with a node that keeps silent and does not move: it is at rest, so its silence is no stop."""
    guard = subprocess.Popen([sys.executable, "-m", "gantry_driver.cli.gantry_guard", "--port", port])
    node = socket.socket(socket.AF_UNIX)
    try:
        end = time.monotonic() + WITHIN_S
        while node.connect_ex(bytes(guard_path(port))):
            if time.monotonic() > end:
                raise RuntimeError("the guard has not started")
            time.sleep(0.01)
        config = config_values(DriverConfig(port=port, connect_timeout_s=60.0))
        values = {"time_s": None, "enabled": False, "active": True, "left_down": False, "stop_path": str(stops_at)}
        node.sendall(frame({"do": "hello", "config": config, **values}))
        yield
    finally:
        guard.terminate()
        guard.wait(WITHIN_S)
        node.close()


def _until_opened(master: int) -> None:
    """Wait for the first byte of the guard."""
    if not select.select([master], [], [], WITHIN_S)[0]:
        raise RuntimeError("the guard has not opened the port")


def _drain(master: int) -> None:
    with contextlib.suppress(BlockingIOError):
        while os.read(master, 4096):
            pass


def _await_hold(master: int) -> None:
    end = time.monotonic() + WITHIN_S
    while time.monotonic() < end:
        if select.select([master], [], [], WITHIN_S)[0] and HOLD in os.read(master, 4096):
            return
    raise RuntimeError("no hold arrived at the port")
