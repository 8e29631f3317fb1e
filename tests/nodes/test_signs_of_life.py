"""A program of the graph tells bring-up each second that its interpreter runs, and no longer when it is held up."""

from __future__ import annotations

import os
import select
import subprocess
import sys
import time
from collections.abc import Iterator

import pytest

# Waits in Python for a line; then holds the interpreter's lock as a loop in native code would.
PROGRAM = """
import ctypes, sys
from rclpy.node import Node
from icu_common.nodes.runtime import run

class Hangs(Node):
    def __init__(self, **options):
        super().__init__("hangs", **options)
        self.create_timer(0.1, self._once)

    def _once(self):
        print("waits", flush=True)
        sys.stdin.readline()
        print("hangs", flush=True)
        ctypes.PyDLL(None).sleep(60)

sys.exit(run(Hangs, []))
"""


class Life:
    """The reading end of the pipe, and the program."""

    def __init__(self, domain: int) -> None:
        self.pipe, told = os.pipe()
        environment = {**os.environ, "ROS_DOMAIN_ID": str(domain), "ICU_READY_FD": str(told)}
        self.program = subprocess.Popen(
            [sys.executable, "-c", PROGRAM],
            env=environment,
            pass_fds=[told],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        os.close(told)

    def sign_within(self, seconds: float) -> bool:
        """Whether a sign of life comes; it is taken."""
        return bool(select.select([self.pipe], [], [], seconds)[0]) and os.read(self.pipe, 1) != b""

    def says(self) -> str:
        assert self.program.stdout is not None
        return self.program.stdout.readline().strip()


@pytest.fixture
def life(domain: int) -> Iterator[Life]:
    life = Life(domain)
    try:
        yield life
    finally:
        life.program.kill()
        life.program.communicate(timeout=10.0)
        os.close(life.pipe)


def test_signs_of_life_come_while_a_callback_waits_and_stop_when_the_interpreter_is_held(life: Life) -> None:
    assert life.sign_within(30.0), "it is ready"
    assert life.says() == "waits"
    for _ in range(2):
        assert life.sign_within(10.0), "a callback that takes long is no hang"
    assert life.program.stdin is not None
    life.program.stdin.write("go on\n")
    life.program.stdin.flush()
    assert life.says() == "hangs"
    deadline = time.monotonic() + 10.0
    while life.sign_within(2.0):  # what was on its way
        assert time.monotonic() < deadline, "signs still come"
    assert life.program.poll() is None
