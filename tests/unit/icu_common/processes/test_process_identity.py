"""Whether another process on this host still exists, and which programs bring-up has found blocked."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from icu_common.adapters.processes.hanging_programs import hanging_file, read_hanging, write_hanging
from icu_common.adapters.processes.process_identity import is_alive, own_process, process_number
from icu_common.core.processes.supervision import HANGING_VARIABLE


def test_a_process_is_alive_while_it_is_stopped_and_not_once_it_has_ended() -> None:
    with subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE) as process:
        assert is_alive(process.pid)
        process.send_signal(signal.SIGSTOP)
        assert is_alive(process.pid)
        process.kill()
        os.waitid(os.P_PID, process.pid, os.WEXITED | os.WNOWAIT)
        assert not is_alive(process.pid), "it was not waited for yet"
    assert not is_alive(process.pid)


def test_only_a_process_of_this_host_has_a_number() -> None:
    assert process_number(own_process()) == os.getpid()
    assert process_number(f"elsewhere pid:[4026531836] {os.getpid()}") is None
    assert process_number("") is None and process_number("17") is None


def test_the_file_of_hanging_programs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(HANGING_VARIABLE, raising=False)
    assert hanging_file() is None and read_hanging(None) == frozenset()
    path = tmp_path / "hanging.json"
    monkeypatch.setenv(HANGING_VARIABLE, str(path))
    assert hanging_file() == path and read_hanging(path) == frozenset()
    write_hanging(path, [7, 3])
    assert read_hanging(path) == {3, 7} and [p.name for p in tmp_path.iterdir()] == ["hanging.json"]
    path.write_text('{"hanging": [')
    assert read_hanging(path) == frozenset()
