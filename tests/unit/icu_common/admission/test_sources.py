"""Sources of a topic that count as a second program: successors do not, twins and strangers do."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from icu_common.adapters.processes.process_identity import ParticipantProcesses
from icu_common.core.admission.sources import (
    LEASE_S,
    NAMED_WITHIN_S,
    UNNAMED,
    Source,
    TopicSources,
    distrust_text,
    rivals_text,
)

pytestmark = pytest.mark.slow

A, B = b"a" * 12, b"b" * 12
OLD, NEW = Source(name="/panel/recognition", process=A), Source(name="/panel/recognition", process=B)
STRANGER = Source(name="/stranger", process=B)


def sources(*, alive: dict[bytes, bool | None]) -> TopicSources:
    return TopicSources(lambda process: alive[process])


def test_two_living_programs_are_two_at_once() -> None:
    found = sources(alive={A: True, B: True}).judge([OLD, STRANGER], 5.0)
    assert found.names == ("/panel/recognition", "/stranger") and not found.undecided


def test_successor_of_a_killed_program_is_one() -> None:
    watched = sources(alive={A: False, B: True})
    assert watched.judge([OLD], 0.0).names == ("/panel/recognition",)
    found = watched.judge([OLD, NEW], 1.0)
    assert found.names == ("/panel/recognition",) and found.undecided
    assert watched.judge([NEW], 11.0).names == ("/panel/recognition",)


def test_successor_of_a_program_that_ran_for_long_is_one() -> None:
    alive: dict[bytes, bool | None] = {A: True, B: True}
    watched = sources(alive=alive)
    watched.judge([OLD], 0.0)
    alive[A] = False
    for now_s in (1000.0, 1005.0, 1009.9):
        assert watched.judge([OLD, NEW], now_s).names == ("/panel/recognition",)
    alive[A] = True
    assert len(watched.judge([OLD, NEW], 1010.0).names) == 2


def test_stranger_beside_a_killed_program_is_one() -> None:
    assert sources(alive={A: False, B: True}).judge([OLD, STRANGER], 0.0).names == ("/stranger",)


def test_program_whose_lease_goes_on_lives_where_its_process_is_not_seen() -> None:
    watched = sources(alive={A: False, B: True})
    watched.judge([OLD, STRANGER], 0.0)
    assert watched.judge([OLD, STRANGER], LEASE_S + 1.0).names == ("/panel/recognition", "/stranger")


def test_twin_in_another_living_process_is_a_second_one() -> None:
    names = sources(alive={A: True, B: True}).judge([OLD, NEW], 0.0).names
    assert rivals_text("/panel/pose", names) == "two programs publish panel/pose: /panel/recognition (2 times)"


@pytest.mark.parametrize("together", [False, True])
def test_twin_on_another_host_may_be_a_successor_until_the_lease_has_ended(together: bool) -> None:
    watched = sources(alive={A: None, B: None})
    if not together:
        watched.judge([OLD], 0.0)
    first = watched.judge([OLD, NEW], 1.0)
    assert len(first.names) == 1 and first.undecided
    assert len(watched.judge([OLD, NEW], 2.0 + LEASE_S).names) == 2


def test_stranger_on_another_host_is_a_second_one_at_once() -> None:
    assert len(sources(alive={A: True, B: None}).judge([OLD, STRANGER], 0.0).names) == 2


def test_name_is_waited_for_and_not_for_long() -> None:
    watched, unnamed = sources(alive={A: True, B: True}), Source(name="", process=B)
    found = watched.judge([OLD, unnamed], 0.0)
    assert found.names == (UNNAMED, "/panel/recognition") and found.unnamed and found.undecided
    later = watched.judge([OLD, unnamed], NAMED_WITHIN_S + 0.01)
    assert later.names == (UNNAMED, "/panel/recognition") and not later.unnamed


def test_two_publishers_of_one_node_are_one_source() -> None:
    assert sources(alive={A: True}).judge([OLD, OLD], 0.0).names == ("/panel/recognition",)


def test_source_that_is_not_allowed_is_named() -> None:
    assert distrust_text(["/gantry/gantry_controller"], "gantry_controller") == ""
    assert distrust_text(["/a", "/gantry_controller"], "gantry_controller") == (
        "from /a: trajectory_programs allows gantry_controller"
    )
    assert distrust_text([UNNAMED], "gantry_controller").startswith("from a program without a name")
    assert distrust_text([], "gantry_controller").startswith("from no known program")
    assert distrust_text(["/a"], "*") == distrust_text([], " * ") == ""
    assert distrust_text(["/a"], "").endswith("allows no program")


def test_texts() -> None:
    assert rivals_text("/panel/pose", ["/a"]) == "" == rivals_text("/panel/pose", [])
    assert rivals_text("/bed_1/panel/pose", ["/b", "/a"]) == "two programs publish bed_1/panel/pose: /a and /b"
    assert rivals_text("/x", ["/c", "/b", "/a"]) == "three programs publish x: /a, /b and /c"


def test_process_of_a_participant() -> None:
    """Fast DDS writes vendor, host, lower half of the process number, a random number, the participant's number."""
    processes = ParticipantProcesses()

    def participant(number: int, host: bytes = b"\x78\xfd") -> bytes:
        return b"\x01\x0f" + host + (number & 0xFFFF).to_bytes(2, "little") + b"\x12\x34" + bytes(4)

    assert processes.is_alive(participant(os.getpid())) is None, "its own participant is not known yet"
    processes.learn(participant(os.getpid() ^ 1))
    assert not processes.known, "another middleware's identifier"
    processes.learn(participant(os.getpid()))
    assert processes.known
    child = subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE)
    assert processes.is_alive(participant(child.pid)) is True
    child.communicate(b"\n")
    assert processes.is_alive(participant(child.pid)) is False
    assert processes.is_alive(participant(os.getpid(), b"\x01\x02")) is None
