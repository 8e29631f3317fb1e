"""The mock board's port: a pseudo-terminal that is plugged in, opened, closed, unplugged, and plugged in again.

The kernel does not report to the master side that the other side was opened, so a closed port is polled.
"""

from __future__ import annotations

import errno
import os
import pty
import select
import selectors
import termios
import tty
from collections.abc import Callable
from pathlib import Path

OPEN_POLL_S = 0.02
_BACKLOG_BYTES = 64 * 1024


class PtyPort:
    """One pseudo-terminal at a time, with a stable link to it.

    Parameters
    ----------
    selector
        Selector for the port's reads.
    link
        Path of a symbolic link to the current port, or None.
    received, opened
        Called with bytes from the host, and after the host has opened the port.
    """

    def __init__(
        self,
        selector: selectors.BaseSelector,
        link: Path | None,
        received: Callable[[bytes], None],
        opened: Callable[[], None],
    ) -> None:
        self._selector = selector
        self._link = link
        self._received = received
        self._opened = opened
        self._master: int | None = None
        self._reading = True
        self._backlog = bytearray()
        self.is_open = False
        self._dtr = self.dtr_rose = False
        """Level of DTR, and whether it rose at the last opening: closing lowers it only if the terminal has HUPCL."""
        self.path = Path()
        if link is not None and link.exists() and not link.is_symlink():
            raise FileExistsError(f"{link} exists and is not a link")
        self.plug()

    @property
    def plugged(self) -> bool:
        """Whether a pseudo-terminal exists."""
        return self._master is not None

    @property
    def waiting(self) -> bool:
        """Whether :meth:`poll` must be called every :data:`OPEN_POLL_S`."""
        return self.plugged and (not self.is_open or bool(self._backlog))

    def plug(self) -> None:
        """Create a new pseudo-terminal and point the link to it."""
        master, slave = pty.openpty()
        tty.setraw(slave)  # no echo before the host has configured it
        modes = termios.tcgetattr(slave)
        modes[2] |= termios.HUPCL  # the initial state of a serial port, but not of a pseudo-terminal
        termios.tcsetattr(slave, termios.TCSANOW, modes)
        self._dtr = False
        self.path = Path(os.ttyname(slave))
        os.close(slave)  # from now on the master hangs up until the host opens the port
        os.set_blocking(master, False)
        self._master = master
        self.is_open = False
        if self._link is not None:
            fresh = self._link.with_name(self._link.name + ".new")
            fresh.unlink(missing_ok=True)
            fresh.symlink_to(self.path)
            fresh.replace(self._link)

    def unplug(self) -> None:
        """Remove the pseudo-terminal; the host's reads and writes fail from now on."""
        if self._master is None:
            return
        if self._link is not None:
            self._link.unlink(missing_ok=True)
        self._set_open(False)
        os.close(self._master)
        self._master = None

    def set_reading(self, reading: bool) -> None:
        """Stop or resume reading from the host; while stopped, the host's writes fill the kernel's buffer."""
        self._reading = reading
        self._register()

    def poll(self) -> None:
        """Detect that the host has opened the port, and write the bytes that could not be written before."""
        if self._master is None:
            return
        if not self.is_open:
            watcher = select.poll()
            watcher.register(self._master, select.POLLIN)
            if not any(events & select.POLLHUP for _, events in watcher.poll(0)):
                self._set_open(True)
                self.dtr_rose, self._dtr = not self._dtr, True
                self._opened()
        elif self._backlog:
            self.write(b"")

    def write(self, data: bytes) -> int:
        """Send bytes to the host; return the number of bytes dropped because no program reads them."""
        if self._master is None or not self.is_open:
            return len(data)
        self._backlog += data
        try:
            del self._backlog[: os.write(self._master, self._backlog)]
        except BlockingIOError:
            pass
        except OSError as error:
            if error.errno != errno.EIO:
                raise
            self._set_open(False)
        dropped = max(len(self._backlog) - _BACKLOG_BYTES, 0)
        del self._backlog[:dropped]
        return dropped

    def drain(self) -> None:
        """Read all bytes that the host has sent."""
        watcher = select.poll()
        while self._master is not None and self.is_open and self._reading:
            watcher.register(self._master, select.POLLIN)
            if not watcher.poll(0):
                return
            self._read()

    def _read(self) -> None:
        assert self._master is not None
        try:
            data = os.read(self._master, 4096)
        except BlockingIOError:
            return
        except OSError as error:
            if error.errno != errno.EIO:
                raise
            data = b""
        if data:
            self._received(data)
        else:
            self._set_open(False)

    def _set_open(self, is_open: bool) -> None:
        if self.is_open and not is_open and self._master is not None:
            self._dtr = not termios.tcgetattr(self._master)[2] & termios.HUPCL
        self.is_open = is_open
        if not is_open:
            self._backlog.clear()
        self._register()

    def _register(self) -> None:
        if self._master is None:
            return
        wanted = self.is_open and self._reading
        if wanted != (self._master in self._selector.get_map()):
            if wanted:
                self._selector.register(self._master, selectors.EVENT_READ, self._read)
            else:
                self._selector.unregister(self._master)
