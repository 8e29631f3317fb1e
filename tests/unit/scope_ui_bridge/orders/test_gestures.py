"""Every gesture of the controller from the page: what is offered, what goes out, and what is refused with its bound."""

from __future__ import annotations

import math
from typing import Any

import pytest
from unit.scope_ui_bridge.desk_rig import FACES, Rig, answer, of_type, pose, refusal, selected

from icu_common.core.geometry.frames import PANEL
from icu_common.core.panel.gesture import Gesture, Point, parse_gesture
from icu_common.core.panel.panel_state import ControlSeen, PanelSeen
from scope_ui_bridge.core.effects import Broadcast, SendCommand
from scope_ui_bridge.core.video import Face

SCREEN = Face(
    name="SCREEN", kind="touch_area", label="Screen", circle=False, centre=(0.1, 0.0825, 0.004), size=(0.17, 0.1)
)
KNOB = ControlSeen(
    name="CH1_SCALE", kind="knob", angle_deg=36.4, detent_deg=18.0, marks=(("AUTO", 60.0), ("V1", -90.0))
)


def seen(*controls: ControlSeen, stamp_ns: int = 1) -> PanelSeen:
    return PanelSeen(stamp_ns=stamp_ns, controls=controls)


def desk(*controls: ControlSeen) -> Rig:
    rig = Rig()
    rig.desk.scene.faces = (*FACES, SCREEN)
    rig.desk.panel.show(seen(*controls), rig.now)
    return rig


def pixel(x: float, y: float, z: float = 0.004) -> tuple[float, float]:
    """Return where a point of the panel (m) is in the left image."""
    rig = Rig()
    (u, v), *_ = rig.desk.scene.project("left", pose().apply([[x, y, z]]))  # type: ignore[misc]
    return float(u), float(v)


@pytest.mark.parametrize("kind", ["double", "long"])
def test_a_double_and_a_long_press_of_a_button_and_of_a_point(kind: str) -> None:
    rig = desk()
    rig.select(control="RUN_STOP")
    (command,) = of_type(rig.act(kind), SendCommand)
    assert parse_gesture(command.text).kind == kind
    assert command.record["command"] == command.text and command.record["who"] == "Operator 1"
    rig = desk()
    rig.select(u=700.0, v=300.0)
    (command,) = of_type(rig.act(kind), SendCommand)
    assert command.text.startswith(f"{kind}:700.0,300.0@camera_left_optical_frame id=")


@pytest.mark.parametrize(
    ("gesture", "more", "text"),
    [
        ("turn", {"argument": -15}, "turn:CH1_SCALE:-15.0"),
        ("click", {"argument": 2}, "click:CH1_SCALE:2.0"),
        ("click", {"argument": -3}, "click:CH1_SCALE:-3.0"),
        ("set", {"argument": 60}, "set:CH1_SCALE:60.0"),
        ("set", {"mark": "AUTO"}, "set:CH1_SCALE:AUTO"),
    ],
)
def test_a_knob_is_turned_clicked_and_set(gesture: str, more: dict[str, Any], text: str) -> None:
    rig = desk(KNOB)
    assert selected(rig.select(control="CH1_SCALE"))["gestures"][:3] == ["turn", "click", "set"]
    (command,) = of_type(rig.act(gesture, **more), SendCommand)
    assert command.text.split(" id=")[0] == text


@pytest.mark.parametrize(
    ("gesture", "more", "code", "words"),
    [
        ("click", {"argument": 61}, "bad_gesture", "60"),
        ("click", {"argument": 1.5}, "bad_gesture", "whole number"),
        ("click", {}, "malformed", "argument"),
        ("set", {"argument": 181}, "bad_gesture", "-180 to 180"),
        ("set", {}, "malformed", "argument"),
        ("set", {"mark": "V9"}, "unknown_mark", "AUTO, V1"),
        ("set", {"mark": "AUTO", "argument": 1}, "malformed", "argument"),
        ("turn", {"argument": 0}, "bad_gesture", "not zero"),
        ("hold", {"argument": 31}, "bad_gesture", "30"),
        ("drag", {}, "wrong_gesture", "knob"),
        ("fly", {}, "malformed", "press"),
    ],
)
def test_what_a_knob_does_not_take_is_refused_with_the_bound(
    gesture: str, more: dict[str, Any], code: str, words: str
) -> None:
    rig = desk(KNOB)
    rig.select(control="CH1_SCALE")
    effects = rig.act(gesture, **more)
    assert refusal(effects) == code
    assert words in str(answer(effects)["values"])


