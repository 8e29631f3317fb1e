"""Live image for all pages: one JPEG for each image and form, encoded only while a page can accept it.

No page slows another page.
An image is encoded in the full form, and in lighter forms (smaller, stronger compression) for pages on slow links.

A message is four bytes (length of the JSON, big endian), the JSON with stamp, age and overlay, and the JPEG.
"""

from __future__ import annotations

import asyncio
import logging
import struct
import time
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass, field
from typing import Any

from aiohttp import web

from scope_ui_bridge.adapters.video.jpeg_encoder import Picture
from scope_ui_bridge.core.admission import PICTURES_BURST, PICTURES_PER_S, Bucket
from scope_ui_bridge.core.desk import Desk
from scope_ui_bridge.core.video import FORMS, Form, FrameWindow
from scope_ui_bridge.core.wire import CAMERAS, encode

_LOG = logging.getLogger(__name__)
_LAYERS_PERIOD_S = 0.5  # of corners and edges on a slow link, where they would delay the images

Encode = Callable[[Picture, str, int, Form], Future[bytes]]


@dataclass(slots=True, eq=False)
class VideoViewer:
    """One video connection; it receives nothing until it has requested a camera."""

    socket: web.WebSocketResponse
    camera: str = ""
    layers: frozenset[str] = frozenset()
    layers_sent_s: float = 0.0
    window: FrameWindow = field(default_factory=FrameWindow)
    scene_version: int = -1
    changed: asyncio.Event = field(default_factory=asyncio.Event)
    messages: Bucket = field(default_factory=lambda: Bucket(PICTURES_PER_S, PICTURES_BURST))

    @property
    def stream(self) -> tuple[str, int]:
        """Camera, and index of the form in FORMS."""
        return self.camera, self.window.level


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _Frame:
    """An encoded image; ``about`` and ``layers`` (by name) are pieces of JSON, made once for all viewers."""

    seq: int
    stamp_ns: int
    about: str
    layers: dict[str, str]
    jpeg: bytes


@dataclass(slots=True, eq=False)
class _Stream:
    """One camera in one form: the newest raw image, the newest encoded image, and whether the encoder is running."""

    raw: tuple[int, str, Picture] | None = None
    raw_seq: int = 0
    frame: _Frame | None = None
    encoding: bool = False
    complaint: str = ""


_NOTHING = _Stream()


