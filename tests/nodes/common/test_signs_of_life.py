"""A program of the graph sends bring-up a sign of life each second, and none while it is held up."""

from __future__ import annotations

import os
import select
import subprocess
import sys
import time
from collections.abc import Iterator

import pytest

# Waits for a line, as a loop in native code that has released the interpreter's lock; after some holds that lock.
PROGRAM = """
import ctypes, functools, sys
from rclpy.node import Node
from icu_common.nodes import runtime
from icu_common.nodes.runtime import run

if sys.argv[1:]:
    runtime.SignsOfLife = functools.partial(runtime.SignsOfLife, longest_turn_s=float(sys.argv[1]))

class Hangs(Node):
    def __init__(self, **options):
        super().__init__("hangs", **options)
        self.create_timer(0.1, self._once)

    def _once(self):
        print("waits", flush=True)
        if sys.stdin.readline() == "hold the lock\\n":
            print("hangs", flush=True)
            ctypes.PyDLL(None).sleep(60)

sys.exit(run(Hangs, []))
"""


class Life:
    """The reading end of the pipe, and the program."""

    def __init__(self, domain: int, *longest_turn_s: str) -> None:
        self.pipe, told = os.pipe()
        environment = {**os.environ, "ROS_DOMAIN_ID": str(domain), "ICU_READY_FD": str(told)}
        self.program = subprocess.Popen(
            [sys.executable, "-c", PROGRAM, *longest_turn_s],
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

    def falls_silent(self) -> None:
        deadline = time.monotonic() + 15.0
        while self.sign_within(2.0):  # what was on its way
            assert time.monotonic() < deadline, "signs still come"
        assert self.program.poll() is None

    def says(self) -> str:
        assert self.program.stdout is not None
        return self.program.stdout.readline().strip()

    def hears(self, line: str) -> None:
        assert self.program.stdin is not None
        self.program.stdin.write(f"{line}\n")
        self.program.stdin.flush()

    def close(self) -> None:
        self.program.kill()
        self.program.communicate(timeout=10.0)
        os.close(self.pipe)


@pytest.fixture
def life(domain: int, request: pytest.FixtureRequest) -> Iterator[Life]:
    """A program whose callbacks may last as long as the parameter says, as elsewhere without one."""
    life = Life(domain, *map(str, getattr(request, "param", ())))
    try:
        yield life
    finally:
        life.close()


def test_signs_of_life_come_while_a_callback_waits_and_stop_when_the_interpreter_is_held(life: Life) -> None:
    assert life.sign_within(30.0), "it is ready"
    assert life.says() == "waits"
    for _ in range(2):
        assert life.sign_within(10.0), "a callback that takes long is no hang"
    life.hears("hold the lock")
    assert life.says() == "hangs"
    life.falls_silent()


@pytest.mark.parametrize("life", [[3.0]], indirect=True)
def test_signs_of_life_stop_for_a_callback_that_lasts_too_long_though_the_interpreter_runs(life: Life) -> None:
    assert life.sign_within(30.0), "it is ready"
    assert life.says() == "waits"
    life.falls_silent()
    begin = time.monotonic()
    while time.monotonic() - begin < 5.0:  # longer than a turn may take
        life.hears("go on")
        assert life.says() == "waits"
        assert life.sign_within(10.0), "it works again"
