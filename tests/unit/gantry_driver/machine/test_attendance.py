"""Signs of the controller: what counts as silence."""

from __future__ import annotations

import pytest

from gantry_driver.core.machine.attendance import Attendance, silent_text


def test_silence_begins_with_the_last_sign() -> None:
    attendance = Attendance()
    assert attendance.silent_s(100.0) == 0.0, "no controller has begun"
    attendance.take(True, 100.0)
    assert attendance.silent_s(100.5) == pytest.approx(0.5)
    attendance.take(True, 101.0)
    assert attendance.silent_s(101.25) == pytest.approx(0.25)
    assert attendance.silent_s(99.0) == 0.0, "a clock that is set back is no silence"


def test_a_released_machine_misses_nobody() -> None:
    attendance = Attendance()
    attendance.take(True, 100.0)
    attendance.take(False, 100.1)
    assert attendance.silent_s(200.0) == 0.0


def test_after_a_stop_no_sign_is_expected() -> None:
    attendance = Attendance()
    attendance.take(True, 100.0)
    attendance.forget()
    assert attendance.silent_s(200.0) == 0.0


def test_the_reason_names_the_program_and_the_time() -> None:
    assert silent_text(0.84) == "gantry_controller has sent no sign of its goal for 0.8 s"
