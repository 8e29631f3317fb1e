"""A replay takes a ROS domain in which no graph runs."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator

import pytest

from icu_bringup.adapters.check.replay import free_domain
from icu_bringup.adapters.graph_names import is_held

_HOLD = "import sys; from icu_bringup.adapters.graph_names import hold; print(hold(sys.argv[1]), flush=True); input()"


@pytest.fixture
def first_free() -> int:
    """A domain that is free now: another test may use the first ones."""
    code = "from icu_bringup.adapters.check.replay import free_domain; print(free_domain())"
    return int(subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout)


@pytest.fixture
def graph(first_free: int) -> Iterator[int]:
    """A process that holds the names of a graph without a namespace in a domain."""
    command = [sys.executable, "-c", _HOLD, f"{first_free}/"]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None and process.stdout.readline() == "True\n"
        yield first_free
        process.communicate("\n", timeout=40.0)


def test_a_domain_with_a_graph_is_left_out(graph: int) -> None:
    """The graph of a check that was killed runs on; the next check failed in the same domain."""
    assert is_held(f"{graph}/")
    assert free_domain() > graph
    assert is_held(f"{graph}/"), "looking does not take the name away"