def test_clicks_are_offered_for_a_knob_that_has_some_and_positions_for_one_that_is_seen() -> None:
    smooth = ControlSeen(name="CH1_SCALE", kind="knob", angle_deg=1.0)
    assert "click" not in selected(desk(smooth).select(control="CH1_SCALE"))["gestures"]
    rig = desk()
    assert selected(rig.select(control="CH1_SCALE"))["gestures"][:2] == ["turn", "press"]
    assert refusal(rig.act("set", 10.0)) == "wrong_gesture"


def test_a_line_is_chosen_in_the_picture_then_drawn_where_the_panel_is() -> None:
    rig = desk()
    (u, v), (to_u, to_v) = pixel(0.05, 0.06), pixel(0.12, 0.1)
    line = selected(rig.select(u=u, v=v, to_u=to_u, to_v=to_v))
    assert (line["kind"], line["gestures"], line["to_pixel"]) == ("line", ["drag"], [to_u, to_v])
    assert line["panel_mm"] == pytest.approx([50.0, 60.0], abs=0.1), "on top of the screen, which stands proud"
    assert line["to_mm"] == pytest.approx([120.0, 100.0], abs=0.1)
    (command,) = of_type(rig.act("drag"), SendCommand)
    gesture = parse_gesture(command.text)
    assert gesture.to is not None and not isinstance(gesture.target, str)
    assert gesture.target.frame == gesture.to.frame == PANEL
    found = (gesture.target.x, gesture.target.y, gesture.to.x, gesture.to.y)
    assert found == pytest.approx((0.05, 0.06, 0.12, 0.1), abs=1e-4)


def test_a_line_given_in_millimetres_is_shown_in_the_picture() -> None:
    rig = desk()
    line = selected(rig.select(x_mm=50, y_mm=60, to_x_mm=120, to_y_mm=100))
    assert line["pixel"] == pytest.approx(pixel(0.05, 0.06), abs=0.1)
    assert line["to_pixel"] == pytest.approx(pixel(0.12, 0.1), abs=0.1)
    (command,) = of_type(rig.act("drag"), SendCommand)
    assert command.text.startswith("drag:0.05,0.06@panel_link:0.12,0.1@panel_link id=")


@pytest.mark.parametrize(
    ("line", "code", "values"),
    [
        ((200, 120, 100, 80), "line_off_screen", {"x_mm": 200.0, "y_mm": 120.0}),
        ((50, 60, 190, 60), "line_leaves_screen", {"control": "Screen", "x_mm": 190.0, "y_mm": 60.0}),
        ((50, 60, 51, 60), "line_short", {"length_mm": 1.0, "limit_mm": 2.0}),
        ((50, 60, 1001, 60), "malformed", None),
    ],
)
def test_a_line_that_cannot_be_drawn_is_refused(line: tuple[float, ...], code: str, values: dict | None) -> None:
    rig = desk()
    effects = rig.select(**dict(zip(("x_mm", "y_mm", "to_x_mm", "to_y_mm"), line)))
    assert refusal(effects) == code
    if values is not None:
        assert answer(effects)["values"] == values
    assert refusal(rig.act("drag")) == "selection_gone"


def test_a_line_in_the_right_picture_or_with_another_target_is_refused() -> None:
    rig = desk()
    rig.desk.machine.frame_offered("right", rig.stamp)
    ends = {"u": 600.0, "v": 300.0, "to_u": 640.0, "to_v": 300.0}
    assert refusal(rig.select(camera="right", **ends)) == "point_needs_left"
    assert refusal(rig.select(control="SCREEN", **ends)) == "malformed"
    assert refusal(rig.select(u=600.0, v=300.0, to_u=640.0)) == "malformed"


