"""Rights of users: roles, floods, and changes of control."""

from __future__ import annotations

import json

import pytest
from unit.scope_ui_bridge.desk_rig import BOOT, Rig, answer, logged, of_type, refusal

from scope_ui_bridge.core import wire
from scope_ui_bridge.core.access import SHORT, Role
from scope_ui_bridge.core.config import BridgeConfig
from scope_ui_bridge.core.effects import (
    Broadcast,
    CallService,
    Effect,
    End,
    Record,
    SendToViewer,
    StopNow,
)


def test_a_viewer_may_stop_and_never_gets_control() -> None:
    rig = Rig(operator=False)
    viewer, hello = rig.desk.join("Guest", Role.VIEWER)
    assert hello["you"]["role"] == "viewer"
    for step in ("take", "request"):
        answered = answer(rig.ask(viewer, type="lease", step=step))
        assert (answered["code"], answered["values"]["role"]) == ("role_needed", "operator")
    assert rig.desk.lease.holder == ""
    assert of_type(rig.ask(viewer, type="stop"), StopNow)


def test_a_recorded_session_is_looked_at_only() -> None:
    rig = Rig(BridgeConfig(replay=True), operator=False)
    for step in ("take", "request"):
        assert refusal(rig.ask(rig.a, type="lease", step=step)) == "replay"
    assert refusal(rig.ask(rig.a, type="call", service="home")) == "no_lease"
    assert rig.hello["replay"] is True
    assert of_type(rig.ask(rig.a, type="stop"), StopNow), "a stop is always good"


def test_what_programs_say_goes_to_engineers_and_their_reports_to_all() -> None:
    rig = Rig()
    engineer, _ = rig.desk.join("Ada", Role.ENGINEER)
    for number in range(60):
        rig.desk.said({"wall_ms": 1, "level": "warn", "name": "serial_driver", "text": f"line {number}"})
    rig.desk.machine.set_facts("calibration", {"rms_mm": "0.03"})
    effects = rig.wait(0.05, alive=True)
    (said,) = [e for e in of_type(effects, SendToViewer) if e.message["type"] == "console"]
    assert said.viewer == engineer
    assert len(said.message["lines"]) == 40, "a chatty program does not fill the link"
    (facts,) = [e.message["facts"] for e in of_type(effects, Broadcast) if e.message["type"] == "facts"]
    assert facts == {"calibration": {"rms_mm": "0.03"}}
    later = rig.wait(0.2, alive=True)
    assert not [e for e in of_type(later, (SendToViewer, Broadcast)) if e.message["type"] in ("console", "facts")]


def test_an_engineer_who_comes_later_reads_what_was_said_before() -> None:
    rig = Rig()
    for number in range(150):
        rig.desk.said({"wall_ms": number, "level": "warn", "name": "serial_driver", "text": f"line {number}"})
        rig.wait(0.05, alive=True)
    rig.desk.said({"wall_ms": 150, "level": "error", "name": "serial_driver", "text": "line 150"})
    _, viewers = rig.desk.join("Guest", Role.VIEWER)
    engineer, hello = rig.desk.join("Ada", Role.ENGINEER)
    assert (viewers["console"], [line["text"] for line in hello["console"]]) == (
        [],
        [f"line {n}" for n in range(50, 150)],
    )
    (said,) = [e for e in of_type(rig.wait(0.05, alive=True), SendToViewer) if e.message["type"] == "console"]
    assert (said.viewer, [line["text"] for line in said.message["lines"]]) == (engineer, ["line 150"]), "once each"


def test_other_settings_are_accepted_by_engineers_only() -> None:
    rig = Rig()
    assert refusal(rig.ask(rig.a, type="call", service="accept_settings")) == "role_needed"
    rig.ask(rig.a, type="lease", step="release")
    engineer, _ = rig.desk.join("Ada", Role.ENGINEER)
    rig.ask(engineer, type="lease", step="take")
    assert of_type(rig.ask(engineer, type="call", service="accept_settings"), CallService)


def test_without_the_lease_nothing_but_stop_is_done() -> None:
    rig = Rig()
    viewer, _ = rig.desk.join("Operator 2")
    head = {"camera": "left", "stamp": str(rig.stamp)}
    assert refusal(rig.ask(viewer, type="select", control="RUN_STOP", **head)) == "no_lease"
    assert refusal(rig.ask(viewer, type="act", gesture="press", selection=1, **head)) == "no_lease"
    assert refusal(rig.ask(viewer, type="call", service="home")) == "no_lease"
    assert refusal(rig.ask(viewer, type="lease", step="take")) == "lease_held"
    effects = rig.ask(viewer, type="stop")
    assert of_type(effects, StopNow)
    assert logged(effects)[0]["who"] == "Operator 2"


