"""The driver's machine and the envelope, judged by where the board's stylus really was."""

from __future__ import annotations

import dataclasses

import pytest
from unit.gantry_driver.protocol_board import HOMED, Rig

from gantry_driver.core.configuration.envelope_config import EnvelopeConfig
from gantry_driver.core.configuration.machine_config import DriverConfig
from gantry_driver.core.envelope.plane import PanelPlane
from gantry_driver.core.grbl.trajectory_gcode import Waypoint
from gantry_driver.core.guard.commands import COMMANDS
from gantry_driver.core.states.machine_states import Note
from icu_common.core.geometry.frames import JOINTS
from icu_common.core.goals.intent import Intent, frame_of, read_frame
from icu_common.core.goals.results import GoalResult, Outcome

FACE_M = 0.035
PLANE = PanelPlane(at_m=(0.18, 0.11, FACE_M), slope=(0.0, 0.0), covariance=(1e-8, 0, 0, 0, 0, 0, 0, 0, 0))


class PanelRig(Rig):
    """A rig whose board has a panel below it; ``deepest_mm`` is the truth."""

    def __init__(self) -> None:
        super().__init__(DriverConfig(enabled_at_start=True), envelope=EnvelopeConfig())
        self.deepest_mm = 0.0
        self.homed()

    def step(self, dt: float = 0.005) -> None:
        super().step(dt)
        if hasattr(self, "deepest_mm"):
            self.deepest_mm = max(self.deepest_mm, HOMED[2] - self.board.mpos[2] if self.machine.homed else 0.0)

    def follow(self, *points: tuple[float, float, float], intent: Intent = Intent.PRESS) -> GoalResult:
        way = [Waypoint(positions_m=point) for point in points]
        self.machine.run("goal", JOINTS, way, age_s=0.0, now=self.now, intent=intent)
        self.step()
        self.until(lambda: self.machine.phase.name in ("IDLE", "STOPPED"))
        return next(r for r in reversed(self.results) if r.outcome.final)

    def see(self, plane: PanelPlane = PLANE, age_s: float = 0.0) -> str:
        return self.machine.panel(plane, age_s, self.now)

    def notes(self) -> list[str]:
        return [event.text for event in self.events if isinstance(event, Note)]


def test_full_extension_and_158_mm_sideways_move_nothing() -> None:
    rig = PanelRig()
    for known, code in ((False, "no_panel"), (True, "too_deep")):
        if known:
            assert rig.see() == ""
        answer = rig.follow((0.1, 0.1, 0.0), (0.1, 0.1, 0.059), (0.258, 0.1, 0.059))
        assert answer.outcome is Outcome.REJECTED and answer.code == code
        rig.run_for(0.5)
        assert rig.board.mpos == list(HOMED) and rig.deepest_mm == 0.0


def test_press_turn_and_drag_are_followed_and_go_as_deep_as_they_may() -> None:
    rig = PanelRig()
    rig.see()
    press = FACE_M + 0.001
    for intent in (Intent.TURN, Intent.DRAG):
        assert rig.follow((0.1, 0.1, 0.0), (0.1, 0.1, FACE_M - 0.008), intent=Intent.MOVE).outcome is Outcome.REACHED
        assert rig.follow((0.103, 0.1, FACE_M - 0.008), intent=Intent.MOVE).outcome is Outcome.REACHED
        assert rig.follow((0.103, 0.1, press)).outcome is Outcome.REACHED
        assert rig.follow((0.15, 0.12, press), intent=intent).outcome is Outcome.REACHED
        assert rig.board.mpos[:2] == pytest.approx([HOMED[0] + 150, HOMED[1] + 120], abs=0.01)
        assert rig.follow((0.15, 0.12, 0.0), intent=Intent.MOVE).outcome is Outcome.REACHED
    assert rig.deepest_mm == pytest.approx(36.0, abs=0.01)


def test_a_board_that_goes_deeper_than_the_path_is_held_and_lifted() -> None:
    rig = PanelRig()
    rig.see()
    rig.follow((0.1, 0.1, 0.0), (0.1, 0.1, FACE_M - 0.008), intent=Intent.MOVE)
    rig.machine.run("goal", JOINTS, [Waypoint(positions_m=(0.1, 0.1, FACE_M))], age_s=0.0, now=rig.now)
    rig.until(lambda: bool(rig.board.blocks))
    text, target, feed = rig.board.blocks[0]
    rig.board.blocks[0] = (text, [target[0], target[1], HOMED[2] - 59.0], feed)
    rig.until(lambda: rig.machine.phase.name == "STOPPED")
    assert rig.results[-1].code == "left_path"
    assert rig.deepest_mm < 1000.0 * FACE_M + 4.0 and rig.board.mpos[2] == HOMED[2]