def test_a_line_is_void_when_either_end_has_moved() -> None:
    rig = desk()
    rig.select(x_mm=20, y_mm=60, to_x_mm=180, to_y_mm=60)
    turn = math.radians(1.0)  # about the panel's origin: 0.3 mm at one end, 3 mm at the other
    before = pose()
    spin = [[math.cos(turn), -math.sin(turn), 0], [math.sin(turn), math.cos(turn), 0], [0, 0, 1]]
    rig.desk.scene.place_panel(type(before)(before.rotation @ spin, before.translation))
    effects = rig.act("drag")
    assert refusal(effects) == "panel_moved"
    assert answer(effects)["values"]["moved_mm"] > 3.0


def test_gestures_need_the_lease_and_a_number_that_was_not_used() -> None:
    rig = desk(KNOB)
    rig.select(control="CH1_SCALE")
    other, _ = rig.desk.join("Operator 2")
    ask = {"type": "act", "gesture": "set", "mark": "AUTO", "camera": "left", "stamp": str(rig.stamp)}
    assert refusal(rig.ask(other, selection=1, **ask)) == "no_lease"
    assert refusal(rig.ask(rig.a, selection=1, **ask, epoch=0)) == "stale_epoch"
    assert refusal(rig.ask(rig.a, selection=1, **ask, seq=1)) == "replayed"
    assert of_type(rig.ask(rig.a, selection=1, **ask), SendCommand)


# --- what is seen of the panel ---


def test_what_is_seen_of_the_panel_goes_to_all_pages_when_it_changes() -> None:
    rig = Rig()
    lamp = ControlSeen(name="RUN_STOP", kind="button", lamp="green")
    screen = ControlSeen(name="SCREEN", kind="touch_area", changed_ns=rig.now.ros_ns - 2_000_000_000)

    def told(*controls: ControlSeen) -> list[dict[str, Any]]:
        rig.desk.panel.show(seen(*controls, stamp_ns=rig.now.ros_ns), rig.now)
        messages = [e.message for e in of_type(rig.wait(0.1, alive=True), Broadcast)]
        return [c for m in messages if m["type"] == "panel" for c in m["controls"]]

    first = told(lamp, KNOB, screen)
    assert [(c["name"], c["lamp"], c["angle_deg"]) for c in first] == [
        ("RUN_STOP", "green", None),
        ("CH1_SCALE", "", 36),
        ("SCREEN", "", None),
    ]
    assert first[1]["marks"] == {"AUTO": 60.0, "V1": -90.0} and first[1]["detent_deg"] == 18.0
    assert first[2]["changed_ms"] == round((rig.now.wall_s - 2.1) * 1e3)
    same = ControlSeen(name="CH1_SCALE", kind="knob", angle_deg=36.1, detent_deg=18.0, marks=KNOB.marks)
    assert told(lamp, same, screen) == [], "a tenth of a degree is no news"
    hidden = ControlSeen(name="RUN_STOP", kind="button", hidden_by="something")
    assert told(hidden, same, screen)[0]["hidden_by"] == "something"
    _, hello = rig.desk.join("Operator 2")
    assert [c["name"] for c in hello["panel"]] == ["RUN_STOP", "CH1_SCALE", "SCREEN"]


def test_a_lamp_that_nobody_sees_any_more_is_not_shown_as_lit() -> None:
    rig = Rig()
    lamp = ControlSeen(name="RUN_STOP", kind="button", lamp="green")

    def told(seconds: float) -> list[list[str]]:
        messages = [e.message for e in of_type(rig.wait(seconds, alive=True), Broadcast)]
        return [[c["lamp"] for c in m["controls"]] for m in messages if m["type"] == "panel"]

    for _ in range(3):
        rig.desk.panel.show(seen(lamp), rig.now)
        assert told(1.5) in ([], [["green"]])
    assert told(1.0) == [[]], "the panel is not recognised, or recognition has ended"
    rig.desk.panel.show(seen(lamp), rig.now)
    assert told(0.1) == [["green"]]


def test_a_gesture_at_a_pixel_survives_its_text() -> None:
    gesture = Gesture(kind="hold", target=Point(x=700.25, y=3.0, frame="camera_left_optical_frame"), argument=1.0)
    assert parse_gesture(gesture.text()) == gesture
    assert math.isfinite(parse_gesture(gesture.text()).argument)
