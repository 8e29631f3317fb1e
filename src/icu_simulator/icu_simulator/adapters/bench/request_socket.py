"""Socket of the bench for tests: one JSON object a line in, one answer a line out."""

from __future__ import annotations

import contextlib
import json
import selectors
import socket
from collections.abc import Callable
from pathlib import Path
from typing import Any

from icu_common.adapters.unix_listener import listen_at


class RequestSocket:
    """Listener and its clients, served by the owner's selector: the data of each key is what to call.

    Parameters
    ----------
    path
        Path of the socket.
    selector
        Selector of the owner.
    answer
        Returns the answer to a line.

    Raises
    ------
    OSError
        If the socket cannot be created.
    """

    def __init__(self, path: Path, selector: selectors.BaseSelector, answer: Callable[[bytes], dict[str, Any]]) -> None:
        self._path, self._selector, self._answer = path, selector, answer
        self._clients: dict[socket.socket, bytearray] = {}
        self._listener = listen_at(path)
        self._selector.register(self._listener, selectors.EVENT_READ, self._accept)

    def _accept(self) -> None:
        with contextlib.suppress(OSError):
            client, _ = self._listener.accept()
            client.setblocking(False)
            self._clients[client] = bytearray()
            self._selector.register(client, selectors.EVENT_READ, lambda: self._read(client))

    def _read(self, client: socket.socket) -> None:
        buffer = self._clients[client]
        try:
            data = client.recv(65536)
            buffer += data
            while (end := buffer.find(b"\n")) >= 0:
                line = bytes(buffer[:end])
                del buffer[: end + 1]
                client.sendall(json.dumps(self._answer(line)).encode() + b"\n")
        except BlockingIOError:
            return
        except OSError:
            data = b""
        if not data:
            self._selector.unregister(client)
            client.close()
            del self._clients[client]

    def close(self) -> None:
        """Close all sockets and remove the path."""
        for client in self._clients:
            client.close()
        self._clients.clear()
        self._listener.close()
        self._path.unlink(missing_ok=True)
