"""Accept connections and pass their bytes on in pieces, so that no connection delays the event loop.

Bytes of a signed-in user are passed on at once, up to a rate above that of any page. Bytes of other clients wait in a
queue, and each turn of the loop passes a few pieces on. The number of connections is limited: a new one replaces the
least important one. All methods run in the event loop's thread.
"""

from __future__ import annotations

import asyncio
import errno
import logging
import re
import socket
import ssl
import time
from collections import Counter, deque
from collections.abc import Callable
from typing import Any, cast

from scope_ui_bridge.core.admission import Bucket, OfUsers

_LOG = logging.getLogger(__name__)
MAX_CONNECTIONS = 256
"""Maximum number of open connections, or four for each page if that is more.

The process needs other descriptors as well, and 1024 is a usual limit.
"""
MAX_OF_USER = 32
"""Maximum number of connections of one user: WebSockets, and those that the user's browsers keep open."""
_BACKLOG = 128
_PIECE = 1024
_PIECES = 4
"""Maximum number of pieces from clients without a sign-in in one turn: each may contain some 25 requests."""
_READ = 16 * 1024
_USER_BYTES_PER_S, _USER_BURST = 64e3, 256e3
_STRANGER_BYTES_PER_S, _STRANGER_BURST = 8e3, 16e3
_LATER_S = 0.005
_AT_ONCE = 16  # connections without a sign-in that are closed together: the search takes a while
_NO_DESCRIPTORS_S = 0.1
_HEAD = 8 * 1024
_COOKIE = re.compile(rb"icu_session_\d+=([\w-]{8,128})")
NOBODY = ""


class Gate(asyncio.Protocol):
    """One connection, between its transport and the handler of the web server.

    Attributes
    ----------
    user
        The user's name after the first request with a session, before that ``NOBODY``.
    """

    def __init__(self, listener: Listener, remote: str) -> None:
        self._listener = listener
        self.remote = remote
        self.user = NOBODY
        self._rate = Bucket(_STRANGER_BYTES_PER_S, _STRANGER_BURST)
        self._handler: Any = listener.make_handler()
        self._waiting = bytearray()
        self._paused = False
        self.transport: asyncio.Transport | None = None
        self.opening: asyncio.Task[None] | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self.transport = cast(asyncio.Transport, transport)
        if hasattr(transport, "max_size"):  # asyncio's transports read 256 KiB at once by default
            transport.max_size = _READ
        self._handler.connection_made(transport)

    def connection_lost(self, exc: Exception | None) -> None:
        self._waiting.clear()
        self._listener.forget(self)
        self._handler.connection_lost(exc)

    def pause_writing(self) -> None:
        self._handler.pause_writing()

    def resume_writing(self) -> None:
        self._handler.resume_writing()

    def eof_received(self) -> None:
        self._handler.eof_received()

    def data_received(self, data: bytes) -> None:
        """Pass the received bytes on, now or in their turn."""
        self._waiting += data
        if self.user == NOBODY:  # a browser sends the cookies of all robots on this host
            cookies = (found[1].decode() for found in _COOKIE.finditer(bytes(self._waiting[:_HEAD])))
            self._listener.know(self, next(filter(None, map(self._listener.whose, cookies)), NOBODY))
        if self.user != NOBODY:
            self.pass_on(len(self._waiting))
        if self._waiting:
            self._pause()
            self._listener.queue(self)

    def pass_on(self, size: int = _PIECE) -> bool:
        """Pass a piece of the waiting bytes to the handler; return whether it accepted one."""
        handler = self._handler
        if not self._waiting or getattr(handler, "_reading_paused", False) or getattr(handler, "_buffer_paused", False):
            return False
        size = min(size, len(self._waiting))
        rate = self._rate if self.user == NOBODY else self._listener.rates[self.user]
        if not rate.take(time.monotonic(), size):
            return False
        piece = bytes(self._waiting[:size])
        del self._waiting[:size]
        handler.data_received(piece)
        if not self._waiting:
            self._resume()
        return True

    @property
    def waits(self) -> bool:
        """Whether bytes wait to be passed on."""
        return bool(self._waiting)

    def end(self) -> None:
        """Close the connection at once, whether it is open or still opening."""
        if self.transport is not None:
            self.transport.abort()
        elif self.opening is not None:
            self.opening.cancel()

    def _pause(self) -> None:
        if not self._paused and self.transport is not None:
            self._paused = True
            self.transport.pause_reading()

    def _resume(self) -> None:
        handler = self._handler
        if self._paused and self.transport is not None and not self.transport.is_closing():
            self._paused = False
            if not (getattr(handler, "_reading_paused", False) or getattr(handler, "_buffer_paused", False)):
                self.transport.resume_reading()


