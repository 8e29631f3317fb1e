"""Requests and answers as JSON lines over a Unix socket: how tests ask the bench and the mock board for the truth."""

from __future__ import annotations

import json
import socket
import time
from pathlib import Path
from typing import Any


class LineSocket:
    """Requests and answers as JSON lines over a Unix socket, waited for where nobody listens on it yet."""

    def __init__(self, path: Path, within_s: float = 30.0) -> None:
        self._socket = socket.socket(socket.AF_UNIX)
        self._socket.settimeout(5.0)
        deadline = time.monotonic() + within_s
        while True:
            try:
                self._socket.connect(str(path))
                break
            except (FileNotFoundError, ConnectionRefusedError) as error:  # not bound yet, or bound and not listening
                assert time.monotonic() < deadline, f"nobody listens on {path} within {within_s:g} s: {error}"
                time.sleep(0.02)
        self._file = self._socket.makefile("rw")

    def ask(self, **request: Any) -> dict[str, Any]:
        self._file.write(json.dumps(request) + "\n")
        self._file.flush()
        answer = json.loads(self._file.readline())
        assert isinstance(answer, dict)
        return answer

    def close(self) -> None:
        self._file.close()
        self._socket.close()
