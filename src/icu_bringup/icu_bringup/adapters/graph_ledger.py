"""Step ledger of a graph: created before its programs start, and found by programs that are added later."""

from __future__ import annotations

import contextlib
import os
import time
from collections.abc import Iterator
from pathlib import Path

from icu_common.adapters.steps.step_ledger import StepLedger, ledger_path


def path_of_graph(namespace: str) -> Path:
    """Return the path of the ledger of the graph in this environment's ROS domain."""
    return ledger_path(os.environ.get("ROS_DOMAIN_ID", ""), namespace)


def is_used(path: Path) -> bool:
    """Return whether a ledger exists and a running graph counts in it."""
    if not path.is_file():
        return False
    try:
        with contextlib.closing(StepLedger(path)) as found:
            found.forget_ended()
            return bool(found.processes())
    except OSError:
        return False


@contextlib.contextmanager
def new_ledger(path: Path, *, simulated: bool) -> Iterator[None]:
    """Create a ledger and remove it at the end; simulated time starts at the system's time.

    An existing file is kept: a recorder or a player that was started before the graph counts in it.
    """
    time_ns = time.time_ns() if simulated else 0
    try:
        _restart(path, time_ns)
    except OSError:  # a file of another version
        path.unlink()
        _restart(path, time_ns)
    try:
        yield
    finally:
        path.unlink(missing_ok=True)


def _restart(path: Path, time_ns: int) -> None:
    with contextlib.closing(StepLedger(path)) as made:
        made.restart(time_ns)
