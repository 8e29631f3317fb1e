"""Web server of the operator page: aiohttp in its own thread, which carries out the desk's effects.

All input from a page is untrusted: exact Host and Origin, a session cookie, bounded sizes, strict JSON. A stop is sent
before it is recorded; every other command is on disk before it is sent.
"""

from __future__ import annotations

import asyncio
import contextlib
import ssl
import threading
from collections.abc import Callable
from typing import Any

from aiohttp import web

from icu_common.core.configuration.config import ConfigError
from scope_ui_bridge.adapters.audit_writer import AuditWriter
from scope_ui_bridge.adapters.graph_port import GraphPort, read_clocks
from scope_ui_bridge.adapters.mailbox import Mailbox
from scope_ui_bridge.adapters.recorder import Recorder
from scope_ui_bridge.adapters.secret_files import AuditFile
from scope_ui_bridge.adapters.stop_path import StopPath
from scope_ui_bridge.adapters.tasks import Tasks
from scope_ui_bridge.adapters.video.held_image import HeldImage
from scope_ui_bridge.adapters.video.jpeg_encoder import JpegEncoder
from scope_ui_bridge.adapters.video.video_hub import VideoHub
from scope_ui_bridge.adapters.web import listener as listening
from scope_ui_bridge.adapters.web.control_sockets import ControlSockets
from scope_ui_bridge.adapters.web.effect_runner import EffectRunner
from scope_ui_bridge.adapters.web.front_door import FrontDoor
from scope_ui_bridge.adapters.web.listener import Listener
from scope_ui_bridge.adapters.web.open_pages import OpenPages
from scope_ui_bridge.adapters.web.socket_gate import SocketGate
from scope_ui_bridge.adapters.web.video_sockets import VideoSockets
from scope_ui_bridge.adapters.web.websockets import close
from scope_ui_bridge.core.access import SignIn
from scope_ui_bridge.core.config import BridgeConfig
from scope_ui_bridge.core.desk import Desk
from scope_ui_bridge.core.effects import Effect

_TICK_S = 0.05
_MAX_FORM = 4096  # bytes of a plain request
_START_TIMEOUT_S = 10.0
_IDLE_CONNECTION_S = 15.0


