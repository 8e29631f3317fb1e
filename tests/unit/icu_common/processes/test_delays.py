"""The codes of results that slowness caused."""

from __future__ import annotations

from dataclasses import replace

from icu_common.core.goals.results import GoalResult, Outcome
from icu_common.core.processes.delays import Delay, ResultCode, delay_of, is_delayed, with_load

LATE = Delay(code=ResultCode.LATE_IMAGE, what="image of the left camera", measured_s=1.416, limit_s=1.0)


def test_a_delay_goes_into_a_result_and_comes_out_of_it() -> None:
    plain = GoalResult(goal_id="7", goal="x", outcome=Outcome.ABORTED, reason="late")
    assert plain.code == "" and delay_of(plain) is None and not is_delayed(plain)
    result = replace(plain, code=LATE.code.value, details=LATE.details())
    assert delay_of(result) == LATE and is_delayed(result)
    assert str(LATE.code) == result.code == "late_image"
    assert with_load(result, "load 7.1").reason == "late; load 7.1" and with_load(result, "") == result
    assert LATE.text() == "image of the left camera is late: 1.42 s (limit 1 s)"


def test_a_code_that_is_not_known_here_is_no_delay() -> None:
    newer = GoalResult(goal_id="7", goal="x", outcome=Outcome.ABORTED, code="moved", details=LATE.details())
    assert delay_of(newer) is None
    touched = GoalResult(goal_id="7", goal="x", outcome=Outcome.ABORTED, details=LATE.details())
    assert delay_of(touched) is None and is_delayed(touched), "not to be repeated, and slow all the same"
