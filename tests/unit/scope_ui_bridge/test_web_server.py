"""The server as a browser and as an attacker see it: sign-in, origins, bad input, commands, stop, video."""

from __future__ import annotations

import asyncio
import json
import re
import threading
import time
from pathlib import Path
from typing import Any

import aiohttp
import cv2
import numpy as np
import pytest
from unit.scope_ui_bridge.web_rig import WITHIN_S, Page, Rig, page, until, with_rig

from icu_common.core.configuration.config import ConfigError
from icu_common.core.goals.results import GoalResult, Outcome
from scope_ui_bridge.adapters.secret_files import AuditFile
from scope_ui_bridge.adapters.web.front_door import COOKIE, PAGE
from scope_ui_bridge.core.desk import stops
from scope_ui_bridge.core.effects import Broadcast, Now
from scope_ui_bridge.core.records import verify

NOW = Now(mono_s=0.0, ros_ns=0, wall_s=0.0)


async def still_there(rig: Rig) -> None:
    async with aiohttp.ClientSession(rig.url) as session, session.get("/session") as answer:
        assert answer.status == 401


# --- sign-in and headers ---


def test_the_token_gives_a_strict_cookie_once_and_the_page_with_its_headers() -> None:
    async def scenario(rig: Rig) -> None:
        async with page(rig, sign_in=False) as client:
            async with client.session.get("/") as answer:
                assert answer.status == 401
                assert "Sign in" in await answer.text()
            async with client.session.head("/", params={"token": rig.token}) as answer:
                assert answer.status == 405, "a HEAD does not use the token up"
            async with client.session.get("/", params={"token": rig.token}) as answer:
                assert answer.status == 200
                assert 'id="stop"' in await answer.text()
                cookie = answer.headers["Set-Cookie"]
                policy = answer.headers["Content-Security-Policy"]
            assert cookie.startswith(f"{COOKIE}_{rig.server.port}=")
            assert "HttpOnly" in cookie
            assert "SameSite=Strict" in cookie
            assert "frame-ancestors 'none'" in policy
            assert "unsafe" not in policy
            async with client.session.get("/session") as answer:
                assert (answer.status, (await answer.json())["name"]) == (200, "Operator 1")
            async with client.session.get("/", params={"token": "old"}) as answer:
                assert answer.status == 200, "who is signed in needs no token"
        async with page(rig, sign_in=False) as other, other.session.get("/", params={"token": rig.token}) as answer:
            assert answer.status == 401
            assert 'data-problem="wrong_token"' in await answer.text()

    with_rig(scenario)


def test_the_sign_in_form_works() -> None:
    async def scenario(rig: Rig) -> None:
        async with page(rig, sign_in=False) as client:
            bad = {"token": "<script>alert(1)</script>"}
            async with client.session.post("/sign-in", data=bad, headers=client.origin) as answer:
                assert answer.status == 401
                assert "alert(1)" not in await answer.text()
            form = {"token": f" {rig.token}\n"}
            async with client.session.post("/sign-in", data=form, headers=client.origin) as answer:
                assert answer.status == 200
                assert 'id="stop"' in await answer.text()

    with_rig(scenario)


@pytest.mark.parametrize("what", ["image", "iframe", "empty"])
def test_a_foreign_page_that_guesses_tokens_shuts_nobody_out(what: str) -> None:
    async def scenario(rig: Rig) -> None:
        async with page(rig, sign_in=False) as client:
            # What a browser says of a picture, a frame or a request on a page; a picture needs no Origin.
            part = {"Sec-Fetch-Dest": what, "Sec-Fetch-Site": "cross-site"}
            for token in ("guess", rig.token):
                async with client.session.get("/", params={"token": token}, headers=part) as answer:
                    assert answer.status == 401
            async with client.session.get("/", params={"token": rig.token}) as answer:
                assert answer.status == 200, "neither waits, nor was the token used up"

    with_rig(scenario)


def test_one_browser_is_signed_in_at_two_robots_of_one_host() -> None:
    async def scenario(rig: Rig) -> None:
        # Browsers keep cookies by host, whatever the port; so does this jar.
        with Rig() as other:
            async with page(rig) as client, aiohttp.ClientSession(cookie_jar=client.session.cookie_jar) as browser:
                beside = Page(other, browser)
                token = other.sign_in.issue_token()  # the rigs' secrets are numbered: now both sessions' differ
                async with browser.get(f"{other.url}/", params={"token": token}) as answer:
                    assert answer.status == 200
                for bed in (client, beside):
                    async with browser.post(f"{bed.rig.url}/stop", headers=bed.origin) as answer:
                        assert answer.status == 200
                    assert len(bed.rig.graph.named("stop")) == 1
                async with browser.post(f"{other.url}/sign-out", headers=beside.origin) as answer:
                    assert answer.status == 401
                async with client.session.get("/session") as answer:
                    assert answer.status == 200, "who signs out there is still signed in here"

    with_rig(scenario)


