"""Floods of an operator page's server, each from a process of its own.

``python tests/support/page_floods.py NAME URL COOKIE SECONDS`` floods with an observer's cookie. It prints the
numbers of sent messages and of answers as JSON.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import resource
import socket
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Awaitable, Callable, Iterator
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import aiohttp

BIG = '{"seq":1,"type":"call","boot":"boot","epoch":0,"more":[' + "{}," * 10_880 + "1]}"
"""32 kB of empty objects: the slowest input for a strict parser."""
EVE = {"name": "eve", "password": "battery staple"}
HEIGHT = 6
"""Number of results after which a flood counts as begun."""


class Flood:
    """Target of a flood, its credentials, and counts of the results."""

    def __init__(self, url: str, cookie: str) -> None:
        self.url, self.cookie = url.rstrip("/"), cookie
        self.headers = {"Origin": self.url, "Cookie": cookie}
        self.counts: Counter[str] = Counter()

    def session(self) -> aiohttp.ClientSession:
        """Return a session of a client without a limit of its connections."""
        return aiohttp.ClientSession(connector=aiohttp.TCPConnector(limit=0), timeout=aiohttp.ClientTimeout(10.0))

    async def socket(self, session: aiohttp.ClientSession, path: str) -> aiohttp.ClientWebSocketResponse | None:
        """Open a WebSocket and count it; None after a refusal."""
        try:
            made = await session.ws_connect(self.url + path, headers=self.headers, autoping=False, max_msg_size=0)
        except (aiohttp.ClientError, asyncio.TimeoutError) as error:
            self.counts[f"refused {getattr(error, 'status', type(error).__name__)}"] += 1
            await asyncio.sleep(0.02)
            return None
        self.counts[f"opened {path}"] += 1
        return made

    async def ask(self, session: aiohttp.ClientSession, method: str, path: str, **more: Any) -> None:
        """Send a request, read its answer, and count its status."""
        try:
            async with session.request(method, self.url + path, **more) as answer:
                self.counts[f"answered {answer.status}"] += 1
                await answer.read()
        except (aiohttp.ClientError, asyncio.TimeoutError, ConnectionError) as error:
            self.counts[f"no answer: {type(error).__name__}"] += 1
            await asyncio.sleep(0.005)

    def raw(self) -> tuple[str, int]:
        """Return the server's host and port."""
        parts = urlsplit(self.url)
        return parts.hostname or "", parts.port or 80


async def _on_sockets(flood: Flood, count: int, path: str, send: Callable[[Any], Awaitable[None]]) -> None:
    async def one() -> None:
        async with flood.session() as session:
            while True:
                if (made := await flood.socket(session, path)) is None:
                    continue
                drain = asyncio.ensure_future(_drain(made))
                with contextlib.suppress(ConnectionError, aiohttp.ClientError):
                    while not made.closed:
                        await send(made)
                        flood.counts["sent"] += 1
                drain.cancel()

    await asyncio.gather(*(one() for _ in range(count)))


async def _drain(made: aiohttp.ClientWebSocketResponse) -> None:
    async for _ in made:
        pass


async def messages(flood: Flood) -> None:
    """Send 240 messages of 32 kB a second on six connections."""

    async def send(made: Any) -> None:
        await made.send_str(BIG)
        await asyncio.sleep(0.025)

    await _on_sockets(flood, 6, "/control", send)


async def small_messages(flood: Flood) -> None:
    """Send short messages as fast as six connections can."""

    async def send(made: Any) -> None:
        for _ in range(50):
            await made.send_str('{"type":"alive","seq":1}')
        await asyncio.sleep(0)

    await _on_sockets(flood, 6, "/control", send)


async def stops(flood: Flood) -> None:
    """Stop repeatedly, as every signed-in person may."""

    async def send(made: Any) -> None:
        for number in range(20):
            await made.send_str(json.dumps({"type": "stop", "seq": number, "boot": "boot", "epoch": 0}))
        await asyncio.sleep(0)

    await _on_sockets(flood, 6, "/control", send)


async def pings(flood: Flood) -> None:
    """Send WebSocket pings."""

    async def send(made: Any) -> None:
        for _ in range(50):
            await made.ping(b"x" * 100)
        await asyncio.sleep(0)

    await _on_sockets(flood, 6, "/control", send)


async def videos(flood: Flood) -> None:
    """Keep 47 video connections open and read them."""

    async def send(made: Any) -> None:
        await made.send_str(json.dumps({"camera": "left"}))
        await asyncio.sleep(0.2)

    await _on_sockets(flood, 47, "/video", send)


async def _asking(flood: Flood, count: int, method: str, path: str, pause_s: float, **more: Any) -> None:
    async def one() -> None:
        async with flood.session() as session:
            while True:
                await flood.ask(session, method, path, **more)
                await asyncio.sleep(pause_s)

    await asyncio.gather(*(one() for _ in range(count)))


async def sign_ins(flood: Flood) -> None:
    """Sign in with the observer's own password, eight times a second."""
    await _asking(flood, 1, "POST", "/sign-in", 0.02, data=EVE, headers={"Origin": flood.url})