def test_replays_stale_epochs_and_old_boots_are_refused_but_a_stop_is_always_good() -> None:
    rig = Rig()
    message = {"type": "call", "service": "home", "seq": 50, "boot": BOOT, "epoch": 1}
    assert of_type(rig.desk.message(rig.a, json.dumps(message), rig.now), CallService)
    assert refusal(rig.desk.message(rig.a, json.dumps(message), rig.now)) == "replayed"
    assert refusal(rig.desk.message(rig.a, json.dumps(message | {"seq": 51, "epoch": 0}), rig.now)) == "stale_epoch"
    assert refusal(rig.desk.message(rig.a, json.dumps(message | {"seq": 52, "boot": "old"}), rig.now)) == "old_boot"
    stop = {"type": "stop", "seq": 1, "boot": "old", "epoch": 0}
    assert of_type(rig.desk.message(rig.a, json.dumps(stop), rig.now), StopNow)


def test_a_flood_is_dropped_unread_and_then_ended_and_the_stop_in_it_is_heard(monkeypatch: pytest.MonkeyPatch) -> None:
    rig = Rig()
    read: list[str] = []
    monkeypatch.setattr(wire, "decode", lambda text, real=wire.decode: read.append(text) or real(text))
    answers = [rig.ask(rig.a, type="call", service="enable") for _ in range(159)]
    codes = [e.message.get("code") for effects in answers for e in of_type(effects, SendToViewer)]
    assert codes.count("rate_limited") == 1, "told once a second, not with every message"
    assert answers[-1] == []
    assert len(read) <= 80
    assert of_type(rig.ask(rig.a, type="stop"), StopNow)
    assert rig.ask(rig.a, type="call", service="enable") == [End(viewer=rig.a)]
    rig.seconds += 2.0
    (alive,) = of_type(rig.ask(rig.a, type="alive", client_ms=5.0), SendToViewer)
    clocks = {"bridge_ms": rig.seconds * 1e3, "wall_ms": rig.now.wall_s * 1e3}
    assert alive.message == {"type": "alive", "client_ms": 5.0, **clocks}


def test_a_flood_of_garbage_is_answered_as_seldom_as_any_other() -> None:
    rig = Rig()
    viewer, _ = rig.desk.join("Operator 2")
    effects = [e for _ in range(500) for e in rig.desk.message(viewer, "{", rig.now)]
    assert [e.message["code"] for e in of_type(effects, SendToViewer)] == ["malformed"] * 80 + ["rate_limited"]
    assert effects[-1] == End(viewer=viewer)
    assert of_type(rig.ask(viewer, type="stop"), StopNow)


def test_a_flood_of_stops_stops_and_is_ended_as_any_other() -> None:
    rig = Rig()
    viewer, _ = rig.desk.join("Eve", Role.VIEWER)
    effects = [e for _ in range(500) for e in rig.ask(viewer, type="stop")]
    assert len(of_type(effects, StopNow)) == 1
    assert effects[-1] == End(viewer=viewer)


def test_only_the_page_in_control_may_send_long_messages() -> None:
    rig = Rig()
    viewer, _ = rig.desk.join("Eve", Role.ENGINEER)
    long = {"type": "sequence", "steps": ["press:RUN_STOP => effect"] * 99, "camera": "left", "stamp": str(rig.stamp)}
    (answer,) = of_type(rig.ask(viewer, **long), SendToViewer)
    assert answer.message["code"] == "oversized" and answer.message["values"]["limit"] == SHORT
    assert answer.message["seq"] is not None, "the answer names the rejected message"
    assert "oversized" not in str(rig.ask(rig.a, **long))


def test_hand_over_is_asked_for_and_not_done_while_something_moves() -> None:
    rig = Rig()
    rig.select(control="RUN_STOP")
    other, _ = rig.desk.join("Operator 2")
    rig.ask(other, type="lease", step="request")
    rig.desk.machine.set_state("driver", "moving")
    assert refusal(rig.ask(rig.a, type="lease", step="grant", to=other)) == "busy_moving"
    rig.desk.machine.set_state("driver", "idle")
    effects = rig.ask(rig.a, type="lease", step="grant", to=other)
    assert rig.desk.lease.holder == other
    assert {"type": "selection", "selection": None} in [e.message for e in of_type(effects, Broadcast)]
    assert refusal(rig.select(control="RUN_STOP")) == "no_lease"