@pytest.mark.parametrize("meanwhile", ["speaks", "says nothing", "only pings"])
def test_signing_out_ends_the_session_and_its_connections(meanwhile: str) -> None:
    async def ends(rig: Rig, client: Page) -> None:
        if meanwhile == "speaks":
            await client.send(type="alive", client_ms=1.0)
        elif meanwhile == "only pings":
            await client.control.ping()
        while True:
            message = await client.control.receive(timeout=WITHIN_S)
            if message.type in (aiohttp.WSMsgType.CLOSE, aiohttp.WSMsgType.CLOSED):
                break
            if message.type is aiohttp.WSMsgType.PONG:
                await client.control.ping()
        while not client.video.closed:
            await client.video.receive(timeout=WITHIN_S)

    async def scenario(rig: Rig) -> None:
        async with page(rig, take=True) as client:
            if meanwhile == "only pings":
                assert (await client.ask(type="lease", step="release"))["ok"]
                client.control = await client.session.ws_connect("/control", headers=client.origin, autoping=False)
                client.seq = 0
                assert (await client.ask(type="lease", step="take"))["ok"]
            await client.open_video()
            await until(lambda: rig.server.video._viewers, "the pictures are asked for")
            rig.server.mailbox.each(rig.desk.machine.set_state, "driver", "moving")
            await client.until(lambda m: m["type"] == "state" and m["moving"])
            async with client.session.post("/sign-out", headers=client.origin) as answer:
                assert answer.status == 401
                assert 'data-problem=""' in await answer.text(), "who has signed out knows it"
            await asyncio.wait_for(ends(rig, client), WITHIN_S)
            await until(lambda: rig.desk.lease.holder == "", "the lease is free")
            assert len(rig.graph.named("stop")) == 1
        assert rig.desk.join("Operator 2")[1]["log"][-1]["target"] == "stopped_signed_out"

    with_rig(scenario)


def test_the_page_has_no_inline_script_or_style_and_nothing_from_elsewhere() -> None:
    for name in ("index.html", "sign_in.html"):
        text = (PAGE / name).read_text()
        assert not re.search(r"<script(?![^>]*src=)|<style|\sstyle=|\son\w+=", text)
    for file in filter(Path.is_file, PAGE.rglob("*")):
        foreign = re.findall(r"https?://(?!www\.w3\.org/)", file.read_text())
        assert foreign == [], file.name


# --- what attackers try ---


@pytest.mark.parametrize(
    "origin",
    [
        None,
        "null",
        "http://evil.example",
        "http://127.0.0.1",
        "https://127.0.0.1:{port}",
        "http://127.0.0.1:{port}.evil",
        "http://127.0.0.1:{port}@evil.example",
        "http://127.0.0.1:{port}/",
        "http://127.0.0.1.evil.example:{port}",
        "http://localhost.evil.example:{port}",
        "http://127.0.0.1:{port} http://evil.example",
    ],
)
def test_foreign_origins_get_no_connection_and_cannot_post(origin: str | None) -> None:
    async def scenario(rig: Rig) -> None:
        async with page(rig, control=False) as client:
            headers = {} if origin is None else {"Origin": origin.format(port=rig.server.port)}
            for path in ("/control", "/video"):
                with pytest.raises(aiohttp.WSServerHandshakeError) as caught:
                    await client.session.ws_connect(path, headers=headers)
                assert caught.value.status == 403
            for path in ("/stop", "/sign-in", "/sign-out"):
                async with client.session.post(path, headers=headers) as answer:
                    assert answer.status == 403
        assert rig.graph.calls == []

    with_rig(scenario)


def test_foreign_hosts_are_refused() -> None:
    async def scenario(rig: Rig) -> None:
        host = {"Host": "rebound.example"}
        async with page(rig, sign_in=False) as client, client.session.get("/", headers=host) as answer:
            assert answer.status == 421

    with_rig(scenario)


