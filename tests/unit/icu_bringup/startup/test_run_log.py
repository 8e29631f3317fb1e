"""The log of bring-up: one file for each run, bounded, for this user alone."""

from __future__ import annotations

import errno
import os
from pathlib import Path

import pytest

from icu_bringup.adapters.run_log import KEPT_RUNS, RunLog


def test_each_run_has_a_file_and_old_ones_go(tmp_path: Path) -> None:
    for run in range(KEPT_RUNS + 2):
        log = RunLog(tmp_path / "logs")
        log.write(f"run {run}")
        log.close()
    files = sorted(path.name for path in (tmp_path / "logs").iterdir())
    assert files == sorted(["bring_up.log", *(f"bring_up.{n}.log" for n in range(1, KEPT_RUNS))])
    newest = KEPT_RUNS + 1
    for n in range(KEPT_RUNS):
        path = tmp_path / "logs" / (f"bring_up.{n}.log" if n else "bring_up.log")
        assert path.read_text().endswith(f" run {newest - n}\n")
        assert path.stat().st_mode & 0o777 == 0o600


def test_a_long_run_goes_on_in_another_file(tmp_path: Path) -> None:
    log = RunLog(tmp_path, max_bytes=200)
    for number in range(60):
        log.write(f"line {number:04d}")
    log.close()
    files = list(tmp_path.iterdir())
    assert len(files) == KEPT_RUNS and all(path.stat().st_size <= 200 for path in files)
    assert log.path.read_text().endswith("line 0059\n")


def test_a_full_disk_is_reported_once(tmp_path: Path) -> None:
    log = RunLog(tmp_path)
    assert log._file is not None
    os.dup2(os.open("/dev/full", os.O_WRONLY), log._file.fileno())
    with pytest.raises(OSError) as error:
        log.write("lost")
    assert error.value.errno == errno.ENOSPC
    log.write("dropped")
