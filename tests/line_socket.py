"""Requests and answers as JSON lines over a Unix socket: how tests ask the bench and the mock board for the truth."""

from __future__ import annotations

import json
import socket
from pathlib import Path
from typing import Any


class LineSocket:
    """Requests and answers as JSON lines over a Unix socket."""

    def __init__(self, path: Path) -> None:
        self._socket = socket.socket(socket.AF_UNIX)
        self._socket.settimeout(5.0)
        self._socket.connect(str(path))
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
