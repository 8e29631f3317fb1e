"""Web server of the operator page: aiohttp in its own thread, which carries out the desk's effects.

All input from a page is untrusted: exact Host and Origin, a session cookie, bounded sizes, strict JSON. A stop is sent
before it is recorded; every other command is on disk before it is sent.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import ssl
import threading
import time
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any

import numpy.typing as npt
from aiohttp import WSCloseCode, WSMessage, WSMsgType, web

from icu_common.core.configuration.config import ConfigError
from scope_ui_bridge.adapters import listener as listening
from scope_ui_bridge.adapters.front_door import FrontDoor
from scope_ui_bridge.adapters.graph_port import GraphError, GraphPort
from scope_ui_bridge.adapters.jpeg_encoder import JpegEncoder
from scope_ui_bridge.adapters.listener import Listener
from scope_ui_bridge.adapters.mailbox import Mailbox
from scope_ui_bridge.adapters.recorder import Recorder
from scope_ui_bridge.adapters.secret_files import AuditFile
from scope_ui_bridge.adapters.stop_path import StopPath
from scope_ui_bridge.adapters.turned_away import SUSPECT
from scope_ui_bridge.adapters.video_hub import VideoHub, VideoViewer
from scope_ui_bridge.adapters.websockets import close, receive, send_all, throw_out, until_gone
from scope_ui_bridge.core.access import Role, Session, SignIn
from scope_ui_bridge.core.admission import (
    OPENED_BURST,
    OPENED_PER_S,
    OWN_PLACES,
    PINGS_BURST,
    PINGS_PER_S,
    Bucket,
    OfUsers,
    Places,
)
from scope_ui_bridge.core.config import BridgeConfig
from scope_ui_bridge.core.desk import Desk
from scope_ui_bridge.core.effects import (
    Broadcast,
    CallService,
    Effect,
    End,
    Heartbeat,
    HoldPicture,
    Now,
    Order,
    Ping,
    Record,
    Send,
    SendCommand,
    SendGoal,
    SendSequence,
    SendTeaching,
    StopNow,
)
from scope_ui_bridge.core.orders import HeldPicture
from scope_ui_bridge.core.video import LAYERS
from scope_ui_bridge.core.wire import CAMERAS, Refusal, decode_object, encode

_LOG = logging.getLogger(__name__)
_TICK_S = 0.05
_OUTBOX = 200
_MAX_FORM = 4096  # bytes of a plain request
_HARD_LIMIT = 64 * 1024  # above this the WebSocket library itself closes the connection
_START_TIMEOUT_S = 10.0
_IDLE_CONNECTION_S = 15.0
_GOES_ON = (WSMsgType.TEXT, WSMsgType.BINARY, WSMsgType.PING, WSMsgType.PONG)
_HELD_QUALITY = 95
_MAX_WISH = 512  # characters of a message on the video connection


class WebServer:
    """Serves the page.

    Parameters
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
        self.door = FrontDoor(config, sign_in, self._write_later)
        self._graph = graph
        self._stop_path = StopPath(graph, self._write_later, self._service_answered)
        self._audit = audit
        self._loop = asyncio.new_event_loop()
        self.mailbox = Mailbox(self._loop)
        self.encoder = JpegEncoder()
        self._writer = ThreadPoolExecutor(1, "audit")  # one thread keeps the records in order
        self.video = VideoHub(desk, self.encoder, lambda: desk.config.jpeg_quality, graph.ros_ns)
        self.recorder = Recorder(
            config.record_folder, ended=lambda success, text: self.post(desk.answers.recording_ended, success, text)
        )
        self._held: tuple[int, str, npt.NDArray[Any]] | None = None
        self._outboxes: dict[str, asyncio.Queue[str]] = {}
        self._controls: dict[str, web.WebSocketResponse] = {}
        self._transports: dict[str, asyncio.Transport] = {}
        self._places: Places[web.WebSocketResponse] = Places(2 * config.max_viewers)
        self._most = max(listening.MAX_CONNECTIONS, 4 * config.max_viewers)
        self._opened = OfUsers(lambda: Bucket(OPENED_PER_S, OPENED_BURST))
        self._tasks: set[asyncio.Task[Any]] = set()
        self._closing = asyncio.Event()
        sign_in.spares = desk.had_control
        self._started = threading.Event()
        self._failure: BaseException | None = None
        self._thread = threading.Thread(target=self._run, name="web", daemon=True)
        self.port = 0

    # --- start and end -----------------------------------------------------------------------------------------------

    def start(self) -> None:
        """Start; return when pages can connect.

        Raises
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
            self._loop.call_soon_threadsafe(self._closing.set)
            self._thread.join(_START_TIMEOUT_S)
        self.encoder.close()
        self.door.close()
        self.recorder.close()
        self._writer.shutdown(wait=True)
        if self._audit is not None:
            self._audit.close()

    def new_token(self, use: Callable[[str], None]) -> None:
        """Make a new sign-in token and pass it to ``use`` in the server's thread."""
        self.mailbox.each(lambda: use(self._sign_in.issue_token()))

    def post(self, function: Callable[..., list[Effect]], *arguments: Any) -> None:
        """Call a function of the desk, with the clocks last, in the server's thread, and carry out its effects."""
        self.mailbox.each(lambda: self._carry_out(function(*arguments, self._now())))

    def post_value(self, function: Callable[..., None], *arguments: Any) -> None:
        """Call a function without effects, with the clocks last; in the server's thread only (through the mailbox)."""
        function(*arguments, self._now())

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
                self._carry_out(self._desk.tick(self._now()))
                self.door.sweep(runner.server)
                with contextlib.suppress(asyncio.TimeoutError):
                    await asyncio.wait_for(self._closing.wait(), _TICK_S)
            for socket in self._places.owners():
                with contextlib.suppress(asyncio.TimeoutError, ConnectionError):
                    await asyncio.wait_for(close(socket), 0.5)
        finally:
            for task in self._tasks:
                task.cancel()
            await asyncio.gather(*self._tasks, return_exceptions=True)
            if listener is not None:
                listener.close()
            await runner.cleanup()

    def _made_room(self, whose: str) -> None:
        self.door.turned_away.note(whose, "connection", f"more than {self._most} are open")

    def _application(self) -> web.Application:
        application = web.Application(middlewares=[self.door.guard], client_max_size=_MAX_FORM)
        self.door.add_routes(application.router)
        application.router.add_post("/stop", self._stop)
        application.router.add_get("/control", self._control)
        application.router.add_get("/video", self._video)
        application.router.add_get("/held.jpg", self._held_picture)
        return application

    def _now(self) -> Now:
        graph = self._graph
        return Now(
            mono_s=time.monotonic(), ros_ns=graph.ros_ns(), wall_s=time.time(), simulated=graph.runs_by_simulated_time
        )

    async def _stop(self, request: web.Request) -> web.StreamResponse:
        session = self.door.session(request)
        if session is None:
            self.door.turned_away.note(request.remote or "", "stop", "not signed in")
            return web.json_response({"ok": False, "code": "signed_out"}, status=401)
        self._carry_out(self._stop_path.effects_of(request, session, self._desk, self._now()))
        if "text/html" in request.headers.get("Accept", ""):  # the form was sent without its script
            return web.Response(status=303, headers={"Location": "/"})
        return web.json_response({"ok": True})

    async def _held_picture(self, request: web.Request) -> web.StreamResponse:
        """Answer with the held image for teaching a panel, at full size."""
        session = self.door.session(request)
        if session is None or not session.role.may(Role.ENGINEER):
            raise web.HTTPUnauthorized(reason="engineers only")
        if self._held is None or request.query.get("stamp", str(self._held[0])) != str(self._held[0]):  # by this name
            raise web.HTTPNotFound(reason="no picture is held")
        _, encoding, picture = self._held
        jpeg = await asyncio.wrap_future(self.encoder(picture, encoding, _HELD_QUALITY))
        return web.Response(body=jpeg, content_type="image/jpeg")

    def _hold(self, viewer: str) -> None:
        self._held = self.video.newest("left")
        held = None
        if self._held is not None:
            stamp_ns, _, picture = self._held
            held = HeldPicture(stamp_ns=stamp_ns, width=picture.shape[1], height=picture.shape[0])
        self._carry_out(self._desk.picture_held(viewer, held))

    # --- WebSockets ------------------------------------------------------------------------------------------------

    async def _open(self, request: web.Request) -> tuple[web.WebSocketResponse, Session]:
        session = self.door.session(request)
        if session is None:
            raise web.HTTPUnauthorized(reason="sign in first")
        if not self._opened[session.name].take(time.monotonic()):
            self.door.turned_away.note(session.name, "connection", f"more than {OPENED_PER_S:g} a second")
            raise web.HTTPTooManyRequests(reason="too many connections")
        # No autoping: the library would answer pings itself, and a client could delay the check for silence with them.
        socket = web.WebSocketResponse(
            max_msg_size=_HARD_LIMIT, compress=False, heartbeat=5.0, timeout=1.0, autoping=False
        )
        try:
            kept = self._desk.had_control(session.name)
            gone = self._places.take(
                socket, session.name, request.path, kept=kept, spared=self._controls.get(self._desk.lease.holder)
            )
        except Refusal as refusal:
            raise web.HTTPServiceUnavailable(reason="too many viewers") from refusal
        if gone is not None:
            self.door.turned_away.note(session.name, request.path, f"more than {OWN_PLACES}: the oldest ends")
            self._spawn(close(gone, WSCloseCode.POLICY_VIOLATION, b"newer ones of the same user"))
        try:
            await socket.prepare(request)
        except BaseException:
            self._places.leave(socket)
            raise
        return socket, session

    async def _control(self, request: web.Request) -> web.StreamResponse:
        socket, session = await self._open(request)
        viewer = ""
        sender: asyncio.Task[None] | None = None
        gone, flooding = "stopped_link_lost", False  # without a close frame, as when a tunnel ends
        pings = Bucket(PINGS_PER_S, PINGS_BURST)
        try:
            try:
                viewer, hello = self._desk.join(session.name, session.role, session.user is not None)
            except Refusal as refusal:
                await socket.send_str(encode({"type": "answer", "seq": None, "ok": False, **refusal.message()}))
                return socket
            outbox: asyncio.Queue[str] = asyncio.Queue(_OUTBOX)
            outbox.put_nowait(encode(hello))
            self._outboxes[viewer], self._controls[viewer] = outbox, socket
            if request.transport is not None:
                self._transports[viewer] = request.transport
            sender = asyncio.create_task(send_all(socket, outbox))
            while True:
                message = await receive(socket, pings)
                if message is not None and message.type not in _GOES_ON:
                    if message.type is WSMsgType.CLOSE:
                        gone = "stopped_page_gone"
                    self._note_broken(session, message)
                    break
                now_in = self.door.session(request)
                if now_in is None:  # signed out, or the session has expired
                    gone = "stopped_signed_out"
                    break
                self._desk.signed_in(viewer, now_in.ends_s)
                if message is None or message.type is WSMsgType.PING:
                    continue
                if message.type is WSMsgType.PONG:
                    self._desk.pong(viewer)
                    continue
                effects = self._desk.message(viewer, message.data, self._now())
                self._note_suspects(session.name, effects)
                self._carry_out(effects)
                if any(isinstance(effect, End) for effect in effects):
                    gone, flooding = "stopped_flooding", True
                    self.door.turned_away.note(session.name, "connection", "ended: kept sending after rate_limited")
                    break
        finally:
            self._places.leave(socket)
            self._outboxes.pop(viewer, None)
            self._controls.pop(viewer, None)
            self._transports.pop(viewer, None)
            if viewer:
                self._carry_out(self._desk.leave(viewer, self._now(), gone))
            if sender is not None:
                sender.cancel()
        return await (throw_out(request, socket) if flooding else self._ended(socket))

    def _note_suspects(self, name: str, effects: list[Effect]) -> None:
        for effect in effects:
            if isinstance(effect, Send) and effect.message.get("code") in SUSPECT:
                self.door.turned_away.note(name, f"message {effect.message['code']}", encode(effect.message["values"]))

    def _note_broken(self, session: Session, message: WSMessage) -> None:
        if message.type is WSMsgType.ERROR:  # too large, or no valid WebSocket frame: the connection ends
            self.door.turned_away.note(session.name, "frame", str(message.data)[:80])

    async def _video(self, request: web.Request) -> web.StreamResponse:
        socket, session = await self._open(request)
        viewer, flooding, pings = VideoViewer(socket=socket), False, Bucket(PINGS_PER_S, PINGS_BURST)
        self.video.add(viewer)
        sender = asyncio.create_task(until_gone(self.video.serve(viewer)))
        try:
            while self.door.session(request) is not None:
                message = await receive(socket, pings)
                if message is None or message.type in (WSMsgType.PING, WSMsgType.PONG):
                    continue
                if message.type is not WSMsgType.TEXT or self.door.session(request) is None:
                    self._note_broken(session, message)
                    break
                if not viewer.messages.take(time.monotonic()):
                    self.door.turned_away.note(session.name, "video", f"more than {viewer.messages.per_s:g} a second")
                    flooding = True
                    break
                try:
                    self._video_message(viewer, message.data)
                except Refusal as refusal:
                    with contextlib.suppress(ConnectionError):
                        await socket.send_str(encode({"type": "answer", "ok": False, **refusal.message()}))
        finally:
            self._places.leave(socket)
            self.video.remove(viewer)
            sender.cancel()
        return await (throw_out(request, socket) if flooding else self._ended(socket))

    async def _ended(self, socket: web.WebSocketResponse) -> web.WebSocketResponse:
        """Close with the server's reason: aiohttp 3.9 treats the end of a handler as a normal closure."""
        if self._closing.is_set():
            await close(socket)
        return socket

    def _video_message(self, viewer: VideoViewer, text: str) -> None:
        if len(text) > _MAX_WISH:
            raise Refusal("oversized", size=len(text), limit=_MAX_WISH)
        message = decode_object(text)
        drawn, camera = message.get("drawn"), message.get("camera")
        layers = {name: message.get(name, False) for name in LAYERS}
        if type(drawn) is int:
            viewer.window.acknowledged(drawn, time.monotonic())
        elif isinstance(camera, str) and camera in CAMERAS and all(isinstance(on, bool) for on in layers.values()):
            self.video.look(viewer, camera, frozenset(name for name, on in layers.items() if on))
        else:
            raise Refusal("malformed", what="drawn, or camera and layers (true or false), are needed")
        self.video.kick(viewer)

    # --- effects ---------------------------------------------------------------------------------------------------

    def _carry_out(self, effects: list[Effect]) -> None:
        for effect in effects:
            if isinstance(effect, StopNow):
                self._stop_path.send(effect)
            elif isinstance(effect, Heartbeat):
                self._graph.heartbeat()
            elif isinstance(effect, Ping):
                if effect.viewer in self._controls:
                    self._spawn(until_gone(self._controls[effect.viewer].ping()))
            elif isinstance(effect, Send):
                self._put(effect.viewer, encode(effect.message))
            elif isinstance(effect, Broadcast):
                text = encode(effect.message)
                for viewer in list(self._outboxes):
                    self._put(viewer, text)
            elif isinstance(effect, HoldPicture):
                self._hold(effect.viewer)
            elif isinstance(effect, Record):
                self._write_later(effect.record)
            elif isinstance(effect, End):
                continue  # the connection's own task ends it
            else:
                assert isinstance(effect, Order)
                self._spawn(self._send_order(effect, self._write(effect.record)))

    def _put(self, viewer: str, text: str) -> None:
        outbox = self._outboxes.get(viewer)
        if outbox is None:
            return
        try:
            outbox.put_nowait(text)
        except asyncio.QueueFull:
            # A page with a full queue is gone or frozen; the queue must not grow. If messages were dropped instead, the
            # page would show an outdated state. A page that reconnects receives the whole state.
            _LOG.warning("viewer %s takes no messages: its connection is ended", viewer)
            del self._outboxes[viewer]
            if viewer in self._transports:
                self._transports[viewer].abort()

    async def _send_order(self, order: Order, written: Future[None]) -> None:
        try:
            await asyncio.wrap_future(written)
            if not self._desk.still_wanted(order, self._now()):
                raise GraphError("stopped before it went out")
            if isinstance(order, SendCommand):
                self._graph.send_command(order.text)
            elif isinstance(order, SendSequence):
                self._graph.send_sequence(order.text)
            elif isinstance(order, SendTeaching):
                assert self._held is not None, "the desk knows which picture is held"
                self._graph.send_teaching(order.text, *self._held)
            elif isinstance(order, SendGoal):
                self._graph.send_goal(order.frame, order.point, order.stamp_ns)
            elif isinstance(order, CallService):
                who = str(order.record["who"])
                self._call(order.service, who, lambda ok, text: self._service_answered(order.entry, ok, text))
        except OSError as error:
            self._carry_out(
                self._desk.answers.order_failed(order, f"the record could not be written: {error}", self._now())
            )
        except GraphError as error:
            self._carry_out(self._desk.answers.order_failed(order, str(error), self._now()))

    def _call(self, service: str, who: str, answered: Callable[[bool, str], None]) -> None:
        if service == "record":
            self.recorder.start(answered, who)
        elif service == "end_record":
            self.recorder.end(answered)
        else:
            self._graph.call(service, answered)

    def _service_answered(self, entry: int, success: bool, text: str) -> None:
        self.post(self._desk.answers.service_answered, entry, success, text)

    def _write(self, record: dict[str, Any]) -> Future[None]:
        """Queue a record for the writer; the future is done when the record is on disk.

        The call queues at once, without a task: tasks end with the event loop, and the last stop is sent when the loop
        ends.
        """
        try:
            return self._writer.submit(self._append, record)
        except RuntimeError as error:  # the writer has ended
            failed: Future[None] = Future()
            failed.set_exception(OSError(str(error)))
            return failed

    def _append(self, record: dict[str, Any]) -> None:
        if self._audit is not None:
            self._audit.append(record)

    def _write_later(self, record: dict[str, Any]) -> None:
        self._write(record).add_done_callback(_tell_failure)

    def _spawn(self, work: Any) -> None:
        task = self._loop.create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)


def _tell_failure(written: Future[None]) -> None:
    if (error := written.exception()) is not None:
        _LOG.error("the record could not be written: %s", error)