class WebServer:
    """Serves the page.

    Parameters
    ----------
    config
        Address and files; limits that may change at run time are read from ``desk.config``.
    desk, sign_in
        Decisions; used only by the event loop's thread once :meth:`start` has been called.
    graph
        Connection to the graph.
    audit
        File for the records of commands, or None.
    """

    def __init__(
        self, config: BridgeConfig, desk: Desk, sign_in: SignIn, graph: GraphPort, audit: AuditFile | None
    ) -> None:
        self._config = config
        self._desk = desk
        self._sign_in = sign_in
        self._graph = graph
        sign_in.spares = desk.had_control
        self._loop = asyncio.new_event_loop()
        self._tasks = Tasks(self._loop)
        self.mailbox = Mailbox(self._loop)
        self._writer = AuditWriter(audit)
        self.encoder = JpegEncoder()
        self.video = VideoHub(desk, self.encoder, lambda: desk.config.jpeg_quality, graph.ros_ns)
        self._held = HeldImage(self.video, self.encoder)
        self.recorder = Recorder(
            config.record_folder, ended=lambda success, text: self.post(desk.answers.recording_ended, success, text)
        )
        self._stop_path = StopPath(graph, self._writer.write_later, self._service_answered)
        self._pages = OpenPages()
        self.runner = EffectRunner(
            desk,
            graph=graph,
            stop_path=self._stop_path,
            pages=self._pages,
            held=self._held,
            recorder=self.recorder,
            writer=self._writer,
            tasks=self._tasks,
            service_answered=self._service_answered,
        )
        self.door = FrontDoor(config, sign_in, self._writer.write_later)
        self._gate = SocketGate(
            self.door,
            self._tasks,
            2 * config.max_viewers,
            desk.had_control,
            lambda: self._pages.socket(desk.lease.holder),
        )
        self._most = max(listening.MAX_CONNECTIONS, 4 * config.max_viewers)
        self._closing = asyncio.Event()
        self._started = threading.Event()
        self._failure: BaseException | None = None
        self._thread = threading.Thread(target=self._run, name="web", daemon=True)
        self.port = 0

    # --- start and end -----------------------------------------------------------------------------------------------

    def start(self) -> None:
        """Start; return when pages can connect.

        Raises
        ------
        ConfigError
            If the address cannot be used or the certificate cannot be read.
        """
        self._thread.start()
        if not self._started.wait(_START_TIMEOUT_S):
            raise ConfigError(f"the page was not served within {_START_TIMEOUT_S} s")
        if self._failure is not None:
            raise ConfigError(f"cannot serve on {self._config.host}:{self._config.port}: {self._failure}")

    @property
    def alive(self) -> bool:
        """Whether the server runs; without it no heartbeat is sent."""
        return self._thread.is_alive()

    def close(self) -> None:
        """Close all connections and end the thread."""
        if self._thread.is_alive():
            with contextlib.suppress(RuntimeError):  # the thread has closed its loop and is about to end
                self._loop.call_soon_threadsafe(self._closing.set)
            self._thread.join(_START_TIMEOUT_S)
        self.encoder.close()
        self.door.close()
        self.recorder.close()
        self._writer.close()

    # --- calls from other threads ------------------------------------------------------------------------------------

    def new_token(self, use: Callable[[str], None]) -> None:
        """Make a new sign-in token and pass it to ``use`` in the server's thread."""
        self.mailbox.each(lambda: use(self._sign_in.issue_token()))

    def post(self, function: Callable[..., list[Effect]], *arguments: Any) -> None:
        """Call a function of the desk, with the clocks last, in the server's thread, and carry out its effects."""
        self.mailbox.each(lambda: self.runner.run(function(*arguments, read_clocks(self._graph))))

    def post_value(self, function: Callable[..., None], *arguments: Any) -> None:
        """Call a function without effects, with the clocks last; in the server's thread only (through the mailbox)."""
        function(*arguments, read_clocks(self._graph))

    def _service_answered(self, entry: int, success: bool, text: str) -> None:
        self.post(self._desk.answers.service_answered, entry, success, text)

    # --- the server's thread -----------------------------------------------------------------------------------------

    def _run(self) -> None:
        try:
            self._loop.run_until_complete(self._serve())
        except (OSError, ssl.SSLError, ValueError) as error:
            self._failure = error
        finally:
            self._started.set()
            self._loop.close()

    def _certified(self) -> ssl.SSLContext:
        context = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH)
        certificate, key = self._config.tls_certificate, self._config.tls_key
        try:
            context.load_cert_chain(certificate, key)
        except OSError as error:  # its message names neither file
            raise ValueError(f"tls_certificate = {certificate!r}, tls_key = {key!r}: {error}") from error
        return context

    async def _serve(self) -> None:
        runner = web.AppRunner(
            self._application(),
            access_log=None,
            handle_signals=False,
            shutdown_timeout=1.0,
            keepalive_timeout=_IDLE_CONNECTION_S,
            auto_decompress=False,
            logger=self.door.turned_away.logger(),
        )
        await runner.setup()
        assert runner.server is not None
        listener: Listener | None = None
        try:
            context: ssl.SSLContext | None = None
            if self._config.tls:
                context = self._certified()
            listener = Listener(runner.server, self.door.user_of, self._desk.had_control, self._most, self._made_room)
            # The sweep does not see a connection before it is encrypted; asyncio's own limit is a minute.
            self.port = await listener.open(self._config.host, self._config.port, context, self.door.speak_within_s)
            self.door.opened(self.port, listener)
            self._started.set()
            while not self._closing.is_set():
                self._desk.recordings.own = self.recorder.recording
                self.runner.run(self._desk.tick(read_clocks(self._graph)))
                self.door.sweep(runner.server)
                with contextlib.suppress(asyncio.TimeoutError):
                    await asyncio.wait_for(self._closing.wait(), _TICK_S)
            for socket in self._gate.begin_closing():
                with contextlib.suppress(asyncio.TimeoutError, ConnectionError):
                    await asyncio.wait_for(close(socket), 0.5)
        finally:
            await self._tasks.cancel()
            if listener is not None:
                listener.close()
            await runner.cleanup()

    def _made_room(self, whose: str) -> None:
        self.door.turned_away.note(whose, "connection", f"more than {self._most} are open")

    def _application(self) -> web.Application:
        control = ControlSockets(self._desk, self._graph, self.door, self._gate, self._pages, self.runner)
        video = VideoSockets(self.video, self.door, self._gate)
        application = web.Application(middlewares=[self.door.guard], client_max_size=_MAX_FORM)
        self.door.add_routes(application.router)
        application.router.add_post("/stop", self._stop)
        application.router.add_get("/control", control.serve)
        application.router.add_get("/video", video.serve)
        application.router.add_get("/held.jpg", self._held_image)
        return application

    async def _stop(self, request: web.Request) -> web.StreamResponse:
        session = self.door.session(request)
        if session is None:
            self.door.turned_away.note(request.remote or "", "stop", "not signed in")
            return web.json_response({"ok": False, "code": "signed_out"}, status=401)
        self.runner.run(self._stop_path.effects_of(request, session, self._desk, read_clocks(self._graph)))
        if "text/html" in request.headers.get("Accept", ""):  # the form was sent without its script
            return web.Response(status=303, headers={"Location": "/"})
        return web.json_response({"ok": True})

    async def _held_image(self, request: web.Request) -> web.StreamResponse:
        """Answer with the held image for teaching a panel, at full size."""
        return await self._held.answer(request, self.door.session(request))
