"""The chain of command records: JSON lines, each with the SHA-256 of the line before.

The chain may be split into several files: the first line of a file then has the hash of the previous file's last line.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable
from dataclasses import dataclass
from datetime import datetime
from typing import Any

START = "0" * 64
BAD_BYTES = "backslashreplace"
"""Decoding error handler for audit files: an invalid byte becomes text that is no JSON, so its line is damaged."""


class AuditError(ValueError):
    """Broken chain; the message names the line."""


def chain_line(number: int, previous: str, record: dict[str, Any]) -> tuple[str, str]:
    """Return line ``number`` (without its end) with the hash of the line before, and this line's own hash."""
    line = json.dumps({"n": number, "previous": previous, **record}, separators=(",", ":"), allow_nan=False)
    return line, _hash(line)


GAP = "records lost"
"""Command of the line that replaces records that could not be written, for example on a full disk."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Gap:
    """Records that could not be written: their number, and the times of the first and the last, wall clock in s."""

    count: int
    from_s: float
    until_s: float

    def with_one_more(self, wall_s: float) -> Gap:
        """Return the gap with one more lost record."""
        return Gap(count=self.count + 1, from_s=min(self.from_s, wall_s), until_s=max(self.until_s, wall_s))

    def record(self) -> dict[str, Any]:
        """Return the record of the gap."""
        values = {"lost": self.count, "from_s": self.from_s, "until_s": self.until_s}
        return {"wall_s": self.until_s, "who": "the bridge", "command": GAP, **values}


def gaps(lines: Iterable[str]) -> list[str]:
    """Return a sentence for each gap recorded in an intact file."""
    entries = (json.loads(line) for line in lines if f'"command":"{GAP}"' in line)
    found = ((entry["lost"], _shown(entry["from_s"]), _shown(entry["until_s"])) for entry in entries)
    return [f"records lost between {begin} and {end}: {count}" for count, begin, end in found]


def _shown(wall_s: float) -> str:
    return f"{datetime.fromtimestamp(wall_s).astimezone():%Y-%m-%d %H:%M:%S %z}"


def verify(lines: Iterable[str], count: int = 0, previous: str = START) -> tuple[int, str]:
    """Return number and hash of the last line of an intact chain.

    Parameters
    ----------
    lines
        Lines of one file.
    count, previous
        Number and hash of the previous file's last line.

    Raises
    ------
    AuditError
        If a line was changed, removed, inserted or truncated; the message has its position in this file.
    """
    for place, line in enumerate(lines, start=1):
        text = line.rstrip("\n")
        try:
            entry = json.loads(text)
            number, named = entry["n"], entry["previous"]
        except (ValueError, KeyError, TypeError) as error:
            raise AuditError(f"line {place} is damaged: {text[:60]!r}") from error
        if number != count + 1 or named != previous:
            raise AuditError(f"line {place} does not follow the line before it")
        count, previous = count + 1, _hash(text)
    return count, previous


def line_before(line: str) -> tuple[int, str]:
    """Return number and hash of the previous line as named in this line; the chain's start if it names none."""
    try:
        entry = json.loads(line)
        return int(entry["n"]) - 1, str(entry["previous"])
    except (ValueError, KeyError, TypeError):
        return 0, START


def _hash(line: str) -> str:
    return hashlib.sha256(line.encode()).hexdigest()