def test_the_plane_is_taken_only_at_rest_with_the_stylus_up() -> None:
    rig = PanelRig()
    rig.see()
    rig.machine.run("goal", JOINTS, [Waypoint(positions_m=(0.3, 0.1, 0.0))], age_s=0.0, now=rig.now)
    assert rig.see() == "the driver is moving"
    rig.until(lambda: rig.state == "idle")
    rig.follow((0.3, 0.1, FACE_M))
    assert rig.board.mpos[2] == pytest.approx(HOMED[2] - 35.0, abs=0.01)
    deeper = dataclasses.replace(PLANE, at_m=(0.18, 0.11, 0.055))
    assert rig.see(deeper) == "the driver is idle; the stylus is down"
    assert rig.follow((0.3, 0.1, 0.05)).code == "too_deep"
    assert rig.follow((0.3, 0.1, 0.0)).outcome is Outcome.REACHED
    assert rig.see(deeper) == ""
    assert rig.follow((0.3, 0.1, 0.05)).outcome is Outcome.REACHED


def test_a_plane_that_jumps_is_reported_and_one_that_scatters_is_not() -> None:
    rig = PanelRig()
    rig.see()
    rig.see(dataclasses.replace(PLANE, at_m=(0.18, 0.11, FACE_M + 0.001)))
    rig.step()
    assert rig.notes() == []
    rig.see(dataclasses.replace(PLANE, at_m=(0.18, 0.11, FACE_M + 0.0051)))
    rig.step()
    assert rig.notes() == ["the panel's plane has moved by up to 4.1 mm within the travel"]


def test_an_old_plane_and_an_unsure_one_count_as_unknown() -> None:
    rig = PanelRig()
    rig.see(age_s=50.0)
    assert rig.follow((0.1, 0.1, 0.0), (0.1, 0.1, 0.02)).outcome is Outcome.REACHED
    assert rig.follow((0.1, 0.1, 0.0)).outcome is Outcome.REACHED
    rig.run_for(10.0)
    answer = rig.follow((0.1, 0.1, 0.02))
    assert answer.code == "old_panel" and answer.details[1] == ("limit_s", "60.00000")
    assert answer.reason.startswith("the panel's plane is 6") and answer.reason.endswith(" s old (limit 60.0 s)")
    rig.see()
    rig.see(dataclasses.replace(PLANE, covariance=(0.0006**2, 0, 0, 0, 0, 0, 0, 0, 0)))
    rig.step()
    assert rig.follow((0.1, 0.1, 0.02)).code == "no_panel"
    assert rig.notes() == ["the panel's plane counts as unknown: its standard deviation is 0.60 mm (limit 0.5 mm)"]


def test_the_guard_takes_plane_and_intent_as_json_values() -> None:
    rig = PanelRig()
    assert COMMANDS["panel"](rig.machine, rig.now, {"plane": PLANE.values(), "age_s": 0.1}) == ""
    rig.follow((0.1, 0.1, 0.0), (0.1, 0.1, FACE_M))
    aside = {"goal_id": "g", "names": list(JOINTS), "points": [[(0.15, 0.1, FACE_M), (), 0.0]], "age_s": 0.0}
    for intent, expected in (({}, "rejected"), ({"intent": "press"}, "rejected"), ({"intent": "drag"}, "reached")):
        COMMANDS["run"](rig.machine, rig.now, {**aside, **intent})
        rig.step()
        rig.until(lambda: rig.state == "idle")
        assert rig.results[-1].outcome.value == expected
    assert rig.board.mpos == pytest.approx([HOMED[0] + 150, HOMED[1] + 100, HOMED[2] - 35], abs=0.01)


@pytest.mark.parametrize("intent", Intent)
def test_an_intent_survives_the_frame_of_a_trajectory(intent: Intent) -> None:
    assert read_frame(frame_of(intent), 17) == ("17", intent)
    assert read_frame(f"{intent}/own name", 17) == ("own name", intent)


@pytest.mark.parametrize("frame", ["", "first", "press", "drags/", "a/b", "DRAG/"])
def test_a_frame_that_names_no_intent_is_a_press(frame: str) -> None:
    assert read_frame(frame, 17) == (frame or "17", Intent.PRESS)
