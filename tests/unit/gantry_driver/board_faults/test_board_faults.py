"""Messages of the driver about a board that reports too little, sends unreadable reports, or starts again and again."""

from __future__ import annotations

import re

import pytest
from unit.gantry_driver.protocol_board import Board, Rig

from gantry_driver.core.board_faults.resets import RESETS_APART_S, ResetLog
from gantry_driver.core.grbl.grbl_messages import Dialect, alarm_text, error_text
from gantry_driver.core.states.machine_states import Note, StateChanged
from icu_common.core.reasons.message import parts

ERRORS = (*range(1, 18), *range(20, 39))
"""All of GRBL 1.1's; doc/csv/error_codes_en_US.csv of gnea/grbl."""
ALARMS = range(1, 10)
"""All of GRBL 1.1's; doc/csv/alarm_codes_en_US.csv of gnea/grbl."""


@pytest.mark.parametrize("text", [error_text(code) for code in ERRORS] + [alarm_text(c, Dialect.GRBL) for c in ALARMS])
def test_every_code_of_grbl_has_a_sentence(text: str) -> None:
    assert "see the manual" not in text
    _, meaning = parts(text)
    assert meaning.code.startswith("grbl.")


RESET = "the board has reset itself and lost its position"


def logged(rig: Rig) -> list[str]:
    return [event.text for event in rig.events if isinstance(event, Note)]


@pytest.mark.parametrize("apart_s", [0.02, 0.3, 2.0])
def test_a_board_that_starts_again_and_again_gets_one_line_and_each_state_one(apart_s: float) -> None:
    rig = Rig().homed()
    before, resets = len(rig.events), rig.machine.counts.resets
    for _ in range(20):
        rig.board.power_cycle()
        rig.run_for(apart_s)
    rig.run_for(RESETS_APART_S + 1.0)
    assert logged(rig) == [f"{RESET}; 0 lines unanswered"]
    states = [event for event in rig.events[before:] if isinstance(event, StateChanged)]
    assert [event.text for event in states if event.logged] == [f"connecting: {RESET}", f"unhomed: {RESET}"]
    assert len(states) > 10, "they are published all the same"
    assert rig.machine.counts.resets >= resets + 20, "the diagnostics have the count"


def test_lines_lost_with_a_later_reset_of_a_row_are_logged_at_its_end() -> None:
    log = ResetLog()
    assert [note.text for note in log.reset(RESET, 2, 10.0)] == [f"{RESET}; 2 lines unanswered"]
    assert log.reset(RESET, 0, 11.0) == log.reset(RESET, 3, 12.5) == log.tick(12.5 + RESETS_APART_S - 0.1) == []
    assert [note.text for note in log.tick(12.5 + RESETS_APART_S)] == [
        "the board has reset itself 2 more times within 2.5 s; 3 lines unanswered"
    ]
    assert log.tick(30.0) == [] and log.reset(RESET, 0, 31.0)
    assert not log.repeats("unhomed"), "a new row"


def test_two_resets_far_apart_get_a_line_each() -> None:
    rig = Rig().homed()
    for _ in range(2):
        rig.board.power_cycle()
        rig.run_for(RESETS_APART_S + 1.0)
    assert logged(rig) == ["the board has reset itself and lost its position; 0 lines unanswered"] * 2


class WorkPositions(Board):
    """A grblHAL whose ``$10`` lacks the bits of machine position and work offset."""

    def __init__(self, mask: str) -> None:
        super().__init__(locked=False)
        self.settings = {10: mask, **self.settings}

    def say(self, text: str) -> None:
        if text.startswith("[OPT"):
            super().say("[FIRMWARE:grblHAL]")
        super().say(text)

    def report(self) -> str:
        x, y, z = self.mpos
        mask = int(float(self.settings[10]))
        place = f"{'MPos' if mask & 1 else 'WPos'}:{x:.3f},{y:.3f},{z:.3f}"
        return f"<{self.state}|{place}|FS:0,0{'|WCO:0,0,0' if mask & 32 else ''}>"


def test_a_grblhal_without_machine_position_names_the_missing_bit_and_can_be_mended() -> None:
    rig = Rig(board=WorkPositions("478")).connect()
    assert rig.states[-1] == (
        "mismatch: $10 is 478: its reports have no machine position without bit 0 (1) or bit 5 (32); "
        "expected 479 (the configuration)"
    )
    assert rig.machine.write_settings(rig.now) == ""
    rig.until(lambda: rig.state == "unhomed")
    assert rig.board.settings[10] == "479.000"
    assert rig.machine.home(rig.now) == ""
    rig.until(lambda: rig.state == "idle")


@pytest.mark.parametrize("mask", ["510", "511", "479"])
def test_a_grblhal_that_reports_a_position_or_an_offset_is_taken(mask: str) -> None:
    assert Rig(board=WorkPositions(mask)).homed().states[-1] == "idle"


def test_homing_does_not_hang_where_reports_have_no_machine_position() -> None:
    rig = Rig(board=WorkPositions("478")).connect()
    assert rig.machine.accept_settings(rig.now) == ""
    begun = rig.now
    assert rig.machine.home(rig.now) == ""
    rig.until(lambda: rig.state == "stopped", 20.0)
    assert rig.now - begun < 8.0
    assert "the board's reports have no machine position: $10 is 478, set its bit 0 (1)" in " ".join(rig.states)


class StrangeReports(Board):
    def report(self) -> str:
        return "<Idle,MPos:5.000,0.000,0.000,WPos:0.000,0.000,0.000>"


def test_reports_that_cannot_be_read_are_quoted() -> None:
    rig = Rig(board=StrangeReports(locked=False))
    rig.machine.opened(0.0)
    rig.board.reset()
    rig.until(lambda: rig.state == "disconnected" and len(rig.states) > 2, 20.0)
    assert re.fullmatch(
        r"disconnected: no status report for [\d.]+ s: cannot read "
        r"'<Idle,MPos:5\.000,0\.000,0\.000,WPos:0\.000,0\.000,0\.000>'",
        rig.states[-1],
    )


class NoGrbl(StrangeReports):
    """Answers ``?`` alone."""

    def reset(self) -> None:
        pass


def test_what_a_board_without_a_banner_sends_is_quoted() -> None:
    rig = Rig(board=NoGrbl(locked=False))
    rig.machine.opened(0.0)
    rig.until(lambda: len(rig.states) > 2, 20.0)
    text = "no answer in 6 s while waiting for a banner: cannot read '<Idle,MPos:5.000,0.000,0.000,WPos:"
    assert rig.states[-1].startswith(f"disconnected: {text}")