def test_without_a_cookie_there_is_no_connection_and_no_stop() -> None:
    async def scenario(rig: Rig) -> None:
        async with page(rig, sign_in=False) as client:
            for path in ("/control", "/video"):
                with pytest.raises(aiohttp.WSServerHandshakeError) as caught:
                    await client.session.ws_connect(path, headers=client.origin)
                assert caught.value.status == 401
            async with client.session.post("/stop", headers=client.origin) as answer:
                assert answer.status == 401
        assert rig.graph.calls == []

    with_rig(scenario)


@pytest.mark.parametrize(
    "path", ["/page/../core/desk/desk.py", "/page/%2e%2e/core/desk/desk.py", "/page/..%2f..%2fsetup.py", "/etc"]
)
def test_files_beside_the_page_are_not_served(path: str) -> None:
    async def scenario(rig: Rig) -> None:
        reader, writer = await asyncio.open_connection("127.0.0.1", rig.server.port)
        writer.write(f"GET {path} HTTP/1.1\r\nHost: 127.0.0.1:{rig.server.port}\r\nConnection: close\r\n\r\n".encode())
        answer = await asyncio.wait_for(reader.read(), WITHIN_S)
        writer.close()
        assert re.match(rb"HTTP/1.1 40[34]", answer), answer[:80]

    with_rig(scenario)


def test_garbage_on_the_control_connection_is_answered_and_the_stop_after_it_is_heard() -> None:
    async def scenario(rig: Rig) -> None:
        async with page(rig, take=True) as client:
            for text in (
                "{",
                '{"seq":NaN}',
                "x" * 40000,
                "[" * 3000,
                json.dumps({"type": "stop", "seq": 1, "more": 1}),
            ):
                await client.control.send_str(text)
                answer = await client.until(lambda m: m["type"] == "answer")
                assert answer["ok"] is False
                assert answer["code"] in ("malformed", "oversized")
            await client.control.send_bytes(b"\x00\xff\xfe")
            assert (await client.until(lambda m: m["type"] == "answer"))["code"] == "malformed"
            assert rig.graph.named("stop") == []
            assert (await client.ask(type="stop"))["ok"]
        assert rig.graph.named("stop") == [("stop",)]

    with_rig(scenario)


def test_a_page_that_takes_no_messages_is_let_go_and_comes_back_to_what_holds_now() -> None:
    async def scenario(rig: Rig) -> None:
        rig.offer()
        async with page(rig, take=True) as client:
            await client.open_video()
            about, _ = await client.frame()
            await client.ask(type="select", camera="left", stamp=about["stamp"], control="RUN_STOP")

            def backlog() -> None:
                rig.server.runner.run(rig.desk.chosen.clear())  # would be lost with the rest of the queue
                rig.server.runner.run([Broadcast(message={"type": "state", "number": n}) for n in range(300)])

            rig.server.mailbox.each(backlog)
            await until(lambda: rig.desk.lease.holder == "", "its connection has ended")
            assert (await client.open())["selection"] is None

    with_rig(scenario)


def test_a_monstrous_frame_ends_that_connection_only() -> None:
    async def scenario(rig: Rig) -> None:
        async with page(rig) as client, page(rig) as other:
            await client.control.send_str("x" * 200_000)
            while not client.control.closed:
                await client.control.receive(timeout=WITHIN_S)
            assert client.control.close_code == aiohttp.WSCloseCode.MESSAGE_TOO_BIG
            assert (await other.ask(type="stop"))["ok"]

    with_rig(scenario)


def test_too_large_posts_are_refused() -> None:
    async def scenario(rig: Rig) -> None:
        data = {"token": "x" * 9000}
        headers = {"Origin": rig.url}
        async with page(rig) as client, client.session.post("/sign-in", data=data, headers=headers) as answer:
            assert answer.status == 413
        await still_there(rig)

    with_rig(scenario)


# --- commands ---


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
            assert "no space left" in failed["entry"]["reason"]
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
        rig.graph.refuses = "no gantry controller listens"
        async with page(rig, take=True) as client:
            await client.ask(type="call", service="home")
            failed = await client.until(lambda m: m["type"] == "log" and m["entry"]["status"] == "failed")
            assert failed["entry"]["reason"] == "no gantry controller listens"

    with_rig(scenario)


def test_a_service_is_called_and_answered() -> None:
    async def scenario(rig: Rig) -> None:
        async with page(rig, take=True) as client:
            await client.ask(type="call", service="enable")
            done = await client.until(lambda m: m["type"] == "log" and m["entry"]["status"] == "done")
            assert (done["entry"]["action"], done["entry"]["reason"]) == ("enable", "as you wish")
        assert rig.graph.named("call") == [("call", "enable")]

    with_rig(scenario)


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


