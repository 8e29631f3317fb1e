"""Control connections: messages of pages to the desk, and the desk's messages back."""

from __future__ import annotations

import asyncio

from aiohttp import WSMsgType, web

from scope_ui_bridge.adapters.graph_port import GraphPort, read_clocks
from scope_ui_bridge.adapters.web.effect_runner import EffectRunner
from scope_ui_bridge.adapters.web.front_door import FrontDoor
from scope_ui_bridge.adapters.web.open_pages import OpenPage, OpenPages
from scope_ui_bridge.adapters.web.socket_gate import SocketGate
from scope_ui_bridge.adapters.web.turned_away import SUSPECT
from scope_ui_bridge.adapters.web.websockets import receive, send_all, throw_out
from scope_ui_bridge.core.access import PageSession
from scope_ui_bridge.core.admission import PINGS_BURST, PINGS_PER_S, Bucket
from scope_ui_bridge.core.desk import Desk
from scope_ui_bridge.core.effects import Effect, End, SendToViewer
from scope_ui_bridge.core.wire import Refusal, encode

_LINK_LOST = "stopped_link_lost"
"""Cause of an end without a close frame, as when a tunnel ends."""
_FLOODING = "stopped_flooding"
_GOES_ON = (WSMsgType.TEXT, WSMsgType.BINARY, WSMsgType.PING, WSMsgType.PONG)


class ControlSockets:
    """Serves `/control`: one connection for each page, from sign-in to its end."""

    def __init__(
        self, desk: Desk, graph: GraphPort, door: FrontDoor, gate: SocketGate, pages: OpenPages, runner: EffectRunner
    ) -> None:
        self._desk = desk
        self._graph = graph
        self._door = door
        self._gate = gate
        self._pages = pages
        self._runner = runner

    async def serve(self, request: web.Request) -> web.StreamResponse:
        """Serve one page until its connection or its session ends."""
        socket, session = await self._gate.open(request)
        viewer = ""
        sender: asyncio.Task[None] | None = None
        gone = _LINK_LOST
        try:
            try:
                viewer, hello = self._desk.join(session.name, session.role, session.user is not None)
            except Refusal as refusal:
                await socket.send_str(encode({"type": "answer", "seq": None, "ok": False, **refusal.message()}))
                return socket
            page = OpenPage(socket, request.transport)
            page.outbox.put_nowait(encode(hello))
            self._pages.add(viewer, page)
            sender = asyncio.create_task(send_all(socket, page.outbox))
            gone = await self._follow(request, session, viewer, socket)
        finally:
            self._gate.leave(socket)
            self._pages.remove(viewer)
            if viewer:
                self._runner.run(self._desk.leave(viewer, read_clocks(self._graph), gone))
            if sender is not None:
                sender.cancel()
        return await (throw_out(request, socket) if gone == _FLOODING else self._gate.ended(socket))

    async def _follow(
        self, request: web.Request, session: PageSession, viewer: str, socket: web.WebSocketResponse
    ) -> str:
        """Pass on the messages of a page; return the cause of its end."""
        pings = Bucket(PINGS_PER_S, PINGS_BURST)
        while True:
            message = await receive(socket, pings)
            if message is not None and message.type not in _GOES_ON:
                self._gate.note_broken(session, message)
                return "stopped_page_gone" if message.type is WSMsgType.CLOSE else _LINK_LOST
            now_in = self._door.session(request)
            if now_in is None:  # signed out, or the session has expired
                return "stopped_signed_out"
            self._desk.signed_in(viewer, now_in.ends_s)
            if message is None or message.type is WSMsgType.PING:
                continue
            if message.type is WSMsgType.PONG:
                self._desk.pong(viewer)
                continue
            effects = self._desk.message(viewer, message.data, read_clocks(self._graph))
            self._note_suspects(session.name, effects)
            self._runner.run(effects)
            if any(isinstance(effect, End) for effect in effects):
                self._door.turned_away.note(session.name, "connection", "ended: kept sending after rate_limited")
                return _FLOODING

    def _note_suspects(self, name: str, effects: list[Effect]) -> None:
        for effect in effects:
            if isinstance(effect, SendToViewer) and effect.message.get("code") in SUSPECT:
                values = encode(effect.message["values"])
                self._door.turned_away.note(name, f"message {effect.message['code']}", values)
