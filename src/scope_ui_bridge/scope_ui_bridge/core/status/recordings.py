"""Running recordings and their duration, whichever program started them."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

_DISCOVERY_S = 5.0
"""Seconds after the first look in which discovery may still find recorders that started earlier."""


class Recordings:
    """Recording of this bridge (``own``: user and start), and other recorders in the graph.

    A recorder does not report its start, so the duration of another recorder counts from when it was first seen.
    """

    def __init__(self) -> None:
        self.own: tuple[str, float] | None = None
        self._looked_s = math.inf
        self._seen_s: dict[str, float] = {}

    def seen(self, programs: Iterable[str], now_s: float) -> None:
        """Set the names of all recorders in the graph, without this bridge's own."""
        self._looked_s = min(self._looked_s, now_s)
        self._seen_s = {name: self._seen_s.get(name, now_s) for name in programs}

    def message(self, now_s: float) -> list[dict[str, Any]]:
        """Return the message for pages: user or program, seconds, and ``at_least`` if it may have started earlier."""
        told = []
        if self.own is not None:
            who, begun_s = self.own
            told.append({"who": who, "program": "", "for_s": int(now_s - begun_s), "at_least": False})
        for name, begun_s in self._seen_s.items():
            before = begun_s - self._looked_s < _DISCOVERY_S
            told.append({"who": "", "program": name, "for_s": int(now_s - begun_s), "at_least": before})
        return told