# --- video ---


def test_nothing_is_encoded_while_nobody_watches_and_once_for_all_who_do() -> None:
    async def scenario(rig: Rig) -> None:
        for _ in range(5):
            rig.offer()
        async with page(rig, control=False) as one, page(rig, control=False) as two, page(rig, control=False) as right:
            assert rig.server.video.encoded == 0
            await one.open_video()
            await one.frame()
            assert rig.server.video.encoded == 1
            await two.open_video()
            await two.frame()
            await right.open_video(camera="right")
            for level in (40, 200):
                begin_s = time.monotonic()
                stamp = rig.offer(level=level)
                for client in (one, two):
                    about, jpeg = await client.frame()
                    now_s = time.monotonic()
                    took_ms = (now_s - begin_s) * 1e3 + 1
                    assert (about["stamp"], about["width"], about["height"]) == (str(stamp), 128, 72)
                    picture = cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_COLOR)
                    assert abs(float(picture.mean()) - level) < 2
                    assert -1 < about["age_ms"] < took_ms
                    assert 0 <= now_s * 1e3 - about["sent_ms"] + 0.1 < took_ms
            assert rig.server.video.encoded == 3
            rig.offer("right", level=120)
            await right.frame()
            assert rig.server.video.encoded == 4

    with_rig(scenario)


def test_a_page_that_does_not_draw_gets_two_pictures_and_does_not_slow_another() -> None:
    async def scenario(rig: Rig) -> None:
        async with page(rig, control=False) as stalled, page(rig, control=False) as good:
            await stalled.open_video()
            await good.open_video()
            got = []
            for _ in range(6):
                rig.offer()
                about, _ = await good.frame()
                got.append(about["seq"])
            assert len(set(got)) == 6
            first, _ = await stalled.frame(acknowledge=False)
            second, _ = await stalled.frame(acknowledge=False)
            assert first["seq"] < second["seq"] <= got[-1]
            await stalled.video.send_str(json.dumps({"drawn": second["seq"]}))
            newest, _ = await stalled.frame()
            assert newest["seq"] == got[-1], "what it missed in between is never sent"

    with_rig(scenario)


def test_the_overlay_comes_with_the_first_picture_and_again_when_the_panel_moves() -> None:
    async def scenario(rig: Rig) -> None:
        corners = np.array([[1.04, 2.0], [np.nan, 1.0], [5.0, 6.5]], np.float32)
        edges = np.array([[1, 1, 0], [9, 1, 0], [9, 4, 0], [3, 3, 1], [4, 4, 1], [7, 7, 2]], np.float32)
        async with page(rig, control=False) as client:
            stamp = rig.offer()
            rig.server.mailbox.each(rig.desk.scene.layers.take, "corners", "left", stamp, corners)
            rig.server.mailbox.each(rig.desk.scene.layers.take, "edges", "left", stamp - 10**8, edges)
            await client.open_video(corners=True, edges=True)
            await until(lambda: rig.server.video.wanted == {("corners", "left"), ("edges", "left")}, "the wish")
            about, _ = await client.frame()
            assert [control["name"] for control in about["panel"]["controls"]] == ["RUN_STOP", "CH1_SCALE", "CH1_IN"]
            rig.offer(stamp_ns=stamp + 10**8)  # the encoder may start slower than corners get too old
            about, _ = await client.frame()
            assert "panel" not in about
            assert about["corners"] == [1.0, 2.0, 5.0, 6.5]
            assert about["edges"] == [[1, 1, 9, 1, 9, 4], [3, 3, 4, 4]], "a single point is no line"
            await client.video.send_str('{"camera":"left","corners":true,"edges":false}')
            await until(lambda: rig.server.video.wanted == {("corners", "left")}, "fewer layers")
            rig.offer(stamp_ns=stamp + 2 * 10**9)
            about, _ = await client.frame()
            assert about["corners"] == [] and "edges" not in about, "what is older than the picture is not shown"
            rig.server.mailbox.each(rig.desk.scene.changed)
            rig.offer()
            about, _ = await client.frame()
            assert about["panel"]["version"] == rig.desk.scene.version
        await until(lambda: rig.server.video.wanted == frozenset(), "nobody looks any more")

    with_rig(scenario)


