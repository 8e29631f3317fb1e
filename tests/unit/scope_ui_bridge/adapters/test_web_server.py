"""Start and end of the server."""

from __future__ import annotations

import asyncio
import json
import threading
from concurrent.futures import ThreadPoolExecutor
from concurrent.futures import TimeoutError as StillWaiting
from pathlib import Path
from typing import Any

import aiohttp
import pytest
from unit.scope_ui_bridge.web_rig import WITHIN_S, Rig, page, until, with_rig

from icu_common.core.configuration.config import ConfigError
from scope_ui_bridge.adapters.secret_files import AuditFile
from scope_ui_bridge.core.records import verify


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


def test_closing_a_server_whose_thread_is_ending_waits_for_that_end(monkeypatch: pytest.MonkeyPatch) -> None:
    closed, may_end = threading.Event(), threading.Event()

    class EndsLate(asyncio.SelectorEventLoop):
        def close(self) -> None:
            super().close()
            closed.set()
            may_end.wait(WITHIN_S)

    monkeypatch.setattr(asyncio, "new_event_loop", EndsLate)
    server = Rig().server
    with ThreadPoolExecutor() as pool:
        server._loop.call_soon_threadsafe(server._closing.set)
        assert closed.wait(WITHIN_S)
        closing = pool.submit(server.close)  # the loop is closed and its thread still alive
        with pytest.raises(StillWaiting):
            closing.result(timeout=0.2)
        may_end.set()
        closing.result(WITHIN_S)
    assert not server.alive


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
