"""Running recordings and their duration, whichever program started them."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

_DISCOVERY_S = 5.0
"""So long after the first look the graph may still show what was there before."""


class Recordings:
    """The recording that this bridge has started (``own``: by whom, and when), and recorders that are in the graph.

    A recorder does not tell when it began, so one of the graph counts from when it was first seen.
    """

    def __init__(self) -> None:
        self.own: tuple[str, float] | None = None
        self._looked_s = math.inf
        self._seen_s: dict[str, float] = {}

    def seen(self, programs: Iterable[str], now_s: float) -> None:
        """Take the names of all recorders that are in the graph now, without this bridge's own."""
        self._looked_s = min(self._looked_s, now_s)
        self._seen_s = {name: self._seen_s.get(name, now_s) for name in programs}

    def message(self, now_s: float) -> list[dict[str, Any]]:
        """Return what pages get: who or which program records, how many seconds, ``at_least`` if it began before."""
        told = []
        if self.own is not None:
            who, begun_s = self.own
            told.append({"who": who, "program": "", "for_s": int(now_s - begun_s), "at_least": False})
        for name, begun_s in self._seen_s.items():
            before = begun_s - self._looked_s < _DISCOVERY_S
            told.append({"who": "", "program": name, "for_s": int(now_s - begun_s), "at_least": before})
        return told
