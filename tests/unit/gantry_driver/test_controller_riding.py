"""Cameras on the carriage: they see what they have come to, and find the panel anew from wherever they stand."""

from __future__ import annotations

import dataclasses

import pytest
from unit.gantry_driver.controller_bench import BASE_FROM_PANEL, KNOB, Bench, RidingBench
from unit.gantry_driver.test_controller_gestures import BUTTON_Z, details

from gantry_driver.core import controller_messages as msg
from gantry_driver.core.goal_job import Phase
from icu_common.core.results import Outcome


@pytest.mark.parametrize(("lamp", "effect"), [("red", "lamp green -> red"), ("green", "none seen")])
def test_cameras_that_went_aside_themselves_have_time_to_find_the_panel_from_there(lamp: str, effect: str) -> None:
    """Riding ones see another picture then: the lamp was told to have done nothing before anything was seen of it."""
    bench = RidingBench()
    bench.talking.add("state")
    bench.start()
    went: list[int] = []

    def look_from_aside(b: Bench) -> None:
        b.hidden.clear()
        b.talking.discard("state")
        went.append(b.now_ns)

    def press(b: Bench) -> None:
        b.lamp = lamp
        b.hidden["RUN_STOP"] = "stylus"
        b.on_phase[Phase.ASIDE] = lambda b: b.on_phase.update({Phase.READ: look_from_aside})

    bench.on_phase[Phase.CONTACT] = press
    bench.tell(msg.Command(text="press:RUN_STOP"))
    for _ in range(1000):
        bench.run(0.02)
        if went and bench.now_ns - went[0] > 1.2e9:
            bench.talking.add("state")
        if bench.finals:
            break
    result = bench.finals[-1]
    assert result.outcome is Outcome.REACHED and details(result)["effect"] == effect, result
    assert (bench.now_ns - went[0]) / 1e9 < 1.2 + 0.4, "no longer than it takes"


def beyond_the_edge(name: str, kind: type[Bench] = RidingBench) -> Bench:
    """A bench that has seen nothing of a control yet, as it is not in the picture."""
    bench = kind()
    bench.talking.add("state")
    bench.hidden[name] = "edge"
    bench.start().run(0.5)
    return bench


@pytest.mark.parametrize("command", ["press", "long", "double", "hold"])
def test_what_is_not_in_the_picture_is_pressed_once_the_cameras_have_come_to_it(command: str) -> None:
    """From the homed machine cameras on the carriage do not see the whole panel: a hand was blamed for it."""
    bench = beyond_the_edge("RUN_STOP")

    def press(b: Bench) -> None:
        b.lamp = "red"

    bench.on_phase[Phase.READ] = lambda b: b.hidden.clear()
    bench.on_phase[Phase.CONTACT] = press
    result = bench.do(f"{command}:RUN_STOP{':0.5' if command == 'hold' else ''}")
    assert result.outcome is Outcome.REACHED and details(result)["effect"] == "lamp green -> red", result


@pytest.mark.parametrize("command", ["turn:CH1_SCALE:-36", "click:CH1_SCALE:2", "set:CH1_SCALE:-16"])
def test_a_knob_that_is_not_in_the_picture_is_turned_by_what_is_seen_from_beside_it(command: str) -> None:
    bench = beyond_the_edge("CH1_SCALE")
    bench.knob_slips = 0.3
    bench.on_phase[Phase.READ] = lambda b: b.hidden.clear()
    result = bench.do(command)
    assert result.outcome is Outcome.REACHED and bench.knob_deg == pytest.approx(-16.0, abs=2.0), result
    assert float(details(result)["knob_deg"]) == pytest.approx(bench.knob_deg, abs=0.01)


def test_a_hand_over_what_came_into_the_picture_ends_the_gesture_above_it() -> None:
    bench = beyond_the_edge("RUN_STOP")
    bench.controller.config = dataclasses.replace(bench.controller.config, look_timeout_s=20.0)
    bench.on_phase[Phase.LOOK] = lambda b: (b.hidden.update(RUN_STOP="something"), b.talking.discard("tip"))
    result = bench.do("press:RUN_STOP")
    assert result.outcome is Outcome.ABORTED and "hides RUN_STOP" in result.reason, result
    assert min(tip[2] for tip in bench.lowest) > BUTTON_Z and bench.readings[2] == 0.0


def test_no_fixed_camera_comes_to_what_is_not_in_its_picture() -> None:
    bench = beyond_the_edge("RUN_STOP", Bench)
    result = bench.do("press:RUN_STOP")
    assert result.outcome is Outcome.REJECTED and not bench.paths, result
    assert result.reason == "RUN_STOP is not in the picture"


def test_the_panel_is_not_taken_along_by_a_carriage_from_where_it_was_not_seen_yet() -> None:
    """A move down was measured at the panel as it was seen before, from elsewhere: onto a knob nothing forbade it."""
    bench = RidingBench().start()
    x, y, z = BASE_FROM_PANEL.apply(KNOB)
    assert "would touch the panel" in bench.go(x, y, z - 0.005).reason
    for confidence in (0.9, 0.0):

        def lose_panel(b: Bench, confidence: float = confidence) -> None:
            b.talking.discard("panel")
            b.tell(msg.PanelConfidence(value=confidence))

        bench.on_phase[Phase.MOVE] = lose_panel
        assert bench.go(0.02, 0.02).outcome is Outcome.REACHED
        result = bench.go(x, y, z - 0.005)
        assert result.outcome is Outcome.REJECTED and "would touch the panel" in result.reason, result
        bench.talking.add("panel")
        bench.run(0.5)
        assert bench.go(0.1, 0.1).outcome is Outcome.REACHED
