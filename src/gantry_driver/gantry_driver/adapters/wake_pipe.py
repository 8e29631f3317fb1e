"""A pipe that wakes a polling thread: for new work, and for the signals that stop the machine."""

from __future__ import annotations

import contextlib
import os
import signal

STOP_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
_NAMES = {int(number): number.name for number in STOP_SIGNALS}


class WakePipe:
    """A non-blocking pipe.

    Attributes
    ----------
    read_fd
        Descriptor for the thread to poll.
    write_fd
        Descriptor for ``signal.set_wakeup_fd``, which writes a signal's number to it; -1 after :meth:`close`.
    """

    def __init__(self) -> None:
        self.read_fd, self.write_fd = os.pipe()
        for end in (self.read_fd, self.write_fd):
            os.set_blocking(end, False)

    def wake(self) -> None:
        """Wake the thread."""
        with contextlib.suppress(BlockingIOError, OSError):  # a full pipe wakes it anyway
            os.write(self.write_fd, b"\0")

    def drain(self) -> list[str]:
        """Empty the pipe; return the names of the stop signals that were written to it."""
        written = b""
        with contextlib.suppress(BlockingIOError):  # another thread has emptied it
            written = os.read(self.read_fd, 4096)
        return [_NAMES[number] for number in set(written) & _NAMES.keys()]

    def close(self) -> None:
        """Close the pipe; :meth:`wake` then does nothing."""
        write, self.write_fd = self.write_fd, -1
        os.close(write)
        os.close(self.read_fd)
