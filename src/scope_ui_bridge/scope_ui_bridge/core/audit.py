"""The chain of command records: JSON lines, each with the SHA-256 of the line before."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable
from typing import Any

START = "0" * 64
BAD_BYTES = "backslashreplace"
"""How a file is to be read: a byte that is no text becomes what no JSON has, and its line is named as damaged."""


class AuditError(ValueError):
    """The chain is broken; the message names the line."""


def chain_line(number: int, previous: str, record: dict[str, Any]) -> tuple[str, str]:
    """Return line ``number`` (without its end) with the hash of the line before, and this line's own hash."""
    line = json.dumps({"n": number, "previous": previous, **record}, separators=(",", ":"), allow_nan=False)
    return line, _hash(line)


def verify(lines: Iterable[str]) -> tuple[int, str]:
    """Return the number of lines of an intact chain and the last line's hash.

    Raises
    ------
    AuditError
        If a line was changed, removed, inserted or cut short.
    """
    count, previous = 0, START
    for line in lines:
        text = line.rstrip("\n")
        try:
            entry = json.loads(text)
            number, named = entry["n"], entry["previous"]
        except (ValueError, KeyError, TypeError) as error:
            raise AuditError(f"line {count + 1} is damaged: {text[:60]!r}") from error
        if number != count + 1 or named != previous:
            raise AuditError(f"line {count + 1} does not follow the line before it")
        count, previous = count + 1, _hash(text)
    return count, previous


def _hash(line: str) -> str:
    return hashlib.sha256(line.encode()).hexdigest()
