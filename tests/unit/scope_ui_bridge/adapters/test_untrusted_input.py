"""Attacks: foreign origins and hosts, garbage, large messages."""

from __future__ import annotations

import asyncio
import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import aiohttp
import pytest
from unit.scope_ui_bridge.web_rig import WITHIN_S, Rig, page, until, with_rig

from scope_ui_bridge.adapters.secret_files import AuditFile
from scope_ui_bridge.core.effects import Broadcast

pytestmark = pytest.mark.slow


def records(path: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in path.read_text().rpartition("\n")[0].splitlines()]


async def still_there(rig: Rig) -> None:
    async with aiohttp.ClientSession(rig.url) as session, session.get("/session") as answer:
        assert answer.status == 401


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


def test_refused_messages_are_recorded_with_who_sent_them(tmp_path: Path) -> None:
    path = tmp_path / "audit.jsonl"

    def refused() -> Iterator[dict[str, Any]]:
        return (entry for entry in records(path) if entry["command"].startswith("message "))

    async def scenario(rig: Rig) -> None:
        async with page(rig, take=True) as client:
            await client.ask(type="call", service="enable")
            await until(lambda: rig.graph.named("call"), "the call goes out")
            old = {"type": "call", "service": "home", "boot": "boot", "epoch": rig.desk.lease.epoch, "seq": 1}
            for change in ({}, {"seq": 1000, "epoch": 0}, {"seq": 1001, "boot": "another"}):
                await client.control.send_str(json.dumps(old | change))
                await client.until(lambda m: m["type"] == "answer" and not m["ok"])
            await client.control.send_str('{"type":"act","seq":NaN}')
            await client.until(lambda m: m["type"] == "answer" and not m["ok"])
            assert rig.graph.named("call") == [("call", "enable")]
            await until(lambda: len(list(refused())) >= 4, "the record")

    with_rig(scenario, audit=AuditFile(path))
    found = {entry["command"]: entry["who"] for entry in refused()}
    kinds = ("replayed", "stale_epoch", "old_boot", "malformed")
    assert found == {f"message {kind}": "Operator 1" for kind in kinds}
