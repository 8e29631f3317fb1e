"""Commands of a page on their way to the graph: on disk first, a stop before all else."""

from __future__ import annotations

import asyncio
import json
import re
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from unit.scope_ui_bridge.web_rig import WITHIN_S, Page, RecordingGraph, Rig, page, until, with_rig

from icu_common.core.goals.results import GoalResult, Outcome
from icu_common.core.reasons.message import Message
from scope_ui_bridge.adapters.secret_files import AuditFile
from scope_ui_bridge.core.desk import stops
from scope_ui_bridge.core.effects import Now
from scope_ui_bridge.core.records import verify

NOW = Now(mono_s=0.0, ros_ns=0, wall_s=0.0)


async def chosen(rig: Rig, client: Page) -> dict[str, Any]:
    """Show a picture, select RUN_STOP on it, and return the fields for a press."""
    stamp = rig.offer()
    await client.open_video()
    about, _ = await client.frame()
    assert about["stamp"] == str(stamp)
    answer = await client.ask(type="select", camera="left", stamp=about["stamp"], control="RUN_STOP")
    assert answer["ok"], answer
    return {"type": "act", "gesture": "press", "selection": 1, "camera": "left", "stamp": about["stamp"]}


def test_a_press_is_on_disk_before_it_goes_out(tmp_path: Path) -> None:
    path = tmp_path / "audit.jsonl"
    on_disk: list[str] = []

    async def scenario(rig: Rig) -> None:
        rig.graph.on_call = lambda: on_disk.extend(path.read_text().splitlines())
        async with page(rig, take=True) as client:
            assert (await client.ask(**await chosen(rig, client)))["ok"]
            await until(lambda: rig.graph.named("command"), "the command goes out")
        ((_, text),) = rig.graph.named("command")
        assert re.fullmatch(r"press:RUN_STOP id=ui-boot-1", text)
        assert json.loads(on_disk[-1])["command"] == text

    with_rig(scenario, audit=AuditFile(path))
    assert verify(path.read_text().splitlines())[0] >= 2


def test_a_command_whose_record_cannot_be_written_does_not_go_out() -> None:
    class FullDisk(AuditFile):
        def __init__(self) -> None:
            pass

        def append(self, record: dict[str, Any]) -> None:
            raise OSError("no space left on device")

        def close(self) -> None:
            pass

    async def scenario(rig: Rig) -> None:
        async with page(rig, take=True) as client:
            await client.ask(**await chosen(rig, client))
            failed = await client.until(lambda m: m["type"] == "log" and m["entry"]["status"] == "failed")
            reason = failed["entry"]["reason"]
            assert reason["code"] == "bridge.record_could_not_written"
            assert reason["values"] == {"error": "no space left on device"}
            assert rig.graph.named("command") == []
            assert (await client.ask(type="stop"))["ok"], "a stop needs no disk"
        assert rig.graph.named("stop")

    with_rig(scenario, audit=FullDisk())


def test_a_jog_that_is_let_go_while_its_record_is_written_does_not_begin() -> None:
    class SlowDisk(AuditFile):
        def __init__(self) -> None:
            pass

        def append(self, record: dict[str, Any]) -> None:
            assert written.wait(WITHIN_S)

        def close(self) -> None:
            pass

    async def scenario(rig: Rig) -> None:
        later = Now(mono_s=time.monotonic() + WITHIN_S, ros_ns=0, wall_s=0.0)
        rig.desk.machine.set_position(0.1, 0.05, 0.0, later)  # known until then
        async with page(rig, take=True) as client:
            press = await chosen(rig, client)
            picture = {name: press[name] for name in ("camera", "stamp")}
            for dx in (1, 0):
                assert (await client.ask(type="jog", dx=dx, dy=0, step_mm=5, **picture))["ok"]
            await asyncio.sleep(rig.config.jog_hold_s)  # the stimulus: the hold ends while the disk writes
            written.set()
            failed = await client.until(lambda m: m["type"] == "log" and m["entry"]["status"] == "failed")
            assert failed["entry"]["action"] == "jog"
            assert rig.graph.named("goal") == []

    written = threading.Event()
    with_rig(scenario, audit=SlowDisk(), jog_hold_s=0.1)


def test_nobody_to_take_a_command_is_said() -> None:
    async def scenario(rig: Rig) -> None:
        rig.graph.refuses = "no gantry controller is running"
        async with page(rig, take=True) as client:
            await client.ask(type="call", service="home")
            failed = await client.until(lambda m: m["type"] == "log" and m["entry"]["status"] == "failed")
            assert failed["entry"]["reason"] == "no gantry controller is running"

    with_rig(scenario)


def test_a_service_is_called_and_answered() -> None:
    async def scenario(rig: Rig) -> None:
        async with page(rig, take=True) as client:
            await client.ask(type="call", service="enable")
            done = await client.until(lambda m: m["type"] == "log" and m["entry"]["status"] == "done")
            assert (done["entry"]["action"], done["entry"]["reason"]) == ("enable", "as you wish")
        assert rig.graph.named("call") == [("call", "enable")]

    with_rig(scenario)


