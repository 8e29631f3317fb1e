"""Video connections: which camera and layers a page shows, and which images it has drawn."""

from __future__ import annotations

import asyncio
import contextlib
import time

from aiohttp import WSMsgType, web

from icu_common.core.reasons.message import Message
from scope_ui_bridge.adapters.video.video_hub import VideoHub, VideoViewer
from scope_ui_bridge.adapters.web.front_door import FrontDoor
from scope_ui_bridge.adapters.web.socket_gate import SocketGate
from scope_ui_bridge.adapters.web.websockets import receive, throw_out, until_gone
from scope_ui_bridge.core.admission import PINGS_BURST, PINGS_PER_S, Bucket
from scope_ui_bridge.core.video import LAYERS
from scope_ui_bridge.core.wire import CAMERAS, Refusal, decode_object, encode

_MAX_WISH = 512  # characters of a message


class VideoSockets:
    """Serves `/video`."""

    def __init__(self, video: VideoHub, door: FrontDoor, gate: SocketGate) -> None:
        self._video = video
        self._door = door
        self._gate = gate

    async def serve(self, request: web.Request) -> web.StreamResponse:
        """Serve one page until its connection or its session ends."""
        socket, session = await self._gate.open(request)
        viewer, flooding, pings = VideoViewer(socket=socket), False, Bucket(PINGS_PER_S, PINGS_BURST)
        self._video.add(viewer)
        sender = asyncio.create_task(until_gone(self._video.serve(viewer)))
        try:
            while self._door.session(request) is not None:
                message = await receive(socket, pings)
                if message is None or message.type in (WSMsgType.PING, WSMsgType.PONG):
                    continue
                if message.type is not WSMsgType.TEXT or self._door.session(request) is None:
                    self._gate.note_broken(session, message)
                    break
                if not viewer.messages.take(time.monotonic()):
                    self._door.turned_away.note(session.name, "video", f"more than {viewer.messages.per_s:g} a second")
                    flooding = True
                    break
                try:
                    self._message(viewer, message.data)
                except Refusal as refusal:
                    with contextlib.suppress(ConnectionError):
                        await socket.send_str(encode({"type": "answer", "ok": False, **refusal.message()}))
        finally:
            self._gate.leave(socket)
            self._video.remove(viewer)
            sender.cancel()
        return await (throw_out(request, socket) if flooding else self._gate.ended(socket))

    def _message(self, viewer: VideoViewer, text: str) -> None:
        if len(text) > _MAX_WISH:
            raise Refusal("oversized", size=len(text), limit=_MAX_WISH)
        message = decode_object(text)
        drawn, camera = message.get("drawn"), message.get("camera")
        layers = {name: message.get(name, False) for name in LAYERS}
        if type(drawn) is int:
            viewer.window.acknowledged(drawn, time.monotonic())
        elif isinstance(camera, str) and camera in CAMERAS and all(isinstance(on, bool) for on in layers.values()):
            self._video.look(viewer, camera, frozenset(name for name, on in layers.items() if on))
        else:
            raise Refusal("malformed", what=Message("page.drawn_camera_layers_true_false"))
        self._video.kick(viewer)
