"""Teaching a panel from the page: who may, what is checked before anything goes out, and how the answer is shown."""

from __future__ import annotations

import asyncio
import json
from typing import Any

import aiohttp
import pytest
from unit.scope_ui_bridge import web_rig
from unit.scope_ui_bridge.desk_rig import Rig, answer, logged, of_type, refusal

from icu_common.core.goals.results import GoalResult, Outcome
from scope_ui_bridge.core.access import Role, SignIn
from scope_ui_bridge.core.effects import Broadcast, Effect, HoldPicture, Record, SendTeaching, SendToViewer
from scope_ui_bridge.core.orders import HeldPicture

STAMP = 1_795_225_165_871_340_849
GOOD: dict[str, Any] = {
    "stamp": str(STAMP),
    "model": "pump_2",
    "title": "Pump 2",
    "size_mm": [320, 150],
    "corners": [[90, 610], [1180, 598], [1122, 140], [151, 149]],
    "controls": [["START", "button", 310, 520.5, 14, 9, 3], ["SCREEN", "touch_area", 640, 300, 110, 70, 0]],
}


class Engineer:
    def __init__(self, role: Role = Role.ENGINEER) -> None:
        self.rig = Rig(operator=False)
        self.viewer, _ = self.rig.desk.join("Ada", role)
        self.ask(type="lease", step="take")
        self.rig.desk.picture_held(self.viewer, HeldPicture(stamp_ns=STAMP, width=1280, height=720))

    def ask(self, **fields: Any) -> list[Effect]:
        return self.rig.ask(self.viewer, **fields)

    def teach(self, **changes: Any) -> list[Effect]:
        return self.ask(type="teach", **GOOD | changes)


def test_a_picture_is_held_and_what_was_pointed_at_goes_to_perception() -> None:
    ada = Engineer()
    (hold,) = of_type(ada.ask(type="hold"), HoldPicture)
    assert hold.viewer == ada.viewer
    (told,) = ada.rig.desk.picture_held(ada.viewer, HeldPicture(stamp_ns=STAMP, width=1280, height=720))
    assert isinstance(told, SendToViewer)
    assert told.message == {"type": "held", "stamp": str(STAMP), "width": 1280, "height": 720}
    effects = ada.teach()
    (order,) = of_type(effects, SendTeaching)
    request = json.loads(order.text)
    assert request == {**GOOD, "id": request["id"]} and order.record["goal_id"] == request["id"]
    assert order.record["who"] == "Ada" and "START" in order.record["command"], "the audit says what was pointed at"
    assert logged(effects)[0]["action"] == "teach"
    assert not ada.rig.desk.moving
    assert refusal(ada.teach()) == "busy_pending"
    assert refusal(ada.ask(type="hold")) == "busy_pending", "another picture would go out with these places"
    details = (("layout", "/x/pump_2.yaml"), ("template", "/x/pump_2.png"), ("start", "bring_up --scope pump_2"))
    done = GoalResult(goal_id=request["id"], goal="pump_2", outcome=Outcome.REACHED, reason="wrote", details=details)
    effects = ada.rig.desk.answers.taught(done, ada.rig.now)
    message = effects[0]
    assert isinstance(message, Broadcast)
    assert (message.message["type"], message.message["ok"]) == ("taught", True)
    assert message.message["layout"] == "/x/pump_2.yaml" and message.message["start"] == "bring_up --scope pump_2"
    assert of_type(effects, Record)[0].record["result"] == "reached"
    assert ada.rig.desk.answers.taught(done, ada.rig.now) == [], "an answer without a question"


def test_without_an_answer_it_is_given_up() -> None:
    ada = Engineer()
    ada.teach()
    ada.rig.ask(ada.viewer, type="alive", client_ms=1.0)
    for _ in range(31):
        ada.rig.seconds += 1.0
        ada.rig.ask(ada.viewer, type="alive", client_ms=1.0)
        effects = ada.rig.desk.tick(ada.rig.now)
    assert logged(effects)[0]["status"] == "no_answer"


def test_only_engineers_in_control_at_rest_teach() -> None:
    operator = Engineer(Role.OPERATOR)
    for kind in ({"type": "hold"}, {"type": "teach", **GOOD}):
        answered = answer(operator.ask(**kind))
        assert (answered["code"], answered["values"]["role"]) == ("role_needed", "engineer")
    ada = Engineer()
    other, _ = ada.rig.desk.join("Bob", Role.ENGINEER)
    assert refusal(ada.rig.ask(other, type="hold")) == "no_lease"
    assert refusal(ada.teach(epoch=0)) == "stale_epoch"
    assert refusal(ada.teach(seq=0)) == "replayed"
    assert refusal(ada.teach(boot="old")) == "old_boot"
    ada.rig.desk.machine.set_state("driver", "moving")
    assert refusal(ada.teach()) == "busy_moving"


def test_a_panel_with_as_many_controls_as_are_allowed_with_as_long_names_is_taught() -> None:
    ada = Engineer()
    row = ["touch_area", 1278.3, 718.7, 100.25, 100.25, 12.25]
    controls = [[f"C{number:02d}".ljust(32, "X"), *row] for number in range(60)]
    (order,) = of_type(ada.teach(controls=controls), SendTeaching)
    assert json.loads(order.text)["controls"] == controls


