"""The image that is held for teaching a panel."""

from __future__ import annotations

import asyncio

from aiohttp import web

from scope_ui_bridge.adapters.video.jpeg_encoder import JpegEncoder, Picture
from scope_ui_bridge.adapters.video.video_hub import VideoHub
from scope_ui_bridge.core.access import PageSession, Role
from scope_ui_bridge.core.orders import HeldPicture

_QUALITY = 95


class HeldImage:
    """Keeps one image of the left camera, and serves it at full size."""

    def __init__(self, video: VideoHub, encoder: JpegEncoder) -> None:
        self._video = video
        self._encoder = encoder
        self._held: tuple[int, str, Picture] | None = None

    def hold(self) -> HeldPicture | None:
        """Hold the newest image; return its stamp and size, None without an image."""
        self._held = self._video.newest("left")
        if self._held is None:
            return None
        stamp_ns, _, picture = self._held
        return HeldPicture(stamp_ns=stamp_ns, width=picture.shape[1], height=picture.shape[0])

    @property
    def content(self) -> tuple[int, str, Picture]:
        """Stamp, encoding and pixels of the held image."""
        assert self._held is not None, "the desk knows which picture is held"
        return self._held

    async def answer(self, request: web.Request, session: PageSession | None) -> web.Response:
        """Answer an engineer's request with the image."""
        if session is None or not session.role.may(Role.ENGINEER):
            raise web.HTTPUnauthorized(reason="engineers only")
        if self._held is None or request.query.get("stamp", str(self._held[0])) != str(self._held[0]):  # by this name
            raise web.HTTPNotFound(reason="no picture is held")
        _, encoding, picture = self._held
        jpeg = await asyncio.wrap_future(self._encoder(picture, encoding, _QUALITY))
        return web.Response(body=jpeg, content_type="image/jpeg")