def test_control_is_handed_over_only_to_whose_request_was_read() -> None:
    rig = Rig()
    read, _ = rig.desk.join("Operator 2")
    quick, _ = rig.desk.join("Operator 3")
    rig.ask(read, type="lease", step="request")
    rig.ask(quick, type="lease", step="request")
    assert refusal(rig.ask(rig.a, type="lease", step="grant", to=read)) == "other_request"
    assert refusal(rig.ask(rig.a, type="lease", step="decline", to=read)) == "other_request"
    assert refusal(rig.ask(rig.a, type="lease", step="grant")) == "malformed"
    assert (rig.desk.lease.holder, rig.desk.lease.requester) == (rig.a, quick)
    assert answer(rig.ask(rig.a, type="lease", step="grant", to=quick))["ok"]
    assert rig.desk.lease.holder == quick


def control_lines(effects: list[Effect]) -> list[tuple[str, str, str, str, str]]:
    """Return the audit file's records of control: the user, the action, the other user, the page, and the reason."""
    fields = ("who", "command", "target", "page", "reason")
    lines = [e.record for e in of_type(effects, Record) if e.record["command"].endswith(" control")]
    assert all(line["result"] == "done" and line["wall_s"] > 1.7e9 for line in lines)
    return [tuple(str(line.get(field, "")) for field in fields) for line in lines]  # type: ignore[misc]


def test_the_audit_file_tells_who_was_in_control_at_each_moment() -> None:
    rig = Rig(operator=False)
    other, _ = rig.desk.join("Operator 2")
    control = lambda viewer, step, **more: control_lines(rig.ask(viewer, type="lease", step=step, **more))  # noqa: E731
    assert control(rig.a, "take") == [("Operator 1", "take control", "", rig.a, "")]
    assert control(rig.a, "take") == control(other, "take") == control(other, "request") == [], "nothing has changed"
    assert control(rig.a, "decline", to=other) == control(other, "request") == []
    assert control(rig.a, "grant", to=other) == [("Operator 1", "hand over control", "Operator 2", other, "")]
    assert control(rig.a, "release") == [], "who has none gives none up"
    assert control(other, "release") == [("Operator 2", "release control", "", other, "")]
    assert control(rig.a, "request") == [("Operator 1", "take control", "", rig.a, "")], "what is free is taken"
    assert control_lines(rig.desk.leave(other, rig.now)) == []
    assert control_lines(rig.wait(5.2)) == [("Operator 1", "lose control", "", rig.a, "link lost")]
    control(rig.a, "take")
    gone = rig.desk.leave(rig.a, rig.now, "stopped_signed_out")
    assert control_lines(gone) == [("Operator 1", "lose control", "", rig.a, "signed out")]


@pytest.mark.parametrize("how", ["hidden", "silent", "gone", "released"])
def test_the_stop_goes_out_before_it_is_written_who_lost_control(how: str) -> None:
    rig = Rig()
    rig.desk.machine.set_state("driver", "moving")
    if how == "hidden":
        effects = rig.ask(rig.a, type="hidden")
    elif how == "silent":
        effects = rig.wait(0.7)
    else:
        effects = rig.desk.leave(rig.a, rig.now) if how == "gone" else rig.ask(rig.a, type="lease", step="release")
    stop, passed = (e for e in effects if isinstance(e, (StopNow, Record)))
    assert isinstance(stop, StopNow)
    ((_, command, _, _, reason),) = control_lines([passed])
    why = {"hidden": "page hidden", "silent": "link lost", "gone": "page gone", "released": ""}[how]
    assert (command, reason) == ("release control" if how == "released" else "lose control", why)
    assert passed.record["epoch"] == rig.desk.lease.epoch


def test_there_is_room_for_so_many_pages() -> None:
    rig = Rig(BridgeConfig(max_viewers=1))
    with pytest.raises(Exception, match="too_many_viewers limit=1"):
        rig.desk.join("Operator 2")
    rig.desk.join("Operator 1")
    for page in ("v1", "v2"):
        rig.desk.leave(page, rig.now)
    rig.desk.join("Operator 2")
    rig.desk.join("Operator 1")
