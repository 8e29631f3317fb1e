"""Transfer from the ROS thread to the event loop without waiting: newest value of each name, and results in order."""

from __future__ import annotations

import asyncio
import logging
import threading
from collections import deque
from collections.abc import Callable
from typing import Any

_LOG = logging.getLogger(__name__)


class Mailbox:
    """Calls functions in the loop's thread.

    A late loop receives only the newest value of each name, so images cannot pile up.

    Parameters
    ----------
    loop
        The event loop; posting after it has closed does nothing.
    """

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        self._loop = loop
        # A signal handler may post while its own thread is posting: with a plain lock it would deadlock.
        self._lock = threading.RLock()
        self._newest: dict[str, tuple[Callable[..., None], tuple[Any, ...]]] = {}
        self._ordered: deque[tuple[Callable[..., None], tuple[Any, ...]]] = deque()
        self._awake = False

    def newest(self, name: str, function: Callable[..., None], *arguments: Any) -> None:
        """Call ``function(*arguments)`` soon, unless a newer value of this name arrives first."""
        with self._lock:
            self._newest[name] = (function, arguments)
        self._wake()

    def each(self, function: Callable[..., None], *arguments: Any) -> None:
        """Call ``function(*arguments)`` soon; none is lost."""
        with self._lock:
            self._ordered.append((function, arguments))
        self._wake()

    def _wake(self) -> None:
        with self._lock:
            if self._awake:
                return
            self._awake = True
        try:
            self._loop.call_soon_threadsafe(self._deliver)
        except RuntimeError:  # the loop has closed: the process is ending
            pass

    def _deliver(self) -> None:
        with self._lock:
            self._awake = False
            calls = [*self._ordered, *self._newest.values()]
            self._ordered.clear()
            self._newest.clear()
        for function, arguments in calls:
            try:
                function(*arguments)
            except Exception:  # the other calls must still run
                _LOG.exception("a value was not taken")
