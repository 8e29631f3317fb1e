"""Functions of both kinds of WebSocket connections: receive the next message, send in order, and close."""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import Awaitable

from aiohttp import WSCloseCode, WSMessage, WSMsgType, web

from scope_ui_bridge.core.admission import Bucket

LOOK_S = 1.0
"""Maximum seconds between checks that a connection's user is still signed in and may receive messages."""
_FAREWELL_S = 0.2
_TOO_MANY_PINGS = WSMessage(WSMsgType.ERROR, "too many pings", None)


async def close(socket: web.WebSocketResponse, code: int = WSCloseCode.GOING_AWAY, why: bytes = b"server ends") -> None:
    """Close a connection with a reason."""
    await socket.close(code=code, message=why)


async def throw_out(request: web.Request, socket: web.WebSocketResponse) -> web.WebSocketResponse:
    """End a connection whose client sends too much, whether or not the client reads the reason."""
    with contextlib.suppress(asyncio.TimeoutError, ConnectionError):
        await asyncio.wait_for(close(socket, WSCloseCode.POLICY_VIOLATION, b"too many messages"), _FAREWELL_S)
    if request.transport is not None:
        request.transport.abort()
    return socket


async def receive(socket: web.WebSocketResponse, pings: Bucket) -> WSMessage | None:
    """Return the next message, None after a second without one; a later message is not lost.

    Pings and pongs beyond their rate end the connection.
    """
    try:
        message = await socket.receive(timeout=LOOK_S)
    except asyncio.TimeoutError:
        return None
    if message.type in (WSMsgType.PING, WSMsgType.PONG) and not pings.take(time.monotonic()):
        return _TOO_MANY_PINGS
    if message.type is WSMsgType.PING:
        await socket.pong(message.data)
    return message


async def send_all(socket: web.WebSocketResponse, outbox: asyncio.Queue[str]) -> None:
    """Send the texts of a queue until the connection ends."""
    with contextlib.suppress(ConnectionError):
        while True:
            await socket.send_str(await outbox.get())


async def until_gone(work: Awaitable[None]) -> None:
    """Await work on a connection; return if the connection ends meanwhile."""
    with contextlib.suppress(ConnectionError):
        await work
