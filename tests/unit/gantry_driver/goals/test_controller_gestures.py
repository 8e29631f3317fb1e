"""Gestures beyond the plain press: what they do at the panel, and how what is seen of it decides about them."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from unit.gantry_driver.controller_bench import BASE_FROM_PANEL, BUTTON_Z, MS, PANEL, Bench, config, details

from gantry_driver.core.job import controller_messages as msg
from gantry_driver.core.job.goal_job import Phase
from icu_common.core.configuration.config import ConfigError
from icu_common.core.goals.results import Outcome
from icu_common.core.panel.panel_layout import Dimple


def seeing(**changes: object) -> Bench:
    bench = Bench(config(**changes))
    bench.talking.add("state")
    return bench.start()


def contacts(bench: Bench, height_m: float) -> list[tuple[int, int]]:
    """Return first and last index of each time that the tip was below a height over base_link."""
    below = np.array([tip[2] for tip in bench.lowest]) < height_m
    edges = np.flatnonzero(np.diff(np.concatenate([[0], below.astype(int), [0]])))
    return [(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2])]


def test_double_press_touches_twice_within_half_a_second() -> None:
    bench = Bench().start()
    result = bench.do("double:RUN_STOP")
    assert result.outcome is Outcome.REACHED and result.error_m < 2e-5  # the surface that stops the ball leans
    first, second = contacts(bench, BUTTON_Z)
    down = bench.paths[1]
    assert len(down) == 4 and down[2][2] == pytest.approx(down[3][2] - 0.004)
    assert first[1] < second[0]
    plunge = [a.path for a in bench.actions if hasattr(a, "path")][1]
    assert plunge.times_s[3] - plunge.times_s[1] < 0.5, "from contact to contact"


def test_long_press_stays_for_its_time() -> None:
    bench = Bench().start()
    times = {}
    bench.on_phase[Phase.CONTACT] = lambda b: times.setdefault("down", b.now_ns)
    bench.on_phase[Phase.LIFT] = lambda b: times.setdefault("up", b.now_ns)
    assert bench.do("long:RUN_STOP").outcome is Outcome.REACHED
    assert 1.5 <= (times["up"] - times["down"]) / 1e9 <= 1.6


def test_drag_draws_a_straight_line_on_the_screen() -> None:
    bench = Bench().start()
    result = bench.do("drag:0.05,0.06@panel_link:0.12,0.1@panel_link")
    assert result.outcome is Outcome.REACHED and details(result)["control"] == "SCREEN"
    low = np.array(bench.lowest)
    in_panel = BASE_FROM_PANEL.inverse().apply(low[low[:, 2] < BASE_FROM_PANEL.apply([0.05, 0.06, 0.0])[2] + 0.0026])
    np.testing.assert_allclose(in_panel[0][:2], [0.05, 0.06], atol=1e-4)
    np.testing.assert_allclose(in_panel[-1][:2], [0.12, 0.10], atol=1e-4)
    along = (in_panel[:, :2] - [0.05, 0.06]) @ np.array([0.04, -0.07]) / math.hypot(0.04, 0.07)
    assert np.abs(along).max() < 1e-4


@pytest.mark.parametrize(
    ("command", "words"),
    [
        ("drag:RUN_STOP:0.12,0.1@panel_link", "a drag begins on RUN_STOP, a button"),
        ("drag:SCREEN:0.208,0.127@panel_link", "begins on SCREEN and ends on RUN_STOP"),
        ("drag:0.2,0.01@panel_link:0.12,0.1@panel_link", "the bare face"),
        ("click:RUN_STOP:2", "RUN_STOP has no clicks"),
        ("click:CH1_SCALE:30", "30 clicks of 18 degrees are more than a whole turn"),
        ("click:SINGLE:1", "nothing is seen of SINGLE"),
        ("set:CH1_SCALE:DOWN", "CH1_SCALE has no mark 'DOWN'; it has UP, LEFT"),
        ("set:CH9:UP", "unknown control 'CH9'"),
        ("set:0.2,0.1@panel_link:30", "set needs a knob's name"),
    ],
)
def test_refusals(command: str, words: str) -> None:
    bench = seeing()
    result = bench.do(command)
    assert result.outcome is Outcome.REJECTED and words in result.reason, result.reason
    assert bench.paths == []


@pytest.mark.parametrize(("start", "goal"), [(20.0, 90.0), (-170.0, 160.0), (80.0, -60.0), (0.0, 5.0)])
@pytest.mark.parametrize("slips", [0.0, 0.15])
def test_a_knob_is_set_by_turning_looking_and_correcting(start: float, goal: float, slips: float) -> None:
    bench = seeing()
    bench.knob_deg, bench.knob_slips = start, slips
    bench.backlash = np.array([0.0002, 0.00015])
    bench.run(0.5)
    result = bench.do(f"set:CH1_SCALE:{goal}")
    assert result.outcome is Outcome.REACHED, result
    assert abs((bench.knob_deg - goal + 180) % 360 - 180) <= 2.0
    assert float(details(result)["knob_deg"]) == pytest.approx(bench.knob_deg, abs=0.01)
    assert int(details(result)["turns"]) >= 1


def test_a_knob_is_set_to_a_mark_and_left_alone_when_it_stands_there() -> None:
    bench = seeing()
    assert bench.do("set:CH1_SCALE:LEFT").outcome is Outcome.REACHED
    assert bench.knob_deg == pytest.approx(90, abs=2)
    sent = len(bench.paths)
    again = bench.do("set:CH1_SCALE:LEFT")
    assert again.outcome is Outcome.REACHED and details(again)["turns"] == "0" and len(bench.paths) == sent


def test_a_knob_under_the_stylus_is_looked_at_from_aside_first() -> None:
    bench = seeing()
    assert bench.do("press:CH1_SCALE").outcome is Outcome.REACHED
    bench.run(0.5)
    assert bench.do("set:CH1_SCALE:-40").outcome is Outcome.REACHED
    assert bench.knob_deg == pytest.approx(-40, abs=2)


@pytest.mark.parametrize("slips", [0.4, 1.0])
@pytest.mark.parametrize("command", ["click:CH1_SCALE:2", "turn:CH1_SCALE:-36"])
def test_a_knob_under_the_stylus_is_turned_by_what_is_seen_from_aside(command: str, slips: float) -> None:
    """It was turned blind, and one that had slipped answered ``reached``."""
    bench = seeing()
    assert bench.do("press:CH1_SCALE").outcome is Outcome.REACHED
    bench.run(0.5)
    bench.knob_slips, sent = slips, len(bench.paths)
    result = bench.do(command)
    assert bench.paths[sent][:, 2].max() == 0.0, "first it goes aside"
    if slips < 1:
        assert result.outcome is Outcome.REACHED and bench.knob_deg == pytest.approx(20 - 36, abs=2), result
        assert float(details(result)["knob_deg"]) == pytest.approx(bench.knob_deg, abs=0.01)
    else:
        assert result.outcome is Outcome.ABORTED
        assert "CH1_SCALE stands 36.0 degrees off after 5 turns, 2 are allowed" in result.reason


def test_a_knob_under_the_stylus_that_shows_no_marker_from_aside_is_turned_once() -> None:
    bench = seeing()
    bench.knob_deg = math.nan
    assert bench.do("press:CH1_SCALE").outcome is Outcome.REACHED
    bench.run(0.5)
    turned: list[int] = []
    bench.on_phase[Phase.TURN] = lambda b: turned.append(b.now_ns)
    result = bench.do("turn:CH1_SCALE:30")
    assert result.outcome is Outcome.REACHED and details(result)["turns"] == "1" and len(turned) == 1, result
    assert details(result)["effect"] == "not looked for" and details(result)["knob_deg"] == "nan"
    assert details(result)["effect_missing"] == "not_looked_for"


def test_a_dimple_is_not_touched_before_the_marker_has_been_seen() -> None:
    bench = seeing()
    dimple = Dimple(place_mm=(0.0, -5.0), diameter_mm=4.6, depth_mm=1.0)
    knobs = [dataclasses.replace(c, dimple=dimple) if c.name == "CH1_SCALE" else c for c in PANEL.controls]
    bench.tell(msg.PanelControls(panel=dataclasses.replace(PANEL, controls=tuple(knobs))))
    assert bench.do("press:CH1_SCALE").outcome is Outcome.REACHED  # the stylus hides the knob now
    bench.run(0.5)
    sent = len(bench.paths)
    result = bench.do("turn:CH1_SCALE:30")
    assert result.outcome is Outcome.REACHED, result.reason
    assert bench.paths[sent][:, 2].max() == 0.0, "first it goes aside"
    assert bench.knob_deg == pytest.approx(50, abs=2)
    bench.knob_deg = math.nan
    bench.run(0.5)
    sent = len(bench.paths)
    unseen = bench.do("turn:CH1_SCALE:30")
    assert unseen.outcome is Outcome.ABORTED and "the marker of CH1_SCALE was not seen" in unseen.reason
    assert all(points[:, 2].max() == 0.0 for points in bench.paths[sent:])


def test_a_knob_that_does_not_follow_is_given_up_with_what_is_seen() -> None:
    bench = seeing()
    bench.knob_slips = 1.0
    result = bench.do("set:CH1_SCALE:80")
    assert result.outcome is Outcome.ABORTED
    assert "CH1_SCALE stands 60.0 degrees off after 5 turns, 2 are allowed" in result.reason
    assert bench.readings[2] == 0.0


def test_clicks_are_clockwise_detents() -> None:
    bench = seeing()
    result = bench.do("click:CH1_SCALE:2")
    assert result.outcome is Outcome.REACHED, result
    assert bench.knob_deg == pytest.approx(20 - 36, abs=2)


def test_a_turn_is_corrected_by_what_is_seen() -> None:
    bench = seeing()
    bench.knob_slips = 0.2
    result = bench.do("turn:CH1_SCALE:60")
    assert result.outcome is Outcome.REACHED and int(details(result)["turns"]) >= 2
    assert bench.knob_deg == pytest.approx(80, abs=2)


@pytest.mark.parametrize(
    ("command", "way"), [("turn:CH1_SCALE:216", 216), ("click:CH1_SCALE:-12", 216), ("click:CH1_SCALE:20", -360)]
)
def test_a_long_turn_that_slips_is_not_made_backwards(command: str, way: float) -> None:
    """216 degrees with nothing turned look like 144 too many, and a whole turn with nothing turned like its end."""
    bench, ways = seeing(), []

    def turns(b: Bench) -> None:
        job = b.controller._job
        assert job is not None and job.knob is not None
        ways.append(job.knob.way_deg)
        b.knob_slips = float(len(ways) == 1)
        b.on_phase[Phase.TURN] = turns

    bench.on_phase[Phase.TURN] = turns
    result = bench.do(command)
    assert result.outcome is Outcome.REACHED, result
    assert all(part * way > 0 and abs(part) < 180 for part in ways), ways
    assert sum(ways[1:]) == pytest.approx(way, abs=4), ways
    assert math.remainder(bench.knob_deg - 20 - way, 360) == pytest.approx(0, abs=2)


def test_a_marker_that_stays_unseen_is_a_failure() -> None:
    bench = seeing()
    bench.on_phase[Phase.TURN] = lambda b: b.hidden.update(CH1_SCALE="stylus")
    result = bench.do("turn:CH1_SCALE:30")
    assert result.outcome is Outcome.ABORTED and "the marker of CH1_SCALE was not seen within 3 s" in result.reason


def test_the_effect_is_reported_and_can_be_required() -> None:
    bench = seeing()
    bench.on_phase[Phase.CONTACT] = lambda b: setattr(b, "lamp", "red")
    assert details(bench.do("press:RUN_STOP"))["effect"] == "lamp green -> red"
    result = bench.do("press:RUN_STOP")
    assert details(result)["effect"] == "none seen" and details(result)["effect_missing"] == "none"
    bench.on_phase[Phase.LIFT] = lambda b: setattr(b, "screen_changed_ns", b.now_ns)
    assert details(bench.do("press:SINGLE"))["effect"] == "screen changed"
    strict = seeing(require_effect=True)
    result = strict.do("press:RUN_STOP")
    assert result.outcome is Outcome.ABORTED and "no effect was seen within 1 s" in result.reason


def test_a_lamp_that_the_raised_stylus_still_hides_is_read_from_aside() -> None:
    for lamp, effect in (("red", "lamp green -> red"), ("green", "none seen")):
        bench = seeing()
        bench.on_phase[Phase.TOUCH] = lambda b: b.hidden.update(RUN_STOP="stylus")
        bench.on_phase[Phase.CONTACT] = lambda b, lamp=lamp: setattr(b, "lamp", lamp)
        bench.on_phase[Phase.ASIDE] = lambda b: b.hidden.clear()
        result = bench.do("press:RUN_STOP")
        assert result.outcome is Outcome.REACHED and details(result)["effect"] == effect
        assert Phase.ASIDE not in bench.on_phase and bench.readings[2] == 0.0
        assert bench.paths[-1][:, 2].max() == 0.0, "it goes aside with the stylus up"


@pytest.mark.parametrize("required", [False, True])
def test_a_lamp_that_the_stylus_hides_from_the_start_is_read_from_aside_before_the_press(required: bool) -> None:
    """Its change could not be detected, and a user who sees no effect presses again."""
    bench = seeing(require_effect=required)
    bench.hidden["RUN_STOP"] = "stylus"
    bench.run(0.4)

    def press(b: Bench) -> None:
        b.lamp = "red"
        b.hidden["RUN_STOP"] = "stylus"
        b.on_phase[Phase.ASIDE] = lambda b: b.hidden.clear()

    bench.on_phase[Phase.ASIDE] = lambda b: b.hidden.clear()
    bench.on_phase[Phase.CONTACT] = press
    sent = len(bench.paths)
    result = bench.do("press:RUN_STOP")
    assert result.outcome is Outcome.REACHED and details(result)["effect"] == "lamp green -> red", result
    assert bench.paths[sent][:, 2].max() == 0.0 == bench.readings[2], "it goes aside with the stylus up"


def test_what_has_no_lamp_is_pressed_from_where_the_stylus_stands() -> None:
    bench = seeing()
    for _ in range(2):  # the first leaves the stylus over the knob
        bench.on_phase[Phase.ASIDE] = lambda b: pytest.fail("it needs no look from aside")
        assert details(bench.do("press:CH1_SCALE"))["effect"] == "none seen"
        bench.run(0.5)


def test_a_lamp_that_is_not_seen_from_aside_either_is_pressed_all_the_same() -> None:
    bench = seeing()
    bench.hidden["RUN_STOP"] = "stylus"
    bench.run(0.4)
    bench.on_phase[Phase.CONTACT] = lambda b: setattr(b, "screen_changed_ns", b.now_ns)
    result = bench.do("press:RUN_STOP")
    assert result.outcome is Outcome.REACHED and details(result)["effect"] == "screen changed", result


@pytest.mark.parametrize(("lamp", "effect"), [("red", "lamp green -> red"), ("green", "none seen")])
def test_pictures_that_arrive_late_tell_the_effect_by_when_they_were_taken(lamp: str, effect: str) -> None:
    bench = seeing()
    bench.state_late_s = 1.4  # beyond effect_wait_s, as on a computer with ten times as much to do as it has cores
    bench.run(2.0)

    def press(b: Bench) -> None:
        b.lamp, b.hidden["RUN_STOP"] = lamp, "stylus"
        if lamp == "red":
            b.screen_changed_ns = b.now_ns

    bench.on_phase[Phase.CONTACT] = press
    bench.on_phase[Phase.READ] = lambda b: b.hidden.clear()
    result = bench.do("press:RUN_STOP")
    assert result.outcome is Outcome.REACHED and details(result)["effect"] == effect


@pytest.mark.parametrize("required", [False, True])
def test_without_a_picture_since_the_touch_nobody_says_that_there_was_no_effect(required: bool) -> None:
    bench = seeing(require_effect=required)
    bench.on_phase[Phase.CONTACT] = lambda b: b.talking.discard("state")
    bench.on_phase[Phase.READ] = lambda b: began.append(b.now_ns)
    began: list[int] = []
    result = bench.do("press:RUN_STOP")
    assert (bench.now_ns - began[0]) / 1e9 == pytest.approx(4.0, abs=0.1), "effect_wait_s and read_timeout_s"
    told = "not seen: nothing was read of the panel for 4.8 s since the touch"
    whole = f"touched, but its effect was {told}; the stylus is up"
    assert result.reason == whole if required else details(result)["effect"] == told, result
    assert result.outcome is (Outcome.ABORTED if required else Outcome.REACHED)


def test_what_must_have_an_effect_needs_somebody_who_sees_it() -> None:
    """Before it is touched: afterwards it could not be decided."""
    bench = Bench(config(require_effect=True)).start()
    refused = bench.do("press:RUN_STOP")
    assert refused.outcome is Outcome.REJECTED and "nothing is seen of the panel's state" in refused.reason
    assert not bench.paths
    with pytest.raises(ConfigError, match="effect_wait_s = 0 is none"):
        config(require_effect=True, effect_wait_s=0.0)


def test_an_effect_counts_that_is_seen_before_the_driver_reports_the_contact() -> None:
    bench = seeing()
    before = bench.now_ns
    bench.on_phase[Phase.TOUCH] = lambda b: setattr(b, "screen_changed_ns", b.now_ns + 200 * MS)
    bench.on_phase[Phase.CONTACT] = lambda b: down.append(b.now_ns)
    down: list[int] = []
    told = details(bench.do("press:SINGLE"))
    assert told["effect"] == "screen changed"
    assert before < int(told["touched_ns"]) < bench.screen_changed_ns < down[0], "the change came on the way down"
    bench.on_phase.clear()
    bench.screen_changed_ns = bench.now_ns
    assert details(bench.do("press:SINGLE"))["effect"] == "none seen", "it changed before this press"


@pytest.mark.parametrize(
    ("lamp", "hidden_s", "effect"),
    [
        ("red", 0.3, "lamp green -> red"),
        ("green", 0.3, "screen changed"),
    ],
)
def test_a_lamp_that_the_stylus_hides_at_first_tells_more_than_the_screen(
    lamp: str, hidden_s: float, effect: str
) -> None:
    bench = seeing()

    def press(b: Bench) -> None:
        b.screen_changed_ns, b.lamp = b.now_ns, lamp
        b.hidden["RUN_STOP"] = "stylus"

    bench.on_phase[Phase.CONTACT] = press
    bench.on_phase[Phase.READ] = lambda b: read.append(b.now_ns)
    read: list[int] = []
    bench.tell(msg.Command(text="press:RUN_STOP"))
    for _ in range(1000):
        bench.run(0.02)
        if read and bench.now_ns - read[0] >= hidden_s * 1e9:
            bench.hidden.clear()
        if bench.finals:
            break
    assert details(bench.finals[-1])["effect"] == effect
    assert (bench.now_ns - read[0]) / 1e9 == pytest.approx(min(hidden_s, 1.0), abs=0.2), "looked for 1 s at most"


def test_a_lamp_is_read_once_the_stylus_leaves_it() -> None:
    """Before, its ball may look like a part of the lamp: a button that had become green was reported as off."""
    bench = seeing()
    bench.on_phase[Phase.TOUCH] = lambda b: setattr(b, "lamp", "off")
    bench.on_phase[Phase.LIFT] = lambda b: b.talking.discard("state")
    bench.on_phase[Phase.READ] = lambda b: (setattr(b, "lamp", "red"), b.talking.add("state"))
    assert details(bench.do("press:RUN_STOP"))["effect"] == "lamp green -> red"


def test_a_hidden_control_is_waited_for_and_then_refused() -> None:
    bench = seeing()
    bench.hidden["RUN_STOP"] = "something"
    bench.run(0.5)
    bench.on_phase[Phase.WAIT] = lambda b: b.hidden.clear()
    assert bench.do("press:RUN_STOP").outcome is Outcome.REACHED
    bench.hidden["RUN_STOP"] = "something"
    bench.run(0.5)
    sent = len(bench.paths)
    result = bench.do("press:RUN_STOP")
    assert result.outcome is Outcome.ABORTED and "still hides RUN_STOP" in result.reason, result
    assert "nothing was moved" in result.reason and len(bench.paths) == sent


def test_what_a_hand_did_while_it_was_waited_for_is_no_effect_and_hides_none() -> None:
    bench = seeing()
    bench.hidden["RUN_STOP"] = "something"
    bench.run(0.5)
    bench.on_phase[Phase.WAIT] = lambda b: (b.hidden.clear(), setattr(b, "lamp", "red"))
    bench.on_phase[Phase.CONTACT] = lambda b: setattr(b, "lamp", "green")
    assert details(bench.do("press:RUN_STOP"))["effect"] == "lamp red -> green"


@pytest.mark.parametrize(("lamp", "effect"), [("red", "none seen"), ("green", "lamp red -> green")])
def test_a_lamp_that_changes_on_the_way_to_it_is_not_the_touchs_doing(lamp: str, effect: str) -> None:
    bench = seeing()

    def press(b: Bench) -> None:
        b.lamp = lamp

    bench.on_phase[Phase.APPROACH] = lambda b: setattr(b, "lamp", "red")
    bench.on_phase[Phase.CONTACT] = press
    assert details(bench.do("press:RUN_STOP"))["effect"] == effect


def test_on_a_busy_computer_the_effect_is_told_by_what_is_seen_on_the_way() -> None:
    bench = seeing()
    bench.talking.discard("state")
    bench.run(1.7)
    bench.on_phase[Phase.APPROACH] = lambda b: b.talking.add("state")
    bench.on_phase[Phase.CONTACT] = lambda b: setattr(b, "lamp", "red")
    assert details(bench.do("press:RUN_STOP"))["effect"] == "lamp green -> red"


@pytest.mark.parametrize("command", ["turn:CH1_SCALE:-36", "click:CH1_SCALE:2"])
def test_a_knob_that_was_hidden_is_turned_by_what_is_seen_once_it_is_free(command: str) -> None:
    bench = seeing()
    bench.knob_slips, bench.hidden["CH1_SCALE"] = 0.3, "something"
    bench.run(0.5)
    bench.on_phase[Phase.WAIT] = lambda b: (b.hidden.clear(), setattr(b, "knob_deg", 80.0))
    result = bench.do(command)
    assert result.outcome is Outcome.REACHED and bench.knob_deg == pytest.approx(44.0, abs=2.0), result
    assert float(details(result)["knob_deg"]) == pytest.approx(bench.knob_deg, abs=0.01)


@pytest.mark.parametrize("phase", [Phase.APPROACH, Phase.LOOK])
def test_a_hand_that_comes_between_ends_the_gesture_above_the_panel(phase: Phase) -> None:
    bench = seeing(look_timeout_s=20.0)
    bench.on_phase[phase] = lambda b: (b.hidden.update(RUN_STOP="something"), b.talking.discard("tip"))
    result = bench.do("press:RUN_STOP")
    assert result.outcome is Outcome.ABORTED and "something (a hand?) has hidden RUN_STOP" in result.reason, result
    assert bench.readings[2] == 0.0 and contacts(bench, BUTTON_Z) == []


def test_a_panel_out_of_sight_ends_the_gesture_above_it() -> None:
    bench = seeing(look_timeout_s=20.0)
    bench.on_phase[Phase.LOOK] = lambda b: (setattr(b, "confidence", 0.0), b.talking.discard("tip"))
    result = bench.do("press:RUN_STOP")
    assert result.outcome is Outcome.ABORTED and "the panel is not recognised for 2" in result.reason, result
    assert bench.readings[2] == 0.0


@pytest.mark.parametrize("command", ["click:CH1_SCALE:1", "set:CH1_SCALE:UP", "turn:CH1_SCALE:36"])
def test_old_states_are_not_believed(command: str) -> None:
    bench = seeing()
    bench.talking.discard("state")
    bench.now_ns += 1500 * MS
    bench.run(0.3)
    result = bench.do(command)
    assert result.outcome is Outcome.REJECTED and "nothing is seen of CH1_SCALE" in result.reason
    assert "nothing is seen of CH1_SCALE for 1.9 s, at most 1.5 s are allowed" in result.reason, "nor turned blindly"
    assert bench.paths == []


def test_a_knob_whose_marker_cannot_be_read_is_turned_unseen_also_when_the_state_is_old() -> None:
    bench = seeing()
    bench.knob_deg = math.nan
    bench.run(0.3)
    bench.talking.discard("state")
    bench.run(1.8)
    result = bench.do("turn:CH1_SCALE:36")
    assert result.outcome is Outcome.REACHED and details(result)["turns"] == "1"