class VideoHub:
    """Encodes and distributes images; all methods run in the event loop's thread.

    Parameters
    ----------
    desk
        Provides the overlay, and receives the stamps of the distributed images.
    encode
        Makes a JPEG from an image, its encoding, a quality and a form.
    quality
        Returns the current JPEG quality.
    ros_ns
        Returns ROS time in ns.
    """

    def __init__(self, desk: Desk, encode: Encode, quality: Callable[[], int], ros_ns: Callable[[], int]) -> None:
        self._desk = desk
        self._to_jpeg = encode
        self._quality = quality
        self._ros_ns = ros_ns
        self._viewers: set[VideoViewer] = set()
        self._streams = {(camera, level): _Stream() for camera in CAMERAS for level in range(len(FORMS))}
        self._seqs = dict.fromkeys(CAMERAS, 0)
        self._tasks: set[asyncio.Task[None]] = set()
        self.encoded = 0
        self.wanted: frozenset[tuple[str, str]] = frozenset()
        """Layers (name, camera) that a viewer shows now; replaced as a whole, so any thread may read it."""
        self.cameras: frozenset[str] = frozenset()
        """Cameras that a viewer shows now; any thread may read it."""

    def add(self, viewer: VideoViewer) -> None:
        """Start serving a viewer."""
        self._viewers.add(viewer)

    def remove(self, viewer: VideoViewer) -> None:
        """Forget a viewer."""
        self._viewers.discard(viewer)
        self._note_wanted()

    def look(self, viewer: VideoViewer, camera: str, layers: frozenset[str]) -> None:
        """Show a viewer this camera with these layers."""
        viewer.layers = layers
        if camera != viewer.camera:
            viewer.camera, viewer.window, viewer.scene_version = camera, FrameWindow(), -1
        self._note_wanted()

    def _note_wanted(self) -> None:
        self.wanted = frozenset((layer, viewer.camera) for viewer in self._viewers for layer in viewer.layers)
        self.cameras = frozenset(viewer.camera for viewer in self._viewers if viewer.camera)

    def offer(self, camera: str, stamp_ns: int, encoding: str, picture: Picture) -> None:
        """Accept the newest image of a camera, (H, W) or (H, W, C) uint8."""
        self._seqs[camera] += 1
        for level in range(len(FORMS)):
            stream = self._streams[camera, level]
            stream.raw = (stamp_ns, encoding, picture)
            stream.raw_seq = self._seqs[camera]
            self._encode_if_wanted((camera, level))

    def forget(self, camera: str) -> None:
        """Discard the images of a camera: its topic is not subscribed to while no page shows it."""
        for level in range(len(FORMS)):
            stream = self._streams[camera, level]
            stream.raw = stream.frame = None

    def newest(self, camera: str) -> tuple[int, str, Picture] | None:
        """Return stamp, encoding and pixels of a camera's newest image, None before the first."""
        return self._streams[camera, 0].raw

    def kick(self, viewer: VideoViewer) -> None:
        """Serve a viewer again; call when it can accept more or has changed its camera."""
        # The encoded image may have waited for as long as the last transfer took: encode a newer one first.
        if not self._encode_if_wanted(viewer.stream):
            viewer.changed.set()

    def _encode_if_wanted(self, key: tuple[str, int]) -> bool:
        """Return whether a newer image is being encoded; its viewers are woken when it is ready."""
        stream = self._streams.get(key, _NOTHING)
        done = stream.frame.seq if stream.frame else 0
        if stream.encoding or stream.raw is None or stream.raw_seq == done:
            return stream.encoding
        if not any(viewer.stream == key and viewer.window.open for viewer in self._viewers):
            return False
        stream.encoding = True
        task = asyncio.get_running_loop().create_task(self._encode(key, stream.raw_seq, *stream.raw))
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)
        return True

    async def _encode(self, key: tuple[str, int], seq: int, stamp_ns: int, encoding: str, picture: Picture) -> None:
        stream, (camera, level) = self._streams[key], key
        form = FORMS[level]
        loop = asyncio.get_running_loop()
        try:
            jpeg = await asyncio.wrap_future(self._to_jpeg(picture, encoding, self._quality(), form))
            self.encoded, stream.complaint = self.encoded + 1, ""
            if stream.raw is None:  # forgotten meanwhile
                return
            stream.frame = self._frame(key, seq, stamp_ns, picture, jpeg)
            self._desk.machine.frame_offered(camera, stamp_ns)
            for viewer in self._viewers:
                if viewer.stream == key:
                    viewer.changed.set()
        except (ValueError, OSError) as error:
            if stream.raw_seq == seq:  # else a newer image has arrived, which may be valid
                stream.raw = None
            if stream.complaint != str(error):  # once, not with every image
                stream.complaint = str(error)
                _LOG.error("the %s picture cannot be shown: %s", camera, error)
        finally:
            stream.encoding = False
        # After the viewers have been served: an image encoded earlier would be old before a viewer can accept it.
        loop.call_soon(self._encode_if_wanted, key)

    async def serve(self, viewer: VideoViewer) -> None:
        """Send images to one viewer; cancel this task when the connection ends."""
        while True:
            await viewer.changed.wait()
            viewer.changed.clear()
            frame = self._streams.get(viewer.stream, _NOTHING).frame
            if frame is not None and viewer.window.wants(frame.seq):
                viewer.window.sent(frame.seq, time.monotonic())
                await viewer.socket.send_bytes(self._message(viewer, frame))

    def _message(self, viewer: VideoViewer, frame: _Frame) -> bytes:
        scene = self._desk.scene
        # For an image with a future stamp, the page then has at least the time since it arrived.
        age_ms = max((self._ros_ns() - frame.stamp_ns) / 1e6, 0.0)
        now_s = time.monotonic()  # the bridge's clock in the answers to keep-alives
        parts = [f'{{"age_ms":{age_ms:.1f},"sent_ms":{now_s * 1e3:.1f}', frame.about]
        if viewer.scene_version != scene.version:
            viewer.scene_version = scene.version
            parts.append('"panel":' + encode(scene.panel(viewer.camera)))
        if not viewer.window.light or now_s - viewer.layers_sent_s >= _LAYERS_PERIOD_S:
            viewer.layers_sent_s = now_s
            parts += [f'"{name}":{text}' for name, text in frame.layers.items() if name in viewer.layers]
        text = ",".join(parts).encode() + b"}"
        return b"".join([struct.pack(">I", len(text)), text, frame.jpeg])

    def _frame(self, key: tuple[str, int], seq: int, stamp_ns: int, picture: Picture, jpeg: bytes) -> _Frame:
        scene, (camera, level) = self._desk.scene, key
        height, width = picture.shape[:2]
        about: dict[str, Any] = {"seq": seq, "camera": camera, "stamp": str(stamp_ns), "width": width, "height": height}
        about["light"] = level > 0
        about |= scene.moving_parts(camera, stamp_ns) | self._desk.tip_path.message(camera)
        layers = {name: scene.layers.text(name, camera, stamp_ns) for name, at in self.wanted if at == camera}
        return _Frame(seq=seq, stamp_ns=stamp_ns, about=encode(about)[1:-1], layers=layers, jpeg=jpeg)