BUTTON = GOOD["controls"][0]


@pytest.mark.parametrize(
    ("changes", "code", "values"),
    [
        ({"stamp": "5"}, "teach_no_picture", {}),
        ({"model": "../pump"}, "teach_name", {"field": "model", "found": "../pump"}),
        ({"model": ""}, "teach_name", {"field": "model"}),
        ({"size_mm": [5, 150]}, "teach_number", {"field": "width", "found": 5.0, "low": 20.0, "high": 2000.0}),
        ({"size_mm": [320, 2001]}, "teach_number", {"field": "height", "found": 2001.0}),
        ({"controls": []}, "teach_number", {"field": "controls", "found": 0, "low": 1, "high": 60}),
        ({"controls": [BUTTON] * 61}, "teach_number", {"field": "controls", "found": 61}),
        ({"controls": [BUTTON, BUTTON]}, "teach_twice", {"control": "START"}),
        ({"controls": [["RUN/STOP", *BUTTON[1:]]]}, "teach_name", {"field": "control", "found": "RUN/STOP"}),
        ({"controls": [["START", "lever", *BUTTON[2:]]]}, "teach_kind", {"found": "lever"}),
        ({"controls": [[*BUTTON[:2], 1280, 5, 14, 9, 3]]}, "teach_outside", {"place": "START", "width": 1280}),
        ({"controls": [[*BUTTON[:2], 310, 520, 0, 9, 3]]}, "teach_number", {"field": "width", "low": 1.0}),
        ({"controls": [[*BUTTON[:2], 310, 520, 321, 9, 3]]}, "teach_number", {"field": "width", "high": 320.0}),
        ({"controls": [[*BUTTON[:2], 310, 520, 14, 9, 101]]}, "teach_number", {"field": "proud", "high": 100.0}),
        ({"corners": [[-1, 610], *GOOD["corners"][1:]]}, "teach_outside", {"place": "1", "u": -1.0}),
        ({"corners": GOOD["corners"][:3]}, "malformed", {}),
        ({"corners": [[1, "2"], *GOOD["corners"][1:]]}, "malformed", {}),
        ({"controls": [["START", "button", 1, 2, 3]]}, "malformed", {}),
        ({"controls": "START"}, "malformed", {}),
        ({"size_mm": 320}, "malformed", {}),
        ({"folder": "/etc"}, "malformed", {}),
    ],
)
def test_what_makes_no_panel_is_refused_with_the_value_and_the_bound(
    changes: dict[str, Any], code: str, values: dict[str, Any]
) -> None:
    ada = Engineer()
    effects = ada.teach(**changes)
    assert refusal(effects) == code, "and nothing goes out"
    assert values.items() <= answer(effects)["values"].items()


@pytest.mark.parametrize("role", [Role.ENGINEER, Role.OPERATOR])
def test_the_held_picture_is_served_at_full_size_to_engineers(role: Role) -> None:
    async def scenario(rig: web_rig.Rig) -> None:
        async with web_rig.page(rig, take=True) as page:
            if role is Role.ENGINEER:
                async with page.session.get("/held.jpg") as got:
                    assert got.status == 404, "none is held yet"
                rig.offer(level=77, stamp_ns=STAMP)
                await web_rig.until(lambda: rig.server.video.newest("left"), "the picture")
                assert (await page.ask(type="hold"))["ok"]
                held = next(m for m in page.heard if m["type"] == "held")
                assert held == {"type": "held", "stamp": str(STAMP), "width": 128, "height": 72}
                rig.offer(level=200)
                small = {"corners": [[10, 60], [110, 60], [110, 10], [10, 10]]}
                small["controls"] = [["START", "button", 31, 52, 14, 9, 3]]
                assert (await page.ask(type="teach", **GOOD | small))["ok"]
                await web_rig.until(lambda: rig.graph.named("teaching"), "the request")
                _, text, stamp, encoding, picture = rig.graph.named("teaching")[0]
                assert (stamp, encoding, picture.shape) == (STAMP, "bgr8", (72, 128, 3))
                assert (picture == 77).all() and json.loads(text)["stamp"] == str(STAMP)
                async with page.session.get("/held.jpg", params={"stamp": str(STAMP + 1)}) as got:
                    assert got.status == 404, "another one is held: what is pointed at in it would not be meant"
            async with page.session.get("/held.jpg", params={"stamp": str(STAMP)}) as got:
                assert got.status == (200 if role is Role.ENGINEER else 401)
                body = await got.read()
            assert role is not Role.ENGINEER or body.startswith(b"\xff\xd8")
            async with aiohttp.ClientSession(rig.url) as stranger, stranger.get("/held.jpg") as got:
                assert got.status == 401

    with web_rig.Rig() as rig:
        secrets = iter(f"word-{n}" for n in range(9))
        made = SignIn(lambda: next(secrets), 100.0, role)
        rig.sign_in = rig.server._sign_in = rig.server.door._sign_in = made
        rig.token = made.issue_token()
        asyncio.run(scenario(rig))
