"""The ledger of steps of a graph: made before its programs start, found by those that are added to it."""

from __future__ import annotations

import contextlib
import os
import time
from collections.abc import Iterator
from pathlib import Path

from icu_common.adapters.step_ledger import StepLedger, ledger_path


def path_of_graph(namespace: str) -> Path:
    """Return where the ledger of the graph in this environment's ROS domain is."""
    return ledger_path(os.environ.get("ROS_DOMAIN_ID", ""), namespace)


def is_used(path: Path) -> bool:
    """Return whether a ledger exists and a running graph counts in it."""
    if not path.is_file():
        return False
    try:
        with contextlib.closing(StepLedger(path)) as found:
            return any(Path(f"/proc/{process}").exists() for process in found.processes().values())
    except OSError:
        return False


@contextlib.contextmanager
def new_ledger(path: Path, *, simulated: bool) -> Iterator[None]:
    """Make an empty ledger and remove it at the end; simulated time begins at the system's time."""
    path.unlink(missing_ok=True)  # what an earlier graph has left
    try:
        with contextlib.closing(StepLedger(path)) as made:
            if simulated:
                made.time_ns = time.time_ns()
        yield
    finally:
        path.unlink(missing_ok=True)
