"""Damages of lines, for a time, and by real-time bytes: exactly these bytes change, and no run of a sample is wrong."""

from __future__ import annotations

import random

import pytest
from campaign.damage import Case, main, run_case, text_of
from campaign.damage_judge import REPORTED, WRONG
from campaign.damage_rig import DIRECTIONS, FROM_BOARD, TO_BOARD
from campaign.other_damage import LATE_S, REALTIME, OtherDamage

pytestmark = pytest.mark.long

PIECES = [b"?", b"X1\n", b"?Y2\n", b"Z3\n", b"?", b"?", b"X4\n"]
STEP_S = 0.15
SAMPLE = range(0, 121, 11)


def received(kind: str, after: int = 2, seed: int = 0) -> bytes:
    """Return what arrives of the pieces, one each STEP_S."""
    damage, now = OtherDamage(kind, after, random.Random(seed)), 0.0
    damage.clock = lambda: now
    arrived = b""
    for piece in PIECES:
        arrived += damage.apply(piece)
        now += STEP_S
    now += 1.0
    assert damage.done and (damage.was != damage.became or kind == "stuck"), "a stuck bit may change nothing"
    return arrived


@pytest.mark.parametrize(
    ("kind", "arrives"),
    [
        ("no questions", b"?X1\nY2\nZ3\nX4\n"),
        ("line lost", b"?X1\n?Z3\n??X4\n"),
        ("line emptied", b"?X1\n?\nZ3\n??X4\n"),
        ("line doubled", b"?X1\n?Y2\nY2\nZ3\n??X4\n"),
        ("lines merged", b"?X1\n?Y2Z3\n??X4\n"),
        ("lines swapped", b"?X1\n?Z3\nY2\n??X4\n"),
    ],
)
def test_a_damage_hits_one_whole_line_or_a_time(kind: str, arrives: bytes) -> None:
    assert received(kind) == arrives


def test_a_line_without_a_successor_is_late_and_not_lost() -> None:
    damage, now = OtherDamage("lines swapped", 1, random.Random(0)), 0.0
    damage.clock = lambda: now
    assert damage.apply(b"\nZ3\n?") == b"\n?"
    now = LATE_S
    assert damage.apply(b"?") == b"Z3\n?" and damage.done


def test_a_line_may_come_again_much_later() -> None:
    arrived = received("line repeated")
    assert arrived.count(b"Y2\n") == 2 and arrived.replace(b"Y2\n", b"", 1).count(b"\n") == 4


def test_real_time_bytes_are_inserted_or_replace_one() -> None:
    sent = b"".join(PIECES)
    inserted, replaced = set(), set()
    for seed in range(300):
        arrived = received("inserted", 5, seed)
        assert arrived[:5] + arrived[6:] == sent
        inserted.add(arrived[5])
        arrived = received("realtime", 5, seed)
        assert arrived[:5] + arrived[6:] == sent[:5] + sent[6:]
        replaced.add(arrived[5])
    assert inserted == set(REALTIME) and replaced <= set(REALTIME)


def test_a_bit_is_stuck_and_a_line_silent_for_a_time() -> None:
    changes = {received("stuck", 0, seed) for seed in range(60)}
    assert all(len(arrived) == len(b"".join(PIECES)) for arrived in changes) and len(changes) > 10
    assert all(b"".join(PIECES).endswith(received("silent", 0, seed)) for seed in range(20))


@pytest.mark.parametrize("direction", DIRECTIONS)
def test_other_damage_never_ends_wrong(direction: str) -> None:
    found = [run_case(Case(direction, seed, OtherDamage)) for seed in SAMPLE]
    assert {item.kind for item in found} == set(OtherDamage.kinds)
    wrong = [item for item in found if item.verdict == WRONG]
    assert not wrong, "\n".join(text_of(item) for item in wrong)


@pytest.mark.parametrize("seed", [3898])
def test_a_feed_that_rises_with_each_order_to_set_it_back_is_stopped(seed: int) -> None:
    found = run_case(Case(TO_BOARD, seed, OtherDamage))
    assert found.verdict != WRONG, text_of(found)
    assert any("feed override rises" in text for text in found.told)


@pytest.mark.parametrize("seed", [353, 595, 958])
def test_the_position_of_an_old_report_is_not_published_at_rest(seed: int) -> None:
    found = run_case(Case(FROM_BOARD, seed, OtherDamage))
    assert found.verdict == REPORTED, text_of(found)
    assert found.told == ["stopped: the board is in Run without a command from here"]


def test_the_command_repeats_a_run_of_these_kinds(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--seeds", "11:12", "--direction", TO_BOARD, "--kinds", "other"]) == 0
    printed = capsys.readouterr().out
    assert "DAMAGE_SEEDS=11:12 DAMAGE_DIRECTION=to_board DAMAGE_KINDS=other" in printed
    assert "| phase | inserted | realtime |" in printed
