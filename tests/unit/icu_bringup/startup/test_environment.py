"""Messages of bring-up about this computer before it starts anything: one sentence with the option that helps."""

from __future__ import annotations

import os
import shutil
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import pytest

from icu_bringup.adapters import environment, graph_names
from icu_bringup.core.startup.graph_description import GraphDescriptionError


@pytest.fixture
def taken() -> Iterator[int]:
    """A port on which another program listens."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        yield server.getsockname()[1]


def test_a_port_in_use_is_replaced_or_named(taken: int) -> None:
    assert not environment.is_free("127.0.0.1", taken)
    with pytest.raises(
        GraphDescriptionError, match=rf"port {taken} is in use by another program; .*--set ui_bridge.port=\d+$"
    ):
        environment.free_port("127.0.0.1", taken, may_choose=False)
    chosen = environment.free_port("127.0.0.1", taken, may_choose=True)
    assert taken < chosen <= taken + 50 and environment.is_free("127.0.0.1", chosen)


def test_a_port_that_another_bring_up_has_chosen_is_not_free_before_its_page_listens(taken: int) -> None:
    choose = "import sys; from icu_bringup.adapters.environment import free_port; "
    choose += "print(free_port('127.0.0.1', int(sys.argv[1]), may_choose=True), flush=True); input()"
    command = [sys.executable, "-c", choose, str(taken)]
    pipe = subprocess.PIPE
    with subprocess.Popen(command, stdin=pipe, stdout=pipe, text=True) as other:
        assert other.stdout is not None
        theirs = int(other.stdout.readline())
        assert environment.is_free("127.0.0.1", theirs)
        assert environment.free_port("127.0.0.1", taken, may_choose=True) != theirs
        other.communicate("\n")


def test_a_full_disk_is_one_sentence(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    environment.check_space(tmp_path)
    monkeypatch.setattr(shutil, "disk_usage", lambda _: SimpleNamespace(free=5 << 20))
    with pytest.raises(GraphDescriptionError, match=rf"the disk of {tmp_path} is full: 5 MB are free.*--state FOLDER$"):
        environment.check_space(tmp_path)


def test_the_first_domain_that_no_graph_has_is_held() -> None:
    names = f"test_{os.getpid()}"
    assert graph_names.hold(f"1/{names}")
    assert graph_names.hold_another_domain(names) == "2"
    assert graph_names.hold_another_domain(names) == "3"
