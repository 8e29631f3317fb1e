"""Requests and answers as JSON lines over a Unix socket: how tests ask the bench and the mock board for the truth."""

from __future__ import annotations

import json
import socket
import time
from pathlib import Path
from typing import Any

from support.deadlines import wait_until

LISTENS_WITHIN_S = ANSWERS_WITHIN_S = 30.0
"""The bench may be drawing a picture, on a loaded machine, before it listens and before it answers."""
HOLD = ord("!")


class LineSocket:
    """Requests and answers as JSON lines over a Unix socket; the client waits until a server listens on it."""

    def __init__(self, path: Path) -> None:
        self._socket = socket.socket(socket.AF_UNIX)
        self._socket.settimeout(ANSWERS_WITHIN_S)

        def connected() -> bool:
            try:
                self._socket.connect(str(path))
            except (FileNotFoundError, ConnectionRefusedError):  # not bound yet, or bound and not listening
                return False
            return True

        wait_until(connected, f"a process listens on {path}", LISTENS_WITHIN_S)
        self._file = self._socket.makefile("rwb")

    def ask(self, do: str, **values: Any) -> dict[str, Any]:
        """Send a request with its values; return the answer."""
        return self.send(json.dumps({"do": do, **values}).encode())

    def send(self, line: bytes) -> dict[str, Any]:
        """Send a line without its newline; return the answer."""
        self._file.write(line + b"\n")
        self._file.flush()
        return self.read()

    def read(self) -> dict[str, Any]:
        """Return the next answer."""
        answer = json.loads(self._file.readline())
        assert isinstance(answer, dict)
        return answer

    def close(self) -> None:
        """End the connection."""
        self._file.close()
        self._socket.close()


class BoardSocket(LineSocket):
    """The mock board's control socket: the bytes that the board received, and its position."""

    def ask(self, do: str, **values: Any) -> dict[str, Any]:
        """Send a request that the board must accept; return the answer."""
        answer = super().ask(do, **values)
        assert answer["ok"], answer
        return answer

    def fault(self, kind: str, **values: Any) -> None:
        """Begin a fault of the board or its mechanics."""
        self.ask("fault", kind=kind, **values)

    def log(self, since: int = 0, kind: str | None = None) -> list[dict[str, Any]]:
        """Return the entries from that number on, of one kind if given, oldest first."""
        entries: list[dict[str, Any]] = []
        while batch := self.ask("log", since=since, kind=kind)["entries"]:
            entries += batch
            since = batch[-1]["n"] + 1
        return entries

    def mark(self) -> int:
        """Return the number of the next entry."""
        entries = self.log()
        return int(entries[-1]["n"]) + 1 if entries else 0

    def lines(self, since: int = 0) -> list[dict[str, Any]]:
        """Return the lines that the board took, oldest first: text, answer, t."""
        return self.log(since, "line")

    def holds(self, since: int = 0) -> list[float]:
        """Return when it received the hold, in s of its clock."""
        return [entry["t"] for entry in self.log(since, "realtime") if entry["byte"] == HOLD]

    def mpos(self) -> tuple[float, float, float]:
        """Return the true place in mm."""
        x, y, z = self.ask("state")["mpos"]
        return x, y, z

    def at_rest(self) -> tuple[float, float, float]:
        """Return the place once it has not changed for a while."""
        seen, since_s = self.mpos(), time.monotonic()

        def rests() -> bool:
            nonlocal seen, since_s
            asked_s = time.monotonic()
            if (now := self.mpos()) != seen:
                seen, since_s = now, time.monotonic()
            return asked_s > since_s + 0.3

        wait_until(rests, "the machine comes to rest", describe=lambda: seen)
        return seen

    def counters(self) -> dict[str, int]:
        """Return the counts of the board's bytes, lines and answers."""
        return dict(self.ask("counters")["counters"])

    def clock_s(self) -> tuple[float, float]:
        """Return what added to the board's clock gives time.monotonic(), and how well that is known, in s."""
        offset_s, width_s = 0.0, float("inf")
        for _ in range(200):
            before = time.monotonic()
            board_s = self.ask("counters")["t"]
            after = time.monotonic()
            if after - before < width_s:  # the narrowest of many questions
                offset_s, width_s = (before + after) / 2 - board_s, after - before
        return offset_s, width_s
