"""Measure a STOP while the page's server is flooded: the time to the answer, and to the driver's byte at the board.

The operator is a client without a browser that has control and sends keep-alives. It stops by a request and by the
WebSocket, as the page does. Each flood (tests/support/page_floods.py) is a process of its own, of an observer or of a
stranger.
"""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import json
import time
from collections.abc import AsyncIterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import aiohttp
import numpy as np
from rows import Row, bound
from support import page_floods
from system.machine_rig import MachineRig

from scope_ui_bridge.adapters.secret_files import write_secret
from scope_ui_bridge.core.access import new_user

ADA, EVE = {"name": "ada", "password": "correct horse"}, page_floods.EVE
_APART_S = 0.6  # a stop of the same person within half a second counts as the same stop


def write_passwords(folder: Path) -> None:
    """Write the accounts of an operator and an observer; call it before the bridge starts."""
    users = [
        new_user("ada", "operator", ADA["password"], b"a" * 16),
        new_user("eve", "viewer", EVE["password"], b"e" * 16),
    ]
    write_secret(folder / "passwords", "\n".join(user.line() for user in users))


@contextlib.asynccontextmanager
async def _signed_in(url: str, form: dict[str, str]) -> AsyncIterator[aiohttp.ClientSession]:
    jar = aiohttp.CookieJar(unsafe=True)
    async with aiohttp.ClientSession(url, cookie_jar=jar, headers={"Origin": url}) as session:
        async with session.post("/sign-in", data=form) as answer:
            assert answer.status == 200, await answer.text()
        yield session


class _Operator:
    """A client in control that sends keep-alives."""

    def __init__(self, session: aiohttp.ClientSession) -> None:
        self.session = session
        self._seq = itertools.count(1)
        self._answers: dict[int, asyncio.Future[float]] = {}

    async def __aenter__(self) -> _Operator:
        self._control = await self.session.ws_connect("/control", max_msg_size=0)
        hello = json.loads((await self._control.receive(timeout=10.0)).data)
        self._boot, self._epoch, self._driver = hello["boot"], hello["state"]["lease"]["epoch"], ""
        self._tasks = [asyncio.create_task(self._hear()), asyncio.create_task(self._live())]
        await self.ask(type="lease", step="take")
        await self.ready()
        return self

    async def ready(self) -> None:
        """Make the driver idle; a stop then sends a hold to the board."""
        deadline = time.monotonic() + 60.0
        asked, asked_s = "", 0.0
        while (found := self._driver) != "idle":
            assert time.monotonic() < deadline, f"the driver is {found!r}"
            wanted = {"stopped": ["reset"], "disabled": ["enable"], "unhomed": ["enable", "home"]}
            if found != asked or time.monotonic() - asked_s > 3.0:
                asked, asked_s = found, time.monotonic()
                for service in wanted.get(found, []):
                    await self.ask(type="call", service=service)
                    await asyncio.sleep(0.2)
            await asyncio.sleep(0.05)

    async def __aexit__(self, *error: object) -> None:
        await self.ask(type="lease", step="release")
        for task in self._tasks:
            task.cancel()
        await self._control.close()

    async def _hear(self) -> None:
        async for message in self._control:
            told = json.loads(message.data)
            if told["type"] == "state":
                self._epoch, self._driver = told["lease"]["epoch"], told["driver"]["state"]
            waiting = self._answers.pop(told.get("seq"), None) if told["type"] == "answer" else None
            if waiting is not None and not waiting.done():
                waiting.set_result(time.monotonic())

    async def _live(self) -> None:
        while True:
            await self._send(type="alive", client_ms=0.0)
            await asyncio.sleep(0.1)

    async def _send(self, **fields: object) -> int:
        seq = next(self._seq)
        await self._control.send_str(json.dumps({**fields, "seq": seq, "boot": self._boot, "epoch": self._epoch}))
        return seq

    async def ask(self, **fields: object) -> float:
        """Send a message; return the seconds to its answer."""
        begin_s = time.monotonic()
        seq = await self._send(**fields)
        self._answers[seq] = asyncio.get_running_loop().create_future()
        return await asyncio.wait_for(self._answers[seq], 20.0) - begin_s

    async def stop(self, press: str) -> float:
        """Stop by a request; return the seconds to its answer."""
        begin_s = time.monotonic()
        async with self.session.post("/stop", params={"press": press}) as answer:
            assert answer.status == 200
        return time.monotonic() - begin_s


async def _measure(rig: MachineRig, name: str, count: int) -> list[Row]:
    url = f"http://127.0.0.1:{rig.graph.port}"
    answers, ways = [], []
    async with _signed_in(url, ADA) as ada, _signed_in(url, EVE) as eve, _Operator(ada) as operator:
        (cookie,) = eve.cookie_jar
        flooding = page_floods.flooded(name, url, f"{cookie.key}={cookie.value}") if name else contextlib.nullcontext()
        with flooding as flood:
            await asyncio.sleep(1.0)
            for number in range(count):
                if name == "stops":  # the machine stays stopped, so its hold may be another client's
                    answers.append(await operator.stop(f"{name}-{number}"))
                    await asyncio.sleep(_APART_S)
                    continue
                since, begin_s = rig.board.mark(), time.monotonic()
                answers.append(await operator.stop(f"{name}-{number}"))
                halted_s = await asyncio.get_running_loop().run_in_executor(None, rig.halted_s, since)
                ways.append(halted_s - begin_s)
                answers += [await operator.ask(type="stop", press=f"{name}-{number}") for _ in range(3)]
                await asyncio.sleep(_APART_S)
                await operator.ready()
            counts = page_floods.result(flood) if flood is not None else {}
    what = f"flood of {name.replace('_', ' ')}" if name else "no flood"
    (p50, p99), (way50, way99) = (np.percentile(np.array(found or [0.0]) * 1e3, [50, 99]) for found in (answers, ways))
    print(
        f"{what}: answer p50 {p50:.1f}, p99 {p99:.1f} ms of {len(answers)}; board p50 {way50:.1f}, p99 {way99:.1f} ms"
    )
    print(f"  {counts}")
    rows = [bound(f"{what}: STOP to its answer, p99 [ms]", float(p99), 50.0)]
    return [*rows, bound(f"{what}: STOP to the driver's byte, p99 [ms]", float(way99), 50.0)] if ways else rows


def floods(rig: MachineRig, count: int) -> list[Row]:
    """Return the rows of all floods, preceded by those without a flood."""
    rows: list[Row] = []
    with ThreadPoolExecutor(1) as thread:  # playwright's loop runs in this one
        for name in ("", *page_floods.FLOODS):
            rows += thread.submit(asyncio.run, _measure(rig, name, count)).result()
            time.sleep(5.5)  # sign-ins of one account are limited to one in 5 s
    return rows
