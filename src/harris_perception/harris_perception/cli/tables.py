"""Shared parts of commands over many images: a progress bar, and machine-readable tables."""

from __future__ import annotations

import csv
import io
import json
import sys
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, TypeVar

from harris_perception.adapters.picture_files import write_file

T = TypeVar("T")


def progress(items: Iterable[T], count: int, what: str) -> Iterator[T]:
    """Yield the items with a progress bar on standard error; silent unless that is a terminal."""
    shown = sys.stderr.isatty()
    for i, item in enumerate(items):
        if shown:
            done = 30 * i // count
            print(f"\r{what} [{'#' * done}{'.' * (30 - done)}] {i}/{count}", end="", file=sys.stderr, flush=True)
        yield item
    if shown:
        print(f"\r{what} [{'#' * 30}] {count}/{count}", file=sys.stderr)


def check_table(path: Path) -> None:
    """Raise ``ValueError`` unless the file name has the suffix of a table."""
    if path.suffix not in (".csv", ".json"):
        raise ValueError(f"{path}: the name must end in .csv or .json")


def write_table(path: Path, columns: Sequence[str], rows: Sequence[Sequence[Any]]) -> None:
    """Write rows as JSON or CSV, by the suffix of the file name."""
    check_table(path)
    text = io.StringIO(newline="")
    if path.suffix == ".json":
        text.write(json.dumps([dict(zip(columns, row)) for row in rows], indent=1) + "\n")
    else:
        csv.writer(text).writerows([columns, *rows])
    write_file(path, text.getvalue().encode(errors="backslashreplace"))  # file names may not be UTF-8
