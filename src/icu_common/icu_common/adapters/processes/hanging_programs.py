"""File in which bring-up lists its hanging programs: only bring-up receives their signs of life."""

from __future__ import annotations

import json
import os
from collections.abc import Collection
from pathlib import Path

from icu_common.core.processes.supervision import HANGING_VARIABLE


def write_hanging(path: Path, numbers: Collection[int]) -> None:
    """Write the process numbers of the hanging programs atomically: a reader gets the old or the new ones."""
    new = path.with_suffix(".new")
    new.write_text(json.dumps({"hanging": sorted(numbers)}), encoding="utf-8")
    new.replace(path)


def read_hanging(path: Path | None) -> frozenset[int]:
    """Return the process numbers; empty without bring-up, or after it has ended."""
    if path is None:
        return frozenset()
    try:
        return frozenset(int(number) for number in json.loads(path.read_text(encoding="utf-8"))["hanging"])
    except (OSError, ValueError, KeyError, TypeError):
        return frozenset()


def hanging_file() -> Path | None:
    """Return the file of the bring-up that has started this program, None without one."""
    name = os.environ.get(HANGING_VARIABLE, "")
    return Path(name) if name else None