def test_a_reset_pressed_during_the_lift_is_sent_again_and_recorded_once() -> None:
    class Noting(AuditFile):
        def __init__(self) -> None:
            self.records: list[dict[str, Any]] = []

        def append(self, record: dict[str, Any]) -> None:
            self.records.append(record)

        def close(self) -> None:
            pass

    class Lifting(RecordingGraph):
        """A driver that rejects a reset twice, because the stylus still rises."""

        def call(self, service: str, answered: Callable[[bool, str], None]) -> None:
            self._take("call", service)
            refusal = Message("driver.refused", refusal=Message("stop.stop_not_complete_yet"))
            early = len(self.named("call")) < 3
            answered(not early, refusal if early else "accepted: reset")

    async def scenario(rig: Rig) -> None:
        rig.graph.__class__ = Lifting
        rig.desk.machine.set_state("driver", "stopped: stop requested")
        async with page(rig, take=True) as client:
            assert (await client.ask(type="call", service="reset"))["ok"]
            ends = ("done", "failed", "rejected", "no_answer")
            end = await client.until(lambda m: m["type"] == "log" and m["entry"]["status"] in ends)
            assert (end["entry"]["status"], end["entry"]["reason"]) == ("done", "accepted: reset")
        assert rig.graph.named("call") == 3 * [("call", "reset")]

    audit = Noting()
    with_rig(scenario, audit=audit)
    assert [line.get("result", "") for line in audit.records if line["command"] == "reset"] == ["", "done"]


def test_stop_by_plain_post_from_a_viewer(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(stops, "_SAME_STOP_S", WITHIN_S)  # half a second may pass between two posts of a test

    async def scenario(rig: Rig) -> None:
        async with page(rig, take=True), page(rig, control=False) as viewer:
            async with viewer.session.post("/stop", headers=viewer.origin) as answer:
                assert (answer.status, await answer.json()) == (200, {"ok": True})
            html = {**viewer.origin, "Accept": "text/html"}
            async with viewer.session.post("/stop", headers=html, allow_redirects=False) as answer:
                assert (answer.status, answer.headers["Location"]) == (303, "/")
            assert len(rig.graph.named("stop")) == 1, "twice within half a second is one stop"
            rig.server.mailbox.each(
                rig.desk.answers.result, GoalResult(goal_id="x", goal="x", outcome=Outcome.REJECTED), NOW
            )
            async with viewer.session.post("/stop", headers=viewer.origin) as answer:
                assert answer.status == 200
        assert len(rig.graph.named("stop")) == 2

    with_rig(scenario)


def test_a_stop_by_post_voids_what_its_page_has_sent_before_and_hangs() -> None:
    async def scenario(rig: Rig) -> None:
        async with page(rig, take=True) as client:
            ids = {"press": "p1", "page": client.hello["you"]["id"], "sent": str(client.seq + 1)}
            for sent in ("", "-1", "9" * 400, "x"):
                async with client.session.post("/stop", params=ids | {"sent": sent}, headers=client.origin) as answer:
                    assert (answer.status, await answer.json()) == (200, {"ok": True})
            async with client.session.post("/stop", params=ids, headers=client.origin) as answer:
                assert (answer.status, await answer.json()) == (200, {"ok": True})
            assert (await client.ask(type="call", service="home"))["code"] == "before_stop"
            assert (await client.ask(type="call", service="reset"))["ok"]
            await until(lambda: rig.graph.named("call"), "the call goes out")
        assert (rig.graph.named("stop"), rig.graph.named("call")) == ([("stop",)], [("call", "reset")])

    with_rig(scenario)


@pytest.mark.parametrize(
    ("gone", "cause"),
    [("closed", "stopped_page_gone"), ("cut off", "stopped_link_lost"), ("signed out", "stopped_signed_out")],
)
def test_heartbeats_go_out_with_keep_alives_and_a_page_that_is_gone_stops_a_motion(gone: str, cause: str) -> None:
    async def scenario(rig: Rig) -> None:
        async with page(rig, take=True) as client:
            deadline = time.monotonic() + WITHIN_S
            while not rig.graph.named("heartbeat"):  # none comes of a keep-alive after which the server was held up
                assert time.monotonic() < deadline
                await client.send(type="alive", client_ms=7.25)
                assert (await client.until(lambda m: m["type"] == "alive"))["client_ms"] == 7.25
                await client.until(lambda m: m["type"] == "state")
            rig.server.mailbox.each(rig.desk.machine.set_state, "driver", "moving")
            await client.until(lambda m: m["type"] == "state" and m["moving"])
            assert rig.graph.named("stop") == []
            if gone == "closed":
                await client.control.close()
            elif gone == "cut off":  # as by a tunnel that ends: nothing is said
                client.control._response.connection.transport.abort()
            else:
                rig.sign_in._sessions.clear()
                await client.send(type="alive", client_ms=7.5)
                async with client.session.get("/") as answer:
                    assert 'data-problem="ended"' in await answer.text(), "why the page that was looked at is gone"
            await until(lambda: rig.graph.named("stop"), "the stop")
        assert rig.desk.join("Operator 2")[1]["log"][-1]["target"] == cause

    with_rig(scenario)
