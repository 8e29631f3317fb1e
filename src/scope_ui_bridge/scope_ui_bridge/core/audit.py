"""The chain of command records: JSON lines, each with the SHA-256 of the line before.

It may be cut into several files between two lines: the first line of a file then names the last one of the file before.
"""

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


def verify(lines: Iterable[str], count: int = 0, previous: str = START) -> tuple[int, str]:
    """Return the number of the last line of an intact chain, and that line's hash.

    Parameters
    ----------
    lines
        Of one file.
    count, previous
        Number and hash of the line before the first one: of the file before.

    Raises
    ------
    AuditError
        If a line was changed, removed, inserted or cut short; its place in this file is named.
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
    """Return number and hash of the line before this one, as it names them; the chain's beginning where it is none."""
    try:
        entry = json.loads(line)
        return int(entry["n"]) - 1, str(entry["previous"])
    except (ValueError, KeyError, TypeError):
        return 0, START


def _hash(line: str) -> str:
    return hashlib.sha256(line.encode()).hexdigest()