class Listener:
    """The listening sockets and all connections.

    Parameters
    ----------
    make_handler
        Creates the web server's protocol for a connection.
    whose
        Returns the user of a session's cookie, ``NOBODY`` for none.
    spares
        Returns whether a user is or was the operator: these connections are closed last.
    limit
        Maximum number of open connections.
    told
        Called with the user or the address of a connection that was closed for a new one.
    """

    def __init__(
        self,
        make_handler: Callable[[], Any],
        whose: Callable[[str], str],
        spares: Callable[[str], bool],
        limit: int,
        told: Callable[[str], None],
    ) -> None:
        self.make_handler = make_handler
        self.whose = whose
        self._spares = spares
        self._limit = limit
        self._told = told
        self.rates = OfUsers(lambda: Bucket(_USER_BYTES_PER_S, _USER_BURST))
        self._loop = asyncio.get_running_loop()
        self._sockets: list[socket.socket] = []
        self._gates: dict[Gate, None] = {}
        self._row: deque[Gate] = deque()
        self._pumping = False
        self._ssl: ssl.SSLContext | None = None
        self._handshake_s: float | None = None

    async def open(self, host: str, port: int, context: ssl.SSLContext | None, handshake_s: float) -> int:
        """Listen; return the port. Raises OSError if the address cannot be used."""
        self._ssl, self._handshake_s = context, handshake_s if context else None
        # asyncio only binds the addresses: it would accept a hundred connections in one turn, without a limit.
        found = await self._loop.create_server(asyncio.Protocol, host, port, start_serving=False)
        self._sockets = [bound.dup() for bound in found.sockets]
        found.close()
        for listening in self._sockets:
            listening.setblocking(False)
            listening.listen(_BACKLOG)
            self._loop.add_reader(listening, self._accept, listening)
        return int(self._sockets[0].getsockname()[1])

    def close(self) -> None:
        """Stop listening."""
        for listening in self._sockets:
            self._loop.remove_reader(listening)
            listening.close()
        self._sockets.clear()
        for gate in list(self._gates):
            if gate.transport is None:
                gate.end()

    def _accept(self, listening: socket.socket) -> None:
        if len(self._gates) >= self._limit:
            first, *more = sorted(self._gates, key=self._worth())[:_AT_ONCE]
            for gate in [first, *(other for other in more if other.user == NOBODY)]:
                self._make_room(gate)
        try:
            accepted, address = listening.accept()
        except (BlockingIOError, InterruptedError, ConnectionAbortedError):
            return
        except OSError as error:
            if error.errno not in (errno.EMFILE, errno.ENFILE, errno.ENOBUFS, errno.ENOMEM):
                raise
            self._wait_for_descriptors(listening)
            return
        accepted.setblocking(False)
        gate = Gate(self, str(address[0]))
        self._gates[gate] = None
        gate.opening = self._loop.create_task(self._open(gate, accepted))

    def _wait_for_descriptors(self, listening: socket.socket) -> None:
        if self._gates:
            self._make_room(min(self._gates, key=self._worth()))
        self._loop.remove_reader(listening)
        again = lambda: listening.fileno() >= 0 and self._loop.add_reader(listening, self._accept, listening)  # noqa: E731
        self._loop.call_later(_NO_DESCRIPTORS_S, again)

    async def _open(self, gate: Gate, accepted: socket.socket) -> None:
        try:
            await self._loop.connect_accepted_socket(
                lambda: gate, accepted, ssl=self._ssl, ssl_handshake_timeout=self._handshake_s
            )
        except (OSError, ssl.SSLError, asyncio.CancelledError):  # no TLS, too slow, or closed for a new one
            accepted.close()
        finally:
            if gate.transport is None:
                self.forget(gate)

    def know(self, gate: Any, user: str) -> None:
        """Assign a connection to a user; close the user's oldest connection if there are too many."""
        if not isinstance(gate, Gate):  # the connection has ended, or a test made it
            return
        if user == gate.user:
            return
        gate.user = user
        if user == NOBODY:
            return
        own = [other for other in self._gates if other.user == user]
        if len(own) > MAX_OF_USER:
            self._make_room(own[0])

    def forget(self, gate: Gate) -> None:
        """Record that a connection has ended."""
        self._gates.pop(gate, None)

    def _worth(self) -> Callable[[Gate], tuple[bool, bool, int]]:
        """Return the sort key of connections, least important first.

        First those without a sign-in, then those of users who never were the operator; within a group those of the
        address or user with most connections, the oldest first.
        """
        counts = Counter((gate.user, gate.user or gate.remote) for gate in self._gates)

        def worth(gate: Gate) -> tuple[bool, bool, int]:
            known = gate.user != NOBODY
            return known and self._spares(gate.user), known, -counts[gate.user, gate.user or gate.remote]

        return worth

    def _make_room(self, gate: Gate) -> None:
        self._told(gate.user or gate.remote)
        self.forget(gate)
        gate.end()

    def queue(self, gate: Gate) -> None:
        """Add a connection to the queue."""
        if gate not in self._row:
            self._row.append(gate)
        if not self._pumping:
            self._pumping = True
            self._loop.call_soon(self._pump)

    def _pump(self) -> None:
        taken = 0
        for _ in range(len(self._row)):
            gate = self._row.popleft()
            taken += gate.pass_on()
            if gate.waits:
                self._row.append(gate)
            if taken >= _PIECES:
                break
        self._pumping = bool(self._row)
        if self._row and taken:
            self._loop.call_soon(self._pump)
        elif self._row:
            self._loop.call_later(_LATER_S, self._pump)


class Turnstile:
    """Passes requests without a sign-in one by one, with time for all other work between them."""

    PERIOD_S = 0.002

    def __init__(self) -> None:
        self._waiting: deque[asyncio.Future[None]] = deque()
        self._free_s = 0.0
        self._runs = False

    async def wait(self) -> None:
        """Wait for the caller's turn."""
        loop = asyncio.get_running_loop()
        if not self._runs and loop.time() >= self._free_s:
            self._free_s = loop.time() + self.PERIOD_S
            return
        turn = loop.create_future()
        self._waiting.append(turn)
        if not self._runs:
            self._runs = True
            loop.call_later(self.PERIOD_S, self._next)
        await turn

    def _next(self) -> None:
        loop = asyncio.get_running_loop()
        while self._waiting:
            turn = self._waiting.popleft()
            if not turn.done():
                turn.set_result(None)
                break
        self._free_s = loop.time() + self.PERIOD_S
        self._runs = bool(self._waiting)
        if self._runs:
            loop.call_later(self.PERIOD_S, self._next)
