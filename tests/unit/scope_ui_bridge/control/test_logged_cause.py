"""The log has the cause of each stop that the bridge requests: its code, what was measured, and the limit."""

from __future__ import annotations

from typing import Any

import pytest
from unit.scope_ui_bridge.desk_rig import moving, of_type
from unit.scope_ui_bridge.web_rig import Rig as WebRig
from unit.scope_ui_bridge.web_rig import page, with_rig

from scope_ui_bridge.core.effects import Effect, StopNow


def cause(effects: list[Effect]) -> tuple[str, dict[str, Any]]:
    (stop,) = of_type(effects, StopNow)
    return stop.cause.code, dict(stop.cause.values)


def test_a_person_is_logged_by_name() -> None:
    rig = moving()
    effects = rig.ask(rig.a, type="stop")
    assert cause(effects) == ("bridge.stop_by_person", {"who": "Operator 1"})
    assert of_type(effects, StopNow)[0].cause == "stop: stopped_by_person, pressed by Operator 1"


def test_a_silent_page_is_logged_with_its_silence_and_the_limit() -> None:
    rig = moving()
    code, values = cause(rig.wait(1.0))
    limit_s = rig.desk.config.silence_stop_s
    assert (code, values["cause"], values["limit_s"]) == ("bridge.stop_silent", "stopped_link_lost", limit_s)
    assert limit_s <= values["silence_s"] < limit_s + 0.051, "measured, not the limit"


def test_missing_pictures_are_logged_with_their_age_and_the_limit() -> None:
    rig = moving(pictures=True)
    rig.desk.machine.picture_came(rig.now)
    code, values = cause(rig.wait(1.0, alive=True))
    limit_s = rig.desk.config.picture_stop_s
    assert (code, values["cause"], values["limit_s"]) == ("bridge.stop_silent", "stopped_no_picture", limit_s)
    assert limit_s <= values["silence_s"] < limit_s + 0.051


def test_a_page_that_shows_no_picture_is_logged_with_what_it_has_reported() -> None:
    rig = moving()
    effects = rig.ask(rig.a, type="blind", silence_ms=1130)
    limit_s = rig.desk.config.frame_stale_s
    assert cause(effects) == (
        "bridge.stop_silent",
        {"cause": "stopped_page_blind", "silence_s": 1.13, "limit_s": limit_s},
    )
    (stop,) = of_type(effects, StopNow)
    assert stop.cause == f"stop: stopped_page_blind, silent for 1.13 s (limit {limit_s:.2f} s)"


@pytest.mark.parametrize(
    ("fields", "code"),
    [({"type": "hidden"}, "stopped_page_hidden"), ({"type": "lease", "step": "release"}, "stopped_released")],
)
def test_a_page_that_gives_control_up_is_logged_by_its_code(fields: dict[str, Any], code: str) -> None:
    rig = moving()
    effects = rig.ask(rig.a, **fields)
    assert cause(effects) == ("bridge.stop_cause", {"cause": code})
    assert of_type(effects, StopNow)[0].cause == f"stop: {code}"


def test_the_cause_goes_to_the_graph_with_the_stop() -> None:
    async def scenario(rig: WebRig) -> None:
        async with page(rig, take=True) as client:
            assert (await client.ask(type="stop"))["ok"]
            async with client.session.post("/stop", params={"press": "p2"}, headers=client.origin) as answer:
                assert answer.status == 200
        assert {cause.code for cause in rig.graph.causes} == {"bridge.stop_by_person"}

    with_rig(scenario)
