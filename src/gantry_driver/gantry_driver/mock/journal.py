"""Journal of received bytes, actions and losses of the board, with times: evidence for tests, and the log file."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable
from typing import Any

Entry = dict[str, Any]


class Journal:
    """Numbered entries, limited to the newest ``capacity``, and counters of all entries."""

    def __init__(self, capacity: int = 20_000) -> None:
        self.entries: deque[Entry] = deque(maxlen=capacity)
        self.counts: Counter[str] = Counter()
        self.sink: Callable[[Entry], None] | None = None
        self._number = 0

    def note(self, t: float, kind: str, **details: Any) -> None:
        """Add an entry; ``t`` in board seconds."""
        entry: Entry = {"n": self._number, "t": round(t, 6), "kind": kind, **details}
        self._number += 1
        self.entries.append(entry)
        if self.sink is not None:
            self.sink(entry)

    def count(self, what: str, amount: int = 1) -> None:
        """Add to a counter."""
        self.counts[what] += amount

    def since(self, number: int, kind: str | None = None) -> list[Entry]:
        """Return the kept entries from ``number`` on, of one kind if given."""
        return [e for e in self.entries if e["n"] >= number and (kind is None or e["kind"] == kind)]
