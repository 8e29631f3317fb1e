"""Admission of WebSockets: signed-in users, a limited rate, and a limited number of slots."""

from __future__ import annotations

import time
from collections.abc import Callable

from aiohttp import WSCloseCode, WSMessage, WSMsgType, web

from scope_ui_bridge.adapters.tasks import Tasks
from scope_ui_bridge.adapters.web.front_door import FrontDoor
from scope_ui_bridge.adapters.web.websockets import close
from scope_ui_bridge.core.access import PageSession
from scope_ui_bridge.core.admission import OPENED_BURST, OPENED_PER_S, OWN_PLACES, Bucket, OfUsers, Places
from scope_ui_bridge.core.wire import Refusal

_HARD_LIMIT = 64 * 1024  # above this the WebSocket library itself closes the connection


class SocketGate:
    """Opens connections for requests.

    Parameters
    ----------
    door
        Sessions, and records of refusals.
    tasks
        Closes the connections that newer ones replace.
    slots
        Maximum number of connections, without the reserved ones.
    had_control
        Returns whether a user has or has had control.
    in_control
        Returns the connection that no other one replaces: the page in control.
    """

    def __init__(
        self,
        door: FrontDoor,
        tasks: Tasks,
        slots: int,
        had_control: Callable[[str], bool],
        in_control: Callable[[], web.WebSocketResponse | None],
    ) -> None:
        self._door = door
        self._tasks = tasks
        self._places: Places[web.WebSocketResponse] = Places(slots)
        self._had_control = had_control
        self._in_control = in_control
        self._opened = OfUsers(lambda: Bucket(OPENED_PER_S, OPENED_BURST))
        self._closing = False

    async def open(self, request: web.Request) -> tuple[web.WebSocketResponse, PageSession]:
        """Return the opened connection and its user's session."""
        session = self._door.session(request)
        if session is None:
            raise web.HTTPUnauthorized(reason="sign in first")
        if not self._opened[session.name].take(time.monotonic()):
            self._door.turned_away.note(session.name, "connection", f"more than {OPENED_PER_S:g} a second")
            raise web.HTTPTooManyRequests(reason="too many connections")
        # No autoping: the library would answer pings itself, and a client could delay the check for silence with them.
        socket = web.WebSocketResponse(
            max_msg_size=_HARD_LIMIT, compress=False, heartbeat=5.0, timeout=1.0, autoping=False
        )
        try:
            kept = self._had_control(session.name)
            gone = self._places.take(socket, session.name, request.path, kept=kept, spared=self._in_control())
        except Refusal as refusal:
            raise web.HTTPServiceUnavailable(reason="too many viewers") from refusal
        if gone is not None:
            self._door.turned_away.note(session.name, request.path, f"more than {OWN_PLACES}: the oldest ends")
            self._tasks.spawn(close(gone, WSCloseCode.POLICY_VIOLATION, b"newer ones of the same user"))
        try:
            await socket.prepare(request)
        except BaseException:
            self._places.leave(socket)
            raise
        return socket, session

    def leave(self, socket: web.WebSocketResponse) -> None:
        """Free the slot of a connection."""
        self._places.leave(socket)

    def note_broken(self, session: PageSession, message: WSMessage) -> None:
        """Record a message that is too large, or no valid WebSocket frame: the connection ends."""
        if message.type is WSMsgType.ERROR:
            self._door.turned_away.note(session.name, "frame", str(message.data)[:80])

    def begin_closing(self) -> list[web.WebSocketResponse]:
        """Close every connection with the server's reason from now on; return the open ones."""
        self._closing = True
        return self._places.owners()

    async def ended(self, socket: web.WebSocketResponse) -> web.WebSocketResponse:
        """Close with the server's reason: aiohttp 3.9 treats the end of a handler as a normal closure."""
        if self._closing:
            await close(socket)
        return socket
