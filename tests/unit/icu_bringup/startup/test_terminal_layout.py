"""Box of bring-up at the bottom of a terminal, and the words for it."""

from __future__ import annotations

import pytest
from unit.icu_bringup.startup.small_terminal import SmallTerminal

from icu_bringup.core.startup.qr_code import qr_modules
from icu_bringup.core.startup.run_words import (
    AUTOMATIC_REPEATS,
    RemainingTime,
    failure,
    next_step,
    preparing,
    repeats_by_itself,
    starting,
)
from icu_bringup.core.startup.terminal_layout import (
    Box,
    box_rows,
    height,
    moving_line,
    qr_rows,
    redraw,
    without_controls,
)
from icu_common.core.processes.preparation import PreparationCause, PreparationReport, PreparationStage

ADDRESS = "http://127.0.0.1:8080/?token=" + "k" * 43
NOTES = ("Ready: the machine is homed and calibrated.", "Ctrl-C ends every program.")
LOG = "Log: /home/somebody/.local/state/icu_gantry/logs/bring_up.log"


@pytest.mark.parametrize("columns", [20, 60, 80, 200])
def test_a_moving_line_stays_in_its_row(columns: int) -> None:
    line = moving_line("calibrating 12/24, about 30 s left\x1b[31m\n", 12, 24, columns)
    assert len(line) < columns
    assert line.startswith("[##########..........] calibrating 12/24"[: columns - 1])
    assert "\x1b" not in line and "\n" not in line


def test_a_redraw_leaves_messages_above_and_one_block_below() -> None:
    terminal = SmallTerminal(40, 10)
    terminal.write(redraw(0, [], ["starting 1/14"]))
    terminal.write(redraw(1, ["camera ! restarted"], ["starting 2/14"]))
    terminal.write(redraw(1, [], ["+---+", "| a |", "+---+"]))
    terminal.write(redraw(3, ["two", "lines\nmore"], ["+---+", "| b |", "+---+"]))
    assert terminal.screen == ["camera ! restarted", "two", "lines", "more", "+---+", "| b |", "+---+"]


@pytest.mark.parametrize("columns", [30, 50, 78, 80, 100, 132])
@pytest.mark.parametrize("rows", [8, 24, 30, 60])
def test_a_box_fits_and_has_the_address_in_one_piece(columns: int, rows: int) -> None:
    box = Box(address=ADDRESS, notes=NOTES, footer=LOG, qr=qr_modules(ADDRESS))
    drawn = box_rows(box, columns, rows)
    assert all(any(text in row for row in drawn) for text in (ADDRESS, LOG))
    for row in drawn:
        assert len(without_controls(row)) < columns or row in (ADDRESS, LOG)
    if any("\x1b" in row for row in drawn):
        assert height(drawn, columns) <= rows
    terminal = SmallTerminal(columns, max(rows, 60))
    terminal.write(redraw(0, [], drawn)).write(redraw(height(drawn, columns), ["above"], ["last"]))
    assert terminal.screen == ["above", "last"], "the height counts wrapped rows, too"


def test_a_terminal_of_usual_size_shows_the_code_and_a_small_one_the_address_alone() -> None:
    box = Box(address=ADDRESS, notes=NOTES, footer=LOG, qr=qr_modules(ADDRESS))
    code = qr_rows(box.qr)
    for columns, rows in ((80, 24), (120, 40)):
        drawn = box_rows(box, columns, rows)
        assert [row for row in code if any(row in line for line in drawn)] == code
    for columns, rows, unicode in ((60, 24, True), (80, 20, True), (80, 24, False)):
        drawn = box_rows(box, columns, rows, unicode=unicode)
        assert "\x1b" not in "".join(drawn) and any("homed and calibrated" in row for row in drawn)
    assert "".join(box_rows(box, 80, 24, unicode=False)).isascii()


def test_the_code_has_the_modules_of_the_address_in_half_blocks() -> None:
    modules = ((1, 0, 1), (1, 1, 0), (0, 0, 1))
    rows = [without_controls(row) for row in qr_rows(modules)]
    assert rows == ["       ", "  █▄▀  ", "    ▀  ", "       "]
    code = qr_modules(ADDRESS)
    finder = ((1,) * 7, (1, 0, 0, 0, 0, 0, 1), (1, 0, 1, 1, 1, 0, 1))
    assert len(code) == 33 and tuple(row[:7] for row in code[:3]) == finder, "version 4 holds 78 bytes"


def test_the_remaining_time_follows_the_progress() -> None:
    remaining = RemainingTime()
    assert remaining.left_s(0.0) is None
    remaining.progress(0, 10, 100.0)
    assert remaining.left_s(100.0) is None
    remaining.progress(2, 10, 104.0)
    assert remaining.left_s(104.0) == 16
    assert remaining.left_s(109.0) == 11
    remaining.progress(2, 10, 109.0)
    assert remaining.left_s(109.0) == 11, "a repeated report is no progress"
    remaining.progress(3, 10, 109.0)
    assert remaining.left_s(109.0) == 21
    assert remaining.left_s(1000.0) == 1
    remaining.progress(0, 10, 2000.0)
    assert remaining.left_s(2000.0) is None, "a new calibration"
    remaining.progress(1, 10, 2001.0, left_s=7.4)
    assert remaining.left_s(2001.0) == 7, "what the calibration says itself counts"


def test_words_of_the_steps() -> None:
    assert starting(7, 14).text == "starting 7/14"
    assert preparing(PreparationReport(stage=PreparationStage.HOMING), None).text == "homing"
    report = PreparationReport(stage=PreparationStage.CALIBRATING, done=12, total=24, missed=1)
    status = preparing(report, 40)
    assert status.text == "calibrating 12/24, 1 missed, about 40 s left" and (status.done, status.total) == (12, 24)
    late = PreparationReport(
        stage=PreparationStage.FAILED,
        failed_at=PreparationStage.CAMERAS,
        cause=PreparationCause.TIMED_OUT,
        text="no picture",
    )
    assert failure(late) == "The preparation took too long while waiting for the cameras: no picture"
    refused = PreparationReport(
        stage=PreparationStage.FAILED, failed_at=PreparationStage.HOMING, cause=PreparationCause.REFUSED, text="alarm"
    )
    assert failure(refused) == "The preparation failed while homing: alarm"
    assert next_step(key=True, page=True).startswith(
        "To repeat it, type r and Enter here or press Calibrate on the page"
    )
    assert "gantry_prepare" in next_step(key=False, page=False)


def test_only_slowness_repeats_by_itself_and_not_for_ever() -> None:
    late = PreparationReport(
        stage=PreparationStage.FAILED, failed_at=PreparationStage.CAMERAS, cause=PreparationCause.TIMED_OUT
    )
    assert [repeats_by_itself(late, n) for n in range(AUTOMATIC_REPEATS + 1)] == [True] * AUTOMATIC_REPEATS + [False]
    assert not repeats_by_itself(PreparationReport(stage=PreparationStage.FAILED, cause=PreparationCause.REFUSED), 0)
