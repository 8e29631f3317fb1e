"""Connections under attack: slow, silent or many of them; and STOP is served meanwhile."""

from __future__ import annotations

import asyncio
import errno
import json
import shutil
import socket
import ssl
import time
from pathlib import Path
from typing import Any

import pytest
from unit.scope_ui_bridge.web_rig import WITHIN_S, Rig, page, until, with_rig

from scope_ui_bridge.adapters.secret_files import AuditFile
from scope_ui_bridge.adapters.web import front_door, listener
from scope_ui_bridge.cli import page_admin


def records(path: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in path.read_text().rpartition("\n")[0].splitlines()]


async def ended(reader: asyncio.StreamReader) -> None:
    try:
        await asyncio.wait_for(reader.read(), WITHIN_S)
    except ConnectionError:
        pass


@pytest.mark.parametrize("tls", [False, True])
def test_slow_and_silent_connections_are_ended_and_stop_is_served_meanwhile(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, tls: bool
) -> None:
    monkeypatch.setattr(front_door, "_SPEAK_WITHIN_S", 1.0)
    monkeypatch.setattr(front_door, "_BODY_TIMEOUT_S", 1.0)
    path = tmp_path / "audit.jsonl"
    encrypted: ssl.SSLContext | None = None
    options = {}
    if tls:
        if shutil.which("openssl") is None:
            pytest.skip("openssl is not installed")
        page_admin.make_certificate(["127.0.0.1"], tmp_path / "tls")
        key, certificate = tmp_path / "tls" / "key.pem", tmp_path / "tls" / "certificate.pem"
        encrypted = ssl.create_default_context(cafile=str(certificate))
        options = {"tls_key": str(key), "tls_certificate": str(certificate)}

    async def scenario(rig: Rig) -> None:
        host = f"Host: 127.0.0.1:{rig.server.port}\r\n"
        beginnings = ["", "G", f"GET / HTTP/1.1\r\n{host}X-Slow: "] * 15
        form = "Content-Type: application/x-www-form-urlencoded\r\nContent-Length: 900\r\n"
        post = f"POST /sign-in HTTP/1.1\r\n{host}Origin: {rig.url}\r\n{form}\r\ntoken="
        async with page(rig, take=True) as client:
            pairs = []
            if tls:  # nothing, or a part of the first message, and never a key
                for data in [b"", b"\x16\x03\x01\x02\x00\x01"] * 15:
                    reader, writer = await asyncio.open_connection("127.0.0.1", rig.server.port)
                    writer.write(data)
                    pairs.append((reader, writer))
            for text in [*beginnings, post]:
                reader, writer = await asyncio.open_connection("127.0.0.1", rig.server.port, ssl=encrypted)
                writer.write(text.encode())
                pairs.append((reader, writer))
            took_s = []
            for _ in range(3):  # one may be held up by what else the computer does
                begin = time.monotonic()
                assert (await client.ask(type="stop"))["ok"]
                took_s.append(time.monotonic() - begin)
            assert min(took_s) < 1.0
            assert rig.graph.named("stop")
            await asyncio.gather(*(ended(reader) for reader, _ in pairs[:-1]))
            answer = await asyncio.wait_for(pairs[-1][0].readuntil(b"\r\n"), WITHIN_S)
            assert answer.startswith(b"HTTP/1.1 408")
            for _, writer in pairs:
                writer.close()
            async with client.session.get("/session") as still:
                assert still.status == 200

    with_rig(scenario, audit=AuditFile(path), **options)
    assert any(entry["command"] == "connection" for entry in records(path))


@pytest.mark.parametrize("tls", [False, True])
def test_a_crowd_of_silent_connections_leaves_room_for_a_stop(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, tls: bool
) -> None:
    options: dict[str, Any] = {"max_viewers": 5}
    if tls:
        if shutil.which("openssl") is None:
            pytest.skip("openssl is not installed")
        page_admin.make_certificate(["127.0.0.1"], tmp_path / "tls")
        files = {"tls_key": "tls/key.pem", "tls_certificate": "tls/certificate.pem"}
        options |= {name: str(tmp_path / file) for name, file in files.items()}
    monkeypatch.setattr(listener, "MAX_CONNECTIONS", 20)

    async def scenario(rig: Rig) -> None:
        async with page(rig) as client:
            pairs = [await asyncio.open_connection("127.0.0.1", rig.server.port) for _ in range(40)]
            await asyncio.gather(*(ended(reader) for reader, _ in pairs[:20]))
            for _, writer in pairs:
                writer.close()
            async with client.session.post("/stop", headers=client.origin) as answer:
                assert answer.status == 200
            async with page(rig) as another:
                assert (await another.ask(type="stop"))["ok"]
        assert rig.graph.named("stop")

    with_rig(scenario, **options)


def test_a_server_without_descriptors_makes_room_and_goes_on(monkeypatch: pytest.MonkeyPatch) -> None:
    failed: list[int] = []

    def accept(listening: socket.socket, real: Any = socket.socket.accept) -> Any:
        if crowd and len(failed) < 3:
            failed.append(len(failed))
            raise OSError(errno.EMFILE, "Too many open files")
        return real(listening)

    crowd: list[Any] = []
    monkeypatch.setattr(socket.socket, "accept", accept)

    async def scenario(rig: Rig) -> None:
        async with page(rig, take=True) as client:
            silent = [await asyncio.open_connection("127.0.0.1", rig.server.port) for _ in range(5)]
            await until(lambda: len(rig.server.door._seen_s) >= 6, "all are accepted")
            crowd.extend(silent)
            async with page(rig) as another:
                assert (await another.ask(type="stop"))["ok"]
            await asyncio.gather(*(ended(reader) for reader, _ in silent[:3]))
            assert (await client.ask(type="stop"))["ok"], "the operator's connection is not closed for a new one"
            for _, writer in silent:
                writer.close()

    with_rig(scenario)
    assert failed == [0, 1, 2]
