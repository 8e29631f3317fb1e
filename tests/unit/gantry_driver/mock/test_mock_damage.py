"""Damage on the mock board's serial line: exactly the named bytes change, in both directions."""

from __future__ import annotations

import random

import pytest
from unit.gantry_driver.mock_rig import Rig

from gantry_driver.mock.machine import FaultError
from gantry_driver.mock.serial_line import CONTEXT_BYTES, Damage

SENT = bytes(range(65, 91))


def damaged(kind: str, after: int, *, size: int, seed: int = 0) -> bytes:
    """Return what arrives of SENT, sent in pieces of ``size`` bytes."""
    damage = Damage(kind, after, random.Random(seed))
    received = b"".join(damage.apply(SENT[first : first + size]) for first in range(0, len(SENT), size))
    assert damage.done and damage.was != damage.became
    return received


@pytest.mark.parametrize("size", [1, 3, 26])
@pytest.mark.parametrize("after", [0, 1, 5, 24])
def test_each_kind_of_damage_hits_the_named_byte_however_the_bytes_are_cut(after: int, size: int) -> None:
    head, byte, rest = SENT[:after], SENT[after : after + 1], SENT[after + 1 :]
    assert damaged("lost", after, size=size) == head + rest
    assert damaged("doubled", after, size=size) == head + byte * 2 + rest
    assert damaged("swapped", after, size=size) == head + rest[:1] + byte + rest[1:]
    flipped = damaged("flip", after, size=size)
    assert flipped[:after] == head and flipped[after + 1 :] == rest
    assert (flipped[after] ^ byte[0]).bit_count() == 1
    replaced = damaged("replaced", after, size=size)
    assert replaced[:after] == head and replaced[after + 1 :] == rest and replaced[after] != byte[0]


def test_a_burst_replaces_two_to_eight_neighbours() -> None:
    lengths = set()
    for seed in range(60):
        received = damaged("burst", 7, size=4, seed=seed)
        changed = [at for at, (a, b) in enumerate(zip(SENT, received)) if a != b]
        assert len(received) == len(SENT) and changed == list(range(7, 7 + len(changed)))
        lengths.add(len(changed))
    assert lengths == set(range(2, 9))


def test_the_bytes_around_the_damage_are_kept() -> None:
    damage = Damage("lost", 100, random.Random(0))
    damage.apply(b"a" * 90)
    assert not damage.begun
    damage.apply(b"b" * 10 + b"X" + b"c" * 90)
    assert damage.was == b"b" * 10 + b"X" + b"c" * CONTEXT_BYTES
    assert damage.became == b"b" * 10 + b"c" * CONTEXT_BYTES


def test_damage_to_the_board_changes_what_it_reads() -> None:
    rig = Rig.homed()
    rig.machine.inject("damage", {"direction": "to_board", "how": "lost", "after": 4})
    assert rig.send(b"G1X-50F6000\n", 10.0) == b"ok\r\n"
    assert rig.board.journal.since(0, "line")[-1]["text"] == "G1X-0F6000"


def test_damage_from_the_board_changes_what_it_sends() -> None:
    rig = Rig.free()
    rig.machine.inject("damage", {"direction": "from_board", "how": "doubled", "after": 1})
    assert rig.send(b"G21\n") == b"okk\r\n"
    assert rig.send(b"G21\n") == b"ok\r\n", "one damage is all"


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        ({"direction": "sideways", "how": "lost"}, "direction = 'sideways'"),
        ({"direction": "to_board", "how": "eaten"}, "how = 'eaten'"),
        ({"direction": "to_board", "how": "lost", "after": -1}, "after = -1"),
    ],
)
def test_a_damage_that_does_not_exist_is_rejected(arguments: dict[str, object], told: str) -> None:
    with pytest.raises(FaultError, match=told):
        Rig.free().machine.inject("damage", arguments)