def test_bad_video_messages_are_answered() -> None:
    async def scenario(rig: Rig) -> None:
        async with page(rig, control=False) as client:
            await client.open_video()
            for text in (
                "{",
                '{"drawn":"1"}',
                '{"camera":"up","corners":true}',
                '{"camera":"left","edges":1}',
                "y" * 40000,
            ):
                await client.video.send_str(text)
                answer = json.loads((await client.video.receive(timeout=WITHIN_S)).data)
                assert answer["code"] in ("malformed", "oversized")
            rig.offer()
            await client.frame()

    with_rig(scenario)


def test_a_picture_nobody_can_look_at_is_skipped() -> None:
    async def scenario(rig: Rig) -> None:
        async with page(rig, control=False) as client:
            await client.open_video()
            odd = np.zeros((8, 8), np.uint8)
            rig.server.mailbox.newest("left", rig.server.video.offer, "left", 1, "bayer_rggb8", odd)
            await still_there(rig)
            stamp = rig.offer()
            about, _ = await client.frame()
            assert about["stamp"] == str(stamp)

    with_rig(scenario)


# --- life ---


def test_a_port_in_use_is_said_with_its_number() -> None:
    with Rig() as first, pytest.raises(ConfigError, match=rf"127\.0\.0\.1:{first.server.port}"):
        Rig(port=first.server.port)


@pytest.mark.parametrize("content", [None, b"no certificate"])
def test_a_missing_or_broken_certificate_is_said_with_its_name(tmp_path: Path, content: bytes | None) -> None:
    certificate, key = tmp_path / "a.pem", tmp_path / "b.pem"
    if content is not None:
        certificate.write_bytes(content)
        key.write_bytes(content)
    with pytest.raises(ConfigError, match=rf"cannot serve.*tls_certificate = '{certificate}', tls_key = '{key}': .+"):
        Rig(tls_certificate=str(certificate), tls_key=str(key))


def test_closing_the_server_ends_open_connections() -> None:
    async def scenario(rig: Rig) -> None:
        async with page(rig) as client:
            closing = asyncio.get_running_loop().run_in_executor(None, rig.server.close)
            while not client.control.closed:
                await client.control.receive(timeout=WITHIN_S)
            assert client.control.close_code == aiohttp.WSCloseCode.GOING_AWAY
            await closing
        assert not rig.server.alive

    with_rig(scenario)


def test_the_stop_with_which_the_bridge_ends_is_recorded_though_the_disk_is_slow(tmp_path: Path) -> None:
    path = tmp_path / "audit.jsonl"

    class SlowDisk(AuditFile):
        def append(self, record: dict[str, Any]) -> None:
            assert written.wait(WITHIN_S)
            super().append(record)

    async def scenario(rig: Rig) -> None:
        async with page(rig, take=True) as client:
            rig.server.mailbox.each(rig.desk.machine.set_state, "driver", "moving")
            await client.until(lambda m: m["type"] == "state" and m["moving"])
            written.clear()
            async with client.session.post("/sign-in", data={"token": "wrong"}, headers=client.origin) as answer:
                assert answer.status == 401  # what is still being written when the bridge ends
            closing = asyncio.get_running_loop().run_in_executor(None, rig.server.close)
            while not client.control.closed:
                await client.control.receive(timeout=WITHIN_S)
            await until(lambda: not rig.server.alive, "the server's thread ends")
            assert len(rig.graph.named("stop")) == 1
            written.set()
            await closing

    written = threading.Event()
    written.set()
    try:
        with_rig(scenario, audit=SlowDisk(path))
    finally:
        written.set()
    lines = path.read_text().splitlines()
    assert verify(lines)[0] == len(lines)
    found = [json.loads(line) for line in lines]
    stop, lost = found[3:5]
    begun = ["sign-in", "take control", "sign-in", "stop", "lose control"]
    assert [entry["command"] for entry in found[:5]] == begun
    assert stop["who"] == "Watchdog"
    assert stop["target"] in ("stopped_page_gone", "stopped_link_lost"), "what the bridge hears of its own end"
    assert (lost["who"], lost["reason"]) == (found[1]["who"], stop["target"][len("stopped_") :].replace("_", " "))
    assert {entry["command"] for entry in found[5:]} <= {"stop"}, "nothing is later but what the driver has answered"


def test_what_is_to_be_recorded_after_the_end_is_told_and_hurts_nobody(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path = tmp_path / "audit.jsonl"
    with Rig(audit=AuditFile(path)) as rig:
        rig.server.close()
        rig.server.door.turned_away.note("127.0.0.1", "sign-in", "wrong_token")
    assert path.read_text() == ""
    assert "the record could not be written" in caplog.text
