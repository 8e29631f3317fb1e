"""Cameras on the carriage: they see the part that they have reached, and find the panel again from every position."""

from __future__ import annotations

import dataclasses

import pytest
from unit.gantry_driver.controller_bench import BASE_FROM_PANEL, BUTTON, BUTTON_Z, KNOB, Bench, RidingBench, details

from gantry_driver.core.job import controller_messages as msg
from gantry_driver.core.job.goal_job import GoalPhase
from icu_common.core.geometry.geometry import Transform
from icu_common.core.goals.results import Outcome


@pytest.mark.parametrize(("lamp", "effect"), [("red", "lamp green -> red"), ("green", "none seen")])
def test_cameras_that_went_aside_themselves_have_time_to_find_the_panel_from_there(lamp: str, effect: str) -> None:
    """Cameras on the carriage see another image then: the lamp was reported without effect before it was seen."""
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
        b.on_phase[GoalPhase.ASIDE] = lambda b: b.on_phase.update({GoalPhase.READ: look_from_aside})

    bench.on_phase[GoalPhase.CONTACT] = press
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

    bench.on_phase[GoalPhase.READ] = lambda b: b.hidden.clear()
    bench.on_phase[GoalPhase.CONTACT] = press
    result = bench.do(f"{command}:RUN_STOP{':0.5' if command == 'hold' else ''}")
    assert result.outcome is Outcome.REACHED and details(result)["effect"] == "lamp green -> red", result


@pytest.mark.parametrize("command", ["turn:CH1_SCALE:-36", "click:CH1_SCALE:2", "set:CH1_SCALE:-16"])
def test_a_knob_that_is_not_in_the_picture_is_turned_by_what_is_seen_from_beside_it(command: str) -> None:
    bench = beyond_the_edge("CH1_SCALE")
    bench.knob_slips = 0.3
    bench.on_phase[GoalPhase.READ] = lambda b: b.hidden.clear()
    result = bench.do(command)
    assert result.outcome is Outcome.REACHED and bench.knob_deg == pytest.approx(-16.0, abs=2.0), result
    assert float(details(result)["knob_deg"]) == pytest.approx(bench.knob_deg, abs=0.01)


def test_a_hand_over_what_came_into_the_picture_ends_the_gesture_above_it() -> None:
    bench = beyond_the_edge("RUN_STOP")
    bench.controller.config = dataclasses.replace(bench.controller.config, look_timeout_s=20.0)
    bench.on_phase[GoalPhase.LOOK] = lambda b: (b.hidden.update(RUN_STOP="something"), b.talking.discard("tip"))
    result = bench.do("press:RUN_STOP")
    assert result.outcome is Outcome.ABORTED and "hidden RUN_STOP" in result.reason, result
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

        bench.on_phase[GoalPhase.MOVE] = lose_panel
        assert bench.go(0.02, 0.02).outcome is Outcome.REACHED
        result = bench.go(x, y, z - 0.005)
        assert result.outcome is Outcome.REJECTED and "would touch the panel" in result.reason, result
        bench.talking.add("panel")
        bench.run(0.5)
        assert bench.go(0.1, 0.1).outcome is Outcome.REACHED


DRAG = "drag:0.05,0.06@panel_link:0.12,0.06@panel_link"


def unseen_after_a_drag() -> RidingBench:
    """A bench whose cameras have been carried along, and have not seen the panel from there."""
    bench = RidingBench(seed=3)
    bench.talking.add("state")
    bench.start()
    bench.on_phase[GoalPhase.LIFT] = lambda b: b.talking.discard("panel")
    assert bench.do(DRAG).outcome is Outcome.REACHED
    return bench


def waits(bench: Bench, command: str = "press:RUN_STOP id=late") -> None:
    """Give a command and see it accepted, and nothing sent to the driver for it."""
    before = len(bench.paths)
    bench.tell(msg.Command(text=command))
    bench.run(1.0)
    result = bench.results[-1]
    assert (result.outcome, result.reason) == (Outcome.ACCEPTED, "waiting for the cameras to see the panel"), result
    assert bench.controller.phase is GoalPhase.SIGHT and bench.controller.state == "looking"
    assert len(bench.paths) == before


