"""A lamp that the raised stylus hides, next to a screen that has changed."""

from __future__ import annotations

import pytest
from unit.gantry_driver.controller_bench import Bench, details

from gantry_driver.core.job.goal_job import Phase
from icu_common.core.goals.results import Outcome


def seeing() -> Bench:
    bench = Bench()
    bench.talking.add("state")
    return bench.start()


@pytest.mark.parametrize(("lamp", "effect"), [("red", "lamp green -> red"), ("green", "screen changed")])
def test_a_lamp_behind_the_raised_stylus_is_read_although_a_screen_has_changed(lamp: str, effect: str) -> None:
    """Before, only the screen was reported: the lamp, which is the better evidence, was never looked at."""
    bench = seeing()

    def press(b: Bench) -> None:
        b.screen_changed_ns, b.lamp = b.now_ns, lamp
        b.hidden["RUN_STOP"] = "stylus"

    bench.on_phase[Phase.CONTACT] = press
    bench.on_phase[Phase.ASIDE] = lambda b: b.hidden.clear()
    result = bench.do("press:RUN_STOP")
    assert result.outcome is Outcome.REACHED and details(result)["effect"] == effect, result


def test_a_lamp_that_stays_hidden_is_looked_for_once_more_from_aside() -> None:
    bench = seeing()
    began: dict[Phase, int] = {}

    def press(b: Bench) -> None:
        b.screen_changed_ns, b.lamp = b.now_ns, "red"
        b.hidden["RUN_STOP"] = "stylus"

    def again(b: Bench) -> None:
        began[Phase.ASIDE] = b.now_ns
        b.on_phase[Phase.READ] = lambda b: began.update({Phase.IDLE: b.now_ns})

    bench.on_phase[Phase.CONTACT] = press
    bench.on_phase[Phase.READ] = lambda b: began.update({Phase.READ: b.now_ns})
    bench.on_phase[Phase.ASIDE] = again
    assert details(bench.do("press:RUN_STOP"))["effect"] == "screen changed"
    assert (began[Phase.ASIDE] - began[Phase.READ]) / 1e9 == pytest.approx(1.0, abs=0.2), "looked for 1 s at most"
    assert (bench.now_ns - began[Phase.IDLE]) / 1e9 == pytest.approx(4.0, abs=0.2), "effect_wait_s and read_timeout_s"
