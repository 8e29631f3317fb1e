"""Log of the bench's truth: one JSON object a line, with the time of the graph."""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any


class TruthLog:
    """An open log file.

    Raises
    ------
    OSError
        If it cannot be opened.
    """

    def __init__(self, path: Path) -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        self._file = path.open("a", encoding="utf-8")

    def write(self, records: Iterable[dict[str, Any]], offset_s: float) -> None:
        """Append records; ``offset_s`` is what the graph's time is ahead of the ``time_s`` of the records."""
        for record in records:
            self._file.write(json.dumps({"t": round(record.pop("time_s") + offset_s, 6), **record}) + "\n")
        self._file.flush()

    def close(self) -> None:
        self._file.close()
