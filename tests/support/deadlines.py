"""Waiting for a condition with a deadline: the one place in which a test pauses between two looks."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

PAUSE_S = 0.01


def wait_until(
    condition: Callable[[], Any], what: str, within_s: float = 30.0, describe: Callable[[], Any] = lambda: ""
) -> Any:
    """Return the first true value of ``condition()``; fail with ``what`` and a description after ``within_s``."""
    deadline = time.monotonic() + within_s
    while True:
        late = time.monotonic() > deadline  # a test that was delayed looks once more
        if value := condition():
            return value
        assert not late, f"{what}: not within {within_s:g} s; {describe()}"
        time.sleep(PAUSE_S)
