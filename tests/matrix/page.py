"""A signed-in page without a browser: what it shows of the machine, with the time of each change."""

from __future__ import annotations

import asyncio
import contextlib
import json
import threading
import time
import urllib.request
from typing import Any

import aiohttp

PARTS = ("driver", "controller")
LOST = "no connection"


class PageReader:
    """Follows the page's messages in a thread of its own; connects again after the server has ended."""

    def __init__(self, address: str) -> None:
        self._url = address.partition("?")[0]
        with urllib.request.urlopen(address, timeout=30.0) as answer:
            self._cookie = answer.headers["Set-Cookie"].partition(";")[0]
        self.shown: list[tuple[float, str]] = []
        """Wall times of changes (s), and the texts."""
        self._ended = threading.Event()
        self._thread = threading.Thread(target=lambda: asyncio.run(self._run()), daemon=True)
        self._thread.start()

    async def _run(self) -> None:
        headers = {"Origin": self._url.rstrip("/"), "Cookie": self._cookie}
        async with aiohttp.ClientSession(headers=headers) as session:
            while not self._ended.is_set():
                with contextlib.suppress(aiohttp.ClientError, asyncio.TimeoutError, OSError):
                    await self._follow(await session.ws_connect(self._url + "control", max_msg_size=0))
                self._show(LOST)
                await asyncio.sleep(0.2)

    async def _follow(self, control: aiohttp.ClientWebSocketResponse) -> None:
        while not self._ended.is_set():
            try:
                message = await control.receive(timeout=0.5)
            except asyncio.TimeoutError:
                self._show("the page receives nothing")
                continue
            if message.type is not aiohttp.WSMsgType.TEXT:
                return
            self._take(json.loads(message.data))

    def _take(self, content: dict[str, Any]) -> None:
        state = content.get("state") if content.get("type") == "hello" else content
        if content.get("type") in ("hello", "state") and isinstance(state, dict):
            texts = (state.get(part) or {} for part in PARTS)
            said = (f"{text.get('state', '')}: {text.get('reason', '')}".rstrip(": ") for text in texts)
            self._show(" | ".join(f"{part} {text}" for part, text in zip(PARTS, said)))

    def _show(self, text: str) -> None:
        if not self.shown or self.shown[-1][1] != text:
            self.shown.append((time.monotonic(), text))

    def since(self, wall_s: float) -> list[str]:
        """Return the texts shown since a time, each once."""
        return list(dict.fromkeys(text for at, text in self.shown if at >= wall_s))

    def close(self) -> None:
        self._ended.set()
        self._thread.join(5.0)
