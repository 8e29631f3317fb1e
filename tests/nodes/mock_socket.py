"""The mock board's control socket, asked from outside the process that started it."""

from __future__ import annotations

import time
from typing import Any

from line_socket import LineSocket

HOLD = ord("!")


class BoardSocket(LineSocket):
    """Asks what the board received and where it stands."""

    def _log(self, kind: str) -> list[dict[str, Any]]:
        entries: list[dict[str, Any]] = []
        since = 0
        while batch := self.ask(do="log", since=since, kind=kind)["entries"]:
            entries += batch
            since = batch[-1]["n"] + 1
        return entries

    def lines(self) -> list[str]:
        """Return the lines that the board took."""
        return [str(entry["text"]) for entry in self._log("line")]

    def holds(self) -> int:
        """Return how often the board was told to hold."""
        return sum(entry["byte"] == HOLD for entry in self._log("realtime"))

    def position(self) -> tuple[float, float]:
        """Return the true place in mm."""
        x, y, _ = self.ask(do="state")["mpos"]
        return float(x), float(y)

    def at_rest(self, for_s: float = 0.3) -> tuple[float, float]:
        """Return the position once it has not changed for a while."""
        deadline = time.monotonic() + 10.0
        seen, since_s = self.position(), time.monotonic()
        while time.monotonic() < since_s + for_s:
            if (now := self.position()) != seen:
                seen, since_s = now, time.monotonic()
            assert time.monotonic() < deadline, "the machine does not come to rest"
            time.sleep(0.02)
        return seen
