"""The pipe that wakes a thread and brings it the stop signals."""

from __future__ import annotations

import contextlib
import os
import signal

from gantry_driver.adapters.wake_pipe import WakePipe


def test_an_empty_pipe_brings_no_signal() -> None:
    """Two threads may see the pipe readable, and the first one empties it."""
    with contextlib.closing(WakePipe()) as pipe:
        os.write(pipe.write_fd, bytes([signal.SIGTERM]))
        assert pipe.drain() == ["SIGTERM"]
        assert pipe.drain() == []


def test_being_woken_is_no_stop() -> None:
    with contextlib.closing(WakePipe()) as pipe:
        pipe.wake()
        assert pipe.drain() == []
