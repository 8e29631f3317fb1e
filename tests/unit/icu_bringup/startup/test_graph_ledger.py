"""The ledger that bring-up makes, and programs that were started before it."""

from __future__ import annotations

import contextlib
import subprocess
import sys
from pathlib import Path

from icu_bringup.adapters.graph_ledger import is_used, new_ledger
from icu_common.adapters.steps.step_ledger import StepLedger

ENDED = (
    "import os, sys\nfrom pathlib import Path\nfrom icu_common.adapters.steps.step_ledger import StepLedger\n"
    "ledger = StepLedger(Path(sys.argv[1]))\nledger.register()\nledger.time_ns = 7\nos._exit(1)\n"
)


def test_recorder_that_was_started_before_the_graph_counts_with_it(tmp_path: Path) -> None:
    path = tmp_path / "steps"
    with contextlib.closing(StepLedger(path)) as recorder:
        recorder.register()
        with new_ledger(path, simulated=False), contextlib.closing(StepLedger(path)) as node:
            node.register()
            assert len(node.processes()) == 2
            recorder.subscribe("/panel/pose")
            assert node.subscriptions("/panel/pose") == 1


def test_entries_of_a_killed_graph_are_forgotten(tmp_path: Path) -> None:
    path = tmp_path / "steps"
    subprocess.run([sys.executable, "-c", ENDED, str(path)], check=False)
    with contextlib.closing(StepLedger(path)) as left:
        assert (len(left.processes()), left.time_ns, left.origin_ns) == (1, 7, 7)
    assert not is_used(path)
    with new_ledger(path, simulated=False), contextlib.closing(StepLedger(path)) as found:
        assert (found.processes(), found.time_ns, found.origin_ns) == ({}, 0, 0)
    assert not path.exists()


def test_file_of_another_version_is_replaced(tmp_path: Path) -> None:
    path = tmp_path / "steps"
    path.write_text("another version")
    with new_ledger(path, simulated=True), contextlib.closing(StepLedger(path)) as found:
        assert found.time_ns == found.origin_ns > 0


def test_matches_are_complete_only_when_the_program_says_so(tmp_path: Path) -> None:
    """bag_check read them between two publishers, and found that no node publishes what is compared."""
    with contextlib.closing(StepLedger(tmp_path / "steps")) as program:
        program.register()
        ((row, _),) = program.processes().items()
        program.match("/parameter_events", 0)
        assert not program.is_shown(row)
        program.match("/corners", 0)
        program.show()
        assert program.is_shown(row)
        program.forget(row)
        program.register()
        assert not program.is_shown(row), "the row is another program's now"
