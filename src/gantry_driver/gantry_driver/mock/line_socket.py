"""Unix stream sockets that carry lines, many clients at once, for the truth and the control of the mock board."""

from __future__ import annotations

import contextlib
import os
import selectors
import socket
import stat
from collections.abc import Iterator
from pathlib import Path

MAX_LINE_BYTES = 64 * 1024
_LONGEST_PATH = 107
"""Maximum length of a path in bytes; unix(7): 108 including the final zero."""


class LineServer:
    """A listening socket and its clients; no call blocks."""

    def __init__(self, path: Path, selector: selectors.BaseSelector) -> None:
        self.path = path
        self._selector = selector
        self._clients: dict[socket.socket, tuple[bytearray, bytearray]] = {}
        if len(os.fsencode(path)) > _LONGEST_PATH:
            raise OSError(f"{path}: a socket's path may have {_LONGEST_PATH} bytes")
        if path.exists() and not stat.S_ISSOCK(path.stat().st_mode):
            raise FileExistsError(f"{path} exists and is not a socket")
        path.unlink(missing_ok=True)
        self._listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        try:
            self._listener.bind(os.fspath(path))
        except OSError as error:  # the error itself names no file
            self._listener.close()
            raise OSError(f"{path}: {error.strerror}") from error
        self._listener.listen(8)
        self._listener.setblocking(False)
        selector.register(self._listener, selectors.EVENT_READ, self._accept)

    @property
    def client_count(self) -> int:
        """Number of connected clients."""
        return len(self._clients)

    def connected(self, client: socket.socket) -> bool:
        """Return whether a client is still connected."""
        return client in self._clients

    def _accept(self) -> None:
        with contextlib.suppress(BlockingIOError, ConnectionAbortedError):
            client, _ = self._listener.accept()
            client.setblocking(False)
            self._clients[client] = (bytearray(), bytearray())
            self._selector.register(client, selectors.EVENT_READ, lambda: self._read(client))

    def _read(self, client: socket.socket) -> None:
        try:
            data = client.recv(65536)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        incoming = self._clients[client][0]
        incoming += data
        if not data or len(incoming) > MAX_LINE_BYTES:
            self._drop(client)

    def _drop(self, client: socket.socket) -> None:
        self._selector.unregister(client)
        client.close()
        del self._clients[client]

    def lines(self) -> Iterator[tuple[socket.socket, bytes]]:
        """Yield the complete lines that clients have sent."""
        for client, (incoming, _) in list(self._clients.items()):
            while b"\n" in incoming and client in self._clients:
                line, _, rest = bytes(incoming).partition(b"\n")
                incoming[:] = rest
                yield client, line

    def send(self, client: socket.socket, line: bytes) -> None:
        """Send one line; bytes that the client cannot accept now are sent later."""
        if client in self._clients:
            self._clients[client][1].extend(line)
            self._flush(client)

    def broadcast(self, line: bytes) -> None:
        """Send one line to every client, except clients that have not accepted their last one."""
        for client, (_, outgoing) in list(self._clients.items()):
            if not outgoing:
                outgoing += line
            self._flush(client)

    def _flush(self, client: socket.socket) -> None:
        outgoing = self._clients[client][1]
        try:
            sent = client.send(outgoing)
            del outgoing[:sent]
        except BlockingIOError:
            pass
        except OSError:
            self._drop(client)
            return
        wanted = selectors.EVENT_READ | (selectors.EVENT_WRITE if outgoing else 0)
        if self._selector.get_key(client).events != wanted:
            self._selector.modify(client, wanted, lambda: self._ready(client))

    def _ready(self, client: socket.socket) -> None:
        self._read(client)
        if client in self._clients:
            self._flush(client)

    def close(self) -> None:
        """Close all sockets and remove the path."""
        for client in list(self._clients):
            self._drop(client)
        self._selector.unregister(self._listener)
        self._listener.close()
        self.path.unlink(missing_ok=True)
