"""The bridge's web server with a graph that only writes down what it is asked, and a client for tests."""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import json
import struct
import time
from collections.abc import AsyncIterator, Awaitable, Callable
from typing import Any

import aiohttp
import numpy as np
from unit.scope_ui_bridge.desk_rig import scene

from scope_ui_bridge.adapters.graph_port import GraphUnavailable
from scope_ui_bridge.adapters.secret_files import AuditFile
from scope_ui_bridge.adapters.web.web_server import WebServer
from scope_ui_bridge.core.access import SignIn
from scope_ui_bridge.core.config import BridgeConfig
from scope_ui_bridge.core.desk import Desk

WITHIN_S = 20.0
# A test whose process is held up for some seconds looks at what it has asked for all the same.
PATIENT = {
    "frame_max_age_s": 5.0,
    "recognition_max_age_s": 10.0,
    "silence_stop_s": 2.0,
    "lease_timeout_s": 30.0,
    "answer_timeout_s": 60.0,
}


class RecordingGraph:
    def __init__(self) -> None:
        self.calls: list[tuple[Any, ...]] = []
        self.causes: list[Any] = []
        self.refuses = ""
        self.on_call: Callable[[], None] = lambda: None

    runs_by_simulated_time = False

    def ros_ns(self) -> int:
        return time.time_ns()

    def stop(self, answered: Callable[[bool, str], None], cause: str = "") -> None:
        self.calls.append(("stop",))
        self.causes.append(cause)
        answered(True, "")

    def heartbeat(self) -> None:
        self.calls.append(("heartbeat",))

    def send_command(self, text: str) -> None:
        self._take("command", text)

    def send_teaching(self, text: str, stamp_ns: int, encoding: str, picture: Any) -> None:
        self._take("teaching", text, stamp_ns, encoding, picture)

    def send_sequence(self, text: str) -> None:
        self._take("sequence", text)

    def send_goal(self, frame: str, point: tuple[float, float], stamp_ns: int) -> None:
        self._take("goal", frame, point, stamp_ns)

    def call(self, service: str, answered: Callable[[bool, str], None]) -> None:
        self._take("call", service)
        answered(True, "as you wish")

    def _take(self, *call: Any) -> None:
        if self.refuses:
            raise GraphUnavailable(self.refuses)
        self.on_call()
        self.calls.append(call)

    def named(self, name: str) -> list[tuple[Any, ...]]:
        return [call for call in self.calls if call[0] == name]


class Rig:
    """A server on a free port, with the known scene and everything ready to move."""

    def __init__(self, audit: AuditFile | None = None, **config: Any) -> None:
        self.config = BridgeConfig(**{"port": 0, **PATIENT, **config})
        self.graph = RecordingGraph()
        self.desk = Desk(self.config, "boot", "DSO", scene=scene())
        self.desk.machine.set_state("driver", "idle")
        self.desk.machine.set_state("controller", "ready")
        secrets = (f"secret-{number}" for number in itertools.count())
        self.sign_in = SignIn(lambda: next(secrets), 100.0)
        self.server = WebServer(self.config, self.desk, self.sign_in, self.graph, audit)
        try:
            self.server.start()
        except BaseException:
            self.server.close()
            raise
        self.token = self.sign_in.issue_token()
        self.url = f"http{'s' if self.config.tls else ''}://127.0.0.1:{self.server.port}"

    def offer(self, camera: str = "left", level: int = 90, stamp_ns: int | None = None) -> int:
        """Give the server a picture, and a confident recognition; return its stamp."""
        stamp = time.time_ns() if stamp_ns is None else stamp_ns
        picture = np.full((72, 128, 3), level, np.uint8)
        self.server.mailbox.newest(camera, self.server.video.offer, camera, stamp, "bgr8", picture)
        self.server.mailbox.newest("confidence", self.server.post_value, self.desk.machine.set_confidence, 0.9)
        return stamp

    def __enter__(self) -> Rig:
        return self

    def __exit__(self, *error: object) -> None:
        self.server.close()


class Page:
    """One signed-in browser page, reduced to its connections."""

    def __init__(self, rig: Rig, session: aiohttp.ClientSession) -> None:
        self.rig = rig
        self.session = session
        self.origin = {"Origin": rig.url}
        self.seq = 0
        self.heard: list[dict[str, Any]] = []

    async def enter(self, token: str | None = None) -> None:
        async with self.session.get("/", params={"token": token or self.rig.token}) as answer:
            assert answer.status == 200, await answer.text()

    async def open(self) -> dict[str, Any]:
        self.control = await self.session.ws_connect("/control", headers=self.origin)
        self.hello = json.loads((await self.control.receive(timeout=WITHIN_S)).data)
        assert self.hello["type"] == "hello"
        return dict(self.hello)

    async def send(self, **fields: Any) -> int:
        self.seq += 1
        epoch = self.rig.desk.lease.epoch
        await self.control.send_str(json.dumps({"seq": self.seq, "boot": "boot", "epoch": epoch, **fields}))
        return self.seq

    async def until(self, condition: Callable[[dict[str, Any]], bool]) -> dict[str, Any]:
        """Return the first message for which the condition holds."""
        deadline = time.monotonic() + WITHIN_S
        while True:
            assert time.monotonic() < deadline, f"not within {WITHIN_S} s; heard {self.heard[-5:]}"
            message = json.loads((await self.control.receive(timeout=WITHIN_S)).data)
            self.heard.append(message)
            if condition(message):
                return dict(message)

    async def ask(self, **fields: Any) -> dict[str, Any]:
        seq = await self.send(**fields)
        return await self.until(lambda m: m["type"] == "answer" and m["seq"] == seq)

    async def open_video(self, **wish: Any) -> None:
        self.video = await self.session.ws_connect("/video", headers=self.origin)
        await self.video.send_str(json.dumps({"camera": "left", "corners": False, **wish}))

    async def frame(self, *, acknowledge: bool = True) -> tuple[dict[str, Any], bytes]:
        message = await self.video.receive(timeout=WITHIN_S)
        assert message.type is aiohttp.WSMsgType.BINARY, message
        (length,) = struct.unpack_from(">I", message.data)
        about = json.loads(message.data[4 : 4 + length])
        if acknowledge:
            await self.video.send_str(json.dumps({"drawn": about["seq"]}))
        return about, message.data[4 + length :]


@contextlib.asynccontextmanager
async def page(rig: Rig, *, sign_in: bool = True, control: bool = True, take: bool = False) -> AsyncIterator[Page]:
    jar, whose_certificate = aiohttp.CookieJar(unsafe=True), aiohttp.TCPConnector(ssl=False)  # is tested elsewhere
    async with aiohttp.ClientSession(rig.url, cookie_jar=jar, connector=whose_certificate) as session:
        made = Page(rig, session)
        if sign_in:
            await made.enter(rig.token if rig.sign_in._token else rig.sign_in.issue_token())
            if control:
                await made.open()
                if take:
                    assert (await made.ask(type="lease", step="take"))["ok"]
        yield made


def with_rig(scenario: Callable[[Rig], Awaitable[None]], **options: Any) -> None:
    with Rig(**options) as rig:
        asyncio.run(scenario(rig))


async def until(condition: Callable[[], Any], what: str) -> Any:
    deadline = time.monotonic() + WITHIN_S
    while not (value := condition()):
        assert time.monotonic() < deadline, f"{what}: not within {WITHIN_S} s"
        await asyncio.sleep(0.005)
    return value