@pytest.mark.parametrize("command", ["press:RUN_STOP id=late", "set:CH1_SCALE:UP id=late", f"{DRAG} id=late"])
def test_what_comes_after_a_drag_waits_until_the_panel_is_seen_from_there(command: str) -> None:
    bench = unseen_after_a_drag()
    waits(bench, command)
    if command.startswith("press"):
        shift = (0.004, -0.003, 0.0)
        bench.base_from_panel = Transform(BASE_FROM_PANEL.rotation, BASE_FROM_PANEL.translation + shift)
    count = len(bench.finals)
    bench.talking.add("panel")
    result = bench.run_goal()
    answers = [(r.goal_id, r.outcome) for r in bench.results if r.goal_id == "late"]
    assert answers == [("late", Outcome.ACCEPTED), ("late", Outcome.REACHED)] and len(bench.finals) == count + 1, result
    assert result.duration_s > 1.0, "the wait counts"
    if command.startswith("press"):
        target = [float(v) for v in details(result)["target_base_m"].split()]
        assert target[:2] == pytest.approx(bench.base_from_panel.apply(BUTTON)[:2], abs=1e-4), "as it is seen now"


def test_a_stop_ends_the_wait_for_the_panel_at_once() -> None:
    bench = unseen_after_a_drag()
    waits(bench)
    before = len(bench.paths)
    bench.driver = "stopped: on request"
    bench.tell(msg.DriverState(text=bench.driver))
    result = bench.finals[-1]
    assert result.goal_id == "late" and result.outcome is Outcome.ABORTED
    assert "stopped: on request" in result.reason and "no further motion" in result.reason
    bench.talking.add("panel")
    bench.run(1.0)
    bench.driver = "idle"
    bench.tell(msg.DriverState(text=bench.driver))
    bench.run(1.0)
    assert len(bench.paths) == before and bench.controller.phase is GoalPhase.IDLE


def test_an_operator_who_goes_ends_the_wait_for_the_panel() -> None:
    bench = unseen_after_a_drag()
    waits(bench)
    before = len(bench.paths)
    bench.talking.discard("heartbeat")
    bench.run(1.0)
    result = bench.finals[-1]
    assert result.goal_id == "late" and "lost the operator" in result.reason and len(bench.paths) == before


def test_while_one_waits_for_the_panel_another_is_refused_as_busy() -> None:
    bench = unseen_after_a_drag()
    waits(bench)
    for answer in (bench.do("press:SINGLE id=second"), bench.go(0.1, 0.1)):
        assert answer.outcome is Outcome.REJECTED and answer.reason == "busy with 'press:RUN_STOP id=late'"
    bench.talking.add("panel")
    assert bench.run_goal().goal_id == "late"


@pytest.mark.parametrize(
    ("command", "reason"),
    [("press:NOBODY", "NOBODY"), ("press:0.9,0.06@panel_link", "0.9"), ("press:CRAMPED", "CRAMPING")],
)
def test_what_cannot_be_touched_is_told_once_the_panel_is_seen(command: str, reason: str) -> None:
    bench = unseen_after_a_drag()
    waits(bench, command)
    before = len(bench.paths)
    bench.talking.add("panel")
    result = bench.run_goal()
    assert result.outcome is Outcome.ABORTED and result.reason.endswith("; nothing moved"), result
    assert reason in result.reason and len(bench.paths) == before


@pytest.mark.parametrize(
    "command",
    [
        "press:640,360@camera_left_optical_frame",
        "drag:0.05,0.06@panel_link:640,360@camera_left_optical_frame",
        "drag:640,360@camera_left_optical_frame:0.05,0.06@panel_link",
    ],
)
def test_a_pixel_of_a_picture_from_elsewhere_is_refused_at_once(command: str) -> None:
    bench = unseen_after_a_drag()
    result = bench.do(command)
    assert result.outcome is Outcome.REJECTED and "have not seen the panel from their new position" in result.reason, (
        result
    )


def test_what_the_controls_show_is_awaited_with_the_panel() -> None:
    """A sighting from before the cameras were carried on is hidden, or not, at another position."""
    bench = RidingBench(seed=3)
    bench.talking.add("state")
    bench.hidden["RUN_STOP"] = "stylus"
    bench.start()
    bench.on_phase[GoalPhase.MOVE] = lambda b: b.talking.discard("state")
    assert bench.go(0.02, 0.02).outcome is Outcome.REACHED
    before = len(bench.paths)
    bench.tell(msg.Command(text="press:RUN_STOP"))
    bench.run(2.0)
    assert bench.controller.phase is GoalPhase.SIGHT and len(bench.paths) == before
    bench.hidden.clear()
    bench.talking.add("state")
    went_aside: list[Bench] = []
    bench.on_phase[GoalPhase.ASIDE] = went_aside.append
    assert bench.run_goal().outcome is Outcome.REACHED
    assert not went_aside, "it is not hidden from here"


def test_no_fixed_camera_waits_for_a_panel_that_it_does_not_see() -> None:
    bench = Bench(seed=3).start()
    assert bench.go(0.2, 0.1).outcome is Outcome.REACHED
    bench.talking.discard("panel")
    bench.run(8.5)
    assert bench.do("press:RUN_STOP").outcome is Outcome.REJECTED
