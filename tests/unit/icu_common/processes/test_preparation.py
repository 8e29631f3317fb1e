"""Lines of ``gantry_prepare --json``: what is written is read again, and what is no report is rejected."""

from __future__ import annotations

import pytest

from icu_common.core.processes.preparation import (
    PreparationCause,
    PreparationReport,
    PreparationStage,
    calibration_report,
    from_line,
    to_line,
)


@pytest.mark.parametrize(
    ("state", "done", "total", "missed", "left_s"),
    [
        ("calibrating 0/24", 0, 24, 0, None),
        ("calibrating 12/24 (1 missed)", 12, 24, 1, None),
        ("calibrating 3/8, 2 missed, 21.5 s left", 3, 8, 2, 21.5),
        ("calibrated: 0.05 mm", 0, 0, 0, None),
    ],
)
def test_a_state_of_the_calibration_becomes_numbers(
    state: str, done: int, total: int, missed: int, left_s: float | None
) -> None:
    report = calibration_report(state)
    assert (report.done, report.total, report.missed, report.left_s) == (done, total, missed, left_s)
    assert report.text == state and report.stage is PreparationStage.CALIBRATING


@pytest.mark.parametrize(
    ("report", "line"),
    [
        (PreparationReport(stage=PreparationStage.HOMING), '{"stage": "homing"}'),
        (
            calibration_report("calibrating 1/9"),
            '{"stage": "calibrating", "text": "calibrating 1/9", "done": 1, "total": 9}',
        ),
        (
            PreparationReport(
                stage=PreparationStage.FAILED,
                failed_at=PreparationStage.HOMING,
                cause=PreparationCause.TIMED_OUT,
                text="late",
            ),
            '{"stage": "failed", "text": "late", "failed_at": "homing", "cause": "timed_out"}',
        ),
    ],
)
def test_a_report_is_one_line_and_comes_back(report: PreparationReport, line: str) -> None:
    assert to_line(report) == line
    assert from_line(line) == report


@pytest.mark.parametrize("line", ["", "homing", "[]", "{}", '{"stage": "flying"}', '{"stage": "homing", "more": 1}'])
def test_what_is_no_report_is_rejected(line: str) -> None:
    with pytest.raises(ValueError, match="is no report of a preparation"):
        from_line(line)
