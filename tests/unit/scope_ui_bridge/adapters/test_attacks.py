"""Whatever comes is refused and written down, the server lives, and STOP is served right after it."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

import aiohttp
import pytest
from unit.scope_ui_bridge.web_rig import WITHIN_S, Page, Rig, page, until, with_rig

from scope_ui_bridge.adapters.secret_files import AuditFile
from scope_ui_bridge.core.records import verify

Attack = Callable[[Rig, Page], Awaitable[None]]


async def refused_socket(rig: Rig, client: Page, **headers: str) -> None:
    with pytest.raises(aiohttp.WSServerHandshakeError) as caught:
        await client.session.ws_connect("/control", headers=headers)
    assert caught.value.status in (401, 403)


async def no_cookie(rig: Rig, client: Page) -> None:
    async with page(rig, sign_in=False) as stranger:
        await refused_socket(rig, stranger, **stranger.origin)


async def invented_cookie(rig: Rig, client: Page) -> None:
    async with page(rig, sign_in=False) as stranger:
        await refused_socket(rig, stranger, **stranger.origin, Cookie=f"icu_session_{rig.server.port}=invented")


async def wrong_origin(rig: Rig, client: Page) -> None:
    await refused_socket(rig, client, Origin="http://evil.example")


async def null_origin(rig: Rig, client: Page) -> None:
    await refused_socket(rig, client, Origin="null")


async def look_alike_origin(rig: Rig, client: Page) -> None:
    await refused_socket(rig, client, Origin=f"{rig.url}.evil.example")


async def foreign_host(rig: Rig, client: Page) -> None:
    async with client.session.get("/", headers={"Host": "rebound.example"}) as answer:
        assert answer.status == 421


async def replayed_token(rig: Rig, client: Page) -> None:
    async with page(rig, sign_in=False) as stranger, stranger.session.get("/", params={"token": rig.token}) as answer:
        assert answer.status == 401


def message(code: str, **change: Any) -> Attack:
    async def attack(rig: Rig, client: Page) -> None:
        await client.ask(type="lease", step="take")
        fields = {"type": "call", "service": "home", "boot": "boot", "epoch": rig.desk.lease.epoch, "seq": 1000}
        await client.control.send_str(json.dumps(fields | change))
        assert (await client.until(lambda m: m["type"] == "answer" and not m["ok"]))["code"] == code

    return attack


async def bytes_that_are_no_text(rig: Rig, client: Page) -> None:
    await client.control.send_bytes(b"\x00\xff\xfe")
    assert (await client.until(lambda m: m["type"] == "answer"))["code"] == "malformed"


async def huge_frame(rig: Rig, client: Page) -> None:
    await client.control.send_str("x" * 200_000)
    while not client.control.closed:
        await client.control.receive(timeout=WITHIN_S)


async def garbage_for_a_frame(rig: Rig, client: Page) -> None:
    transport = client.control.get_extra_info("socket")
    assert transport is not None
    client.control._writer.transport.write(b"\xff" * 64)  # type: ignore[attr-defined]
    while not client.control.closed:
        await client.control.receive(timeout=WITHIN_S)


async def huge_post(rig: Rig, client: Page) -> None:
    async with client.session.post("/sign-in", data={"token": "x" * 9000}, headers=client.origin) as answer:
        assert answer.status == 413


async def path_traversal(rig: Rig, client: Page) -> None:
    reader, writer = await asyncio.open_connection("127.0.0.1", rig.server.port)
    writer.write(f"GET /page/..%2f..%2fsetup.py HTTP/1.1\r\nHost: 127.0.0.1:{rig.server.port}\r\n\r\n".encode())
    assert (await asyncio.wait_for(reader.readline(), WITHIN_S)).split()[1] in (b"403", b"404")
    writer.close()


def raw_body(head: str, body: bytes, path: str = "/sign-in", status: int = 400) -> Attack:
    """Send a body that does not match its head, which no library would send."""

    async def attack(rig: Rig, client: Page) -> None:
        reader, writer = await asyncio.open_connection("127.0.0.1", rig.server.port)
        form = "Content-Type: application/x-www-form-urlencoded\r\n"
        own = f"Host: 127.0.0.1:{rig.server.port}\r\nOrigin: {rig.url}\r\n{form}"
        writer.write(f"POST {path} HTTP/1.1\r\n{own}{head}\r\n".encode() + body)
        assert (await asyncio.wait_for(reader.readline(), WITHIN_S)).split()[1] == str(status).encode()
        writer.close()

    return attack


def form(kind: str, body: bytes) -> Attack:
    async def attack(rig: Rig, client: Page) -> None:
        headers = {**client.origin, "Content-Type": kind}
        async with client.session.post("/sign-in", data=body, headers=headers) as answer:
            assert (answer.status, answer.headers.get("X-Frame-Options")) == (400, "DENY"), await answer.text()

    return attack


async def endless_name(rig: Rig, client: Page) -> None:
    async with client.session.get(f"/page/{'a' * 3000}") as answer:
        assert (answer.status, answer.headers.get("X-Frame-Options")) == (414, "DENY"), await answer.text()


ATTACKS: dict[str, tuple[Attack, str]] = {
    "no cookie": (no_cookie, "/control"),
    "invented cookie": (invented_cookie, "/control"),
    "wrong origin": (wrong_origin, "origin"),
    "null origin": (null_origin, "'null'"),
    "look-alike origin": (look_alike_origin, "evil.example"),
    "foreign host": (foreign_host, "rebound.example"),
    "replayed token": (replayed_token, "sign-in"),
    "replayed command": (message("replayed", seq=0), "message replayed"),
    "stale lease": (message("stale_epoch", epoch=0), "message stale_epoch"),
    "old boot id": (message("old_boot", boot="another"), "message old_boot"),
    "oversized": (message("oversized", service="x" * 40000), "message oversized"),
    "not a number": (message("malformed", epoch=float("nan")), "message malformed"),
    "bytes": (bytes_that_are_no_text, "message malformed"),
    "huge frame": (huge_frame, "frame"),
    "garbage for a frame": (garbage_for_a_frame, "frame"),
    "huge post": (huge_post, "413"),
    "path traversal": (path_traversal, "setup.py"),
    "endless name": (endless_name, "path of 3006 characters"),
    **{
        f"{name} that is none": (
            raw_body(f"Content-Encoding: {name}\r\nContent-Length: 1\r\n", b"x", status=415),
            "body",
        )
        for name in ("gzip", "deflate", "br", "GZip")
    },
    "escapes in a head": (raw_body("X-Colour: \x1b[31m\r\nContent-Length: 1\r\n", b"x"), "400"),
    "gzip for a stop": (raw_body("Content-Encoding: gzip\r\nContent-Length: 4\r\n", b"a=bc", "/stop", 415), "body"),
    "chunk of no size": (raw_body("Transfer-Encoding: chunked\r\n", b"zz\r\ntoken\r\n"), "chunk size"),
    "chunk that is longer": (raw_body("Transfer-Encoding: chunked\r\n", b"5\r\ntokenXX\r\n"), "400"),
    "length below zero": (raw_body("Content-Length: -4\r\n", b""), "400"),
    "two lengths": (raw_body("Content-Length: 4\r\nTransfer-Encoding: chunked\r\n", b"0\r\n\r\n"), "400"),
    "many fields": (raw_body("Content-Length: 59\r\n", b"&".join([b"a=1"] * 15)), "not a readable form"),
    "bytes behind a percent": (raw_body("Content-Length: 12\r\n", b"token=%ff%fe"), "not a readable form"),
    "form without its boundary": (form("multipart/form-data", b"token=a"), "/sign-in"),
    "form that is cut off": (form("multipart/form-data; boundary=x", b"--x\r\nfoo"), "/sign-in"),
    "field without a name": (
        form("multipart/form-data; boundary=x", b"--x\r\nContent-Disposition: form-data\r\n\r\na\r\n--x--\r\n"),
        "/sign-in",
    ),
    "form in an unknown encoding": (form("application/x-www-form-urlencoded; charset=no", b"token=a"), "/sign-in"),
    "form that is no UTF-8": (form("application/x-www-form-urlencoded", b"token=\xff"), "/sign-in"),
}


@pytest.mark.parametrize("name", ATTACKS)
def test_it_is_refused_written_down_and_survived(name: str, tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    attack, named = ATTACKS[name]
    path = tmp_path / "audit.jsonl"

    async def scenario(rig: Rig) -> None:
        async with page(rig) as victim, page(rig) as attacker:
            await attack(rig, attacker)
            assert rig.graph.named("call") == rig.graph.named("stop") == []
            await until(lambda: named in path.read_text(), f"{named!r} in the record")
            assert (await victim.ask(type="stop"))["ok"]
            async with victim.session.post("/stop", headers=victim.origin) as answer:
                assert answer.status == 200
        assert rig.graph.named("stop")[0] == ("stop",)

    with_rig(scenario, audit=AuditFile(path))
    assert any(named.removeprefix("message ") in record.getMessage() for record in caplog.records)
    assert not any(record.exc_info for record in caplog.records), "an attack is no failure of ours"
    assert not any(character in record.getMessage() for record in caplog.records for character in "\x1b\r\n")
    with path.open() as lines:
        verify(lines)