async def passwords(flood: Flood) -> None:
    """Guess at the operator's password from the same address, on twenty connections."""
    guess = {"name": "ada", "password": "0123456789"}
    await _asking(flood, 20, "POST", "/sign-in", 0.02, data=guess, headers={"Origin": flood.url})


async def tokens(flood: Flood) -> None:
    """Guess at tokens, some hundred a second."""
    await _asking(flood, 10, "POST", "/sign-in", 0.01, data={"token": "guess"}, headers={"Origin": flood.url})


async def bodies(flood: Flood) -> None:
    """Send bodies that do not match their head."""
    headers = {"Origin": flood.url, "Content-Encoding": "gzip", "Content-Type": "application/x-www-form-urlencoded"}
    await _asking(flood, 10, "POST", "/sign-in", 0.0, data=b"token=" + b"x" * 2000, headers=headers)


async def requests(flood: Flood) -> None:
    """Request files as the observer, as fast as twenty connections can."""
    await _asking(flood, 20, "GET", "/page/language/en.ftl", 0.0, headers=flood.headers)


async def pipelined(flood: Flood) -> None:
    """Send requests in a row without reading an answer, on forty connections without a sign-in."""
    host, port = flood.raw()
    head = f"GET /session HTTP/1.1\r\nHost: {host}:{port}\r\n\r\n".encode() * 200

    async def one() -> None:
        while True:
            with contextlib.suppress(OSError):
                _, writer = await asyncio.open_connection(host, port)
                with contextlib.closing(writer):
                    while True:
                        writer.write(head)
                        flood.counts["sent"] += 200
                        await asyncio.wait_for(writer.drain(), 0.5)
                        await asyncio.sleep(0.005)
            await asyncio.sleep(0.01)

    await asyncio.gather(*(_again(one) for _ in range(40)))


async def _again(one: Callable[[], Awaitable[None]]) -> None:
    while True:
        with contextlib.suppress(asyncio.TimeoutError):
            await one()


async def connections(flood: Flood) -> None:
    """Open connections as fast as possible and send nothing."""
    await _open_and_keep(flood, b"")


async def kept_connections(flood: Flood) -> None:
    """Open connections, send one request on each, and keep them open."""
    host, port = flood.raw()
    await _open_and_keep(flood, f"GET /session HTTP/1.1\r\nHost: {host}:{port}\r\n\r\n".encode())


async def _open_and_keep(flood: Flood, said: bytes) -> None:
    """Open connections and keep at most two thousand of them open."""
    _, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (hard, hard))
    host, port = flood.raw()
    kept: list[socket.socket] = []
    loop = asyncio.get_running_loop()
    while True:
        made = socket.socket()
        made.setblocking(False)
        try:
            await asyncio.wait_for(loop.sock_connect(made, (host, port)), 1.0)
            flood.counts["opened"] += 1
            await loop.sock_sendall(made, said)
        except (OSError, asyncio.TimeoutError) as error:
            flood.counts[type(error).__name__] += 1
            await asyncio.sleep(0.01)
        kept.append(made)
        if len(kept) > min(2000, hard - 100):
            kept.pop(0).close()


FLOODS: dict[str, Callable[[Flood], Awaitable[None]]] = {
    flood.__name__: flood
    for flood in (messages, small_messages, stops, pings, videos, sign_ins, passwords)
    + (tokens, bodies, requests, pipelined, connections, kept_connections)
}


@contextlib.contextmanager
def flooded(name: str, url: str, cookie: str, seconds: float = 60.0) -> Iterator[subprocess.Popen[str]]:
    """Run a flood in a process of its own, from its first results on; :func:`result` ends it and reads its counts."""
    command = [sys.executable, str(Path(__file__)), name, url, cookie, str(seconds)]
    process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    assert process.stdout.readline() == "begun\n"
    try:
        yield process
    finally:
        process.kill()
        process.wait()


def result(process: subprocess.Popen[str]) -> dict[str, int]:
    """End a flood and return what it counted."""
    told, _ = process.communicate("\n", timeout=30.0)
    return dict(json.loads(told))


async def _run(name: str, flood: Flood, seconds: float) -> None:
    work = asyncio.ensure_future(FLOODS[name](flood))
    while sum(flood.counts.values()) < HEIGHT and not work.done():
        await asyncio.sleep(0.01)
    print("begun", flush=True)
    told = asyncio.get_running_loop().run_in_executor(None, sys.stdin.readline)
    begin_s = time.monotonic()
    await asyncio.wait([work, told], timeout=seconds, return_when=asyncio.FIRST_COMPLETED)
    if work.done():
        work.result()
    flood.counts["seconds"] = round(time.monotonic() - begin_s)
    print(json.dumps(flood.counts), flush=True)
    os._exit(0)


if __name__ == "__main__":
    asyncio.run(_run(sys.argv[1], Flood(*sys.argv[2:4]), float(sys.argv[4])))
