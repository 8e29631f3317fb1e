"""Tests that may run at the same time, where several run at once; and memory as in a node of the graph."""

from __future__ import annotations

import gc
from typing import Any

import pytest
from xdist.scheduler import LoadFileScheduling

from icu_common.adapters.memory import keep_large_blocks

keep_large_blocks()


def pytest_collection_finish() -> None:
    """Leave the thousands of tests out of every later search for garbage; they stay until the end anyway."""
    gc.collect()
    gc.freeze()


class Shares(LoadFileScheduling):
    """Each file to one worker, with two exceptions.

    All that use a browser go to the same worker: on two cores each would slow the other down until a page is late.
    The tests of every panel take half a minute each, so they are shared out one by one, and last.
    """

    def _split_scope(self, nodeid: str) -> str:
        file = super()._split_scope(nodeid)
        if file.startswith("tests/system/page/test_operator_"):
            return "browser"
        return nodeid if file.startswith("tests/unit/robot/test_every_panel") else file


@pytest.hookimpl(optionalhook=True)  # with `-p no:xdist` no program asks
def pytest_xdist_make_scheduler(config: Any, log: Any) -> Shares | None:
    """Return the scheduler for `--dist loadfile`."""
    return Shares(config, log) if config.getoption("dist") == "loadfile" else None
