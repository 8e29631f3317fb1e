"""The pages' control connections, as receivers of messages."""

from __future__ import annotations

import asyncio
import logging
from dataclasses import dataclass, field
from typing import Any

from aiohttp import web

from scope_ui_bridge.core.wire import encode

_LOG = logging.getLogger(__name__)
_OUTBOX = 200


@dataclass(slots=True, eq=False)
class OpenPage:
    """A control connection; ``outbox`` has the texts that are not sent yet."""

    socket: web.WebSocketResponse
    transport: asyncio.Transport | None
    outbox: asyncio.Queue[str] = field(default_factory=lambda: asyncio.Queue(_OUTBOX))
    full: bool = False


class OpenPages:
    """Each connection under the id that the desk gave to its page."""

    def __init__(self) -> None:
        self._pages: dict[str, OpenPage] = {}

    def add(self, viewer: str, page: OpenPage) -> None:
        """Send to a page from now on."""
        self._pages[viewer] = page

    def remove(self, viewer: str) -> None:
        """Forget a page."""
        self._pages.pop(viewer, None)

    def socket(self, viewer: str) -> web.WebSocketResponse | None:
        """Return the connection of a page, None if it is gone."""
        page = self._pages.get(viewer)
        return None if page is None else page.socket

    def send(self, viewer: str, message: dict[str, Any]) -> None:
        """Queue a message for one page."""
        self._put(viewer, encode(message))

    def broadcast(self, message: dict[str, Any]) -> None:
        """Queue a message for all pages."""
        text = encode(message)
        for viewer in list(self._pages):
            self._put(viewer, text)

    def _put(self, viewer: str, text: str) -> None:
        page = self._pages.get(viewer)
        if page is None or page.full:
            return
        try:
            page.outbox.put_nowait(text)
        except asyncio.QueueFull:
            # A page with a full queue is gone or frozen; the queue must not grow. If messages were dropped instead, the
            # page would show an outdated state. A page that reconnects receives the whole state.
            _LOG.warning("viewer %s takes no messages: its connection is ended", viewer)
            page.full = True
            if page.transport is not None:
                page.transport.abort()
