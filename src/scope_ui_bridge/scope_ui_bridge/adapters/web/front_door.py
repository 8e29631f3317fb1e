"""Plain requests: hosts, origins, security headers, sign-in and sign-out. All input is untrusted."""

from __future__ import annotations

import asyncio
import logging
import os
import time
from collections.abc import Awaitable, Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any
from urllib.parse import parse_qsl, unquote

from aiohttp import web

from icu_common.core.configuration.text_bounds import plain
from scope_ui_bridge.adapters.secret_files import read_users
from scope_ui_bridge.adapters.web import languages
from scope_ui_bridge.adapters.web.languages import PAGE
from scope_ui_bridge.adapters.web.listener import NOBODY, Listener, Turnstile
from scope_ui_bridge.adapters.web.turned_away import TurnedAway
from scope_ui_bridge.core.access import (
    AGAIN,
    MAX_NAME,
    PageSession,
    PasswordError,
    SignIn,
    User,
    composed,
    hash_password,
    matches,
)
from scope_ui_bridge.core.admission import REQUESTS_BURST, REQUESTS_PER_S, Bucket, OfUsers
from scope_ui_bridge.core.config import BridgeConfig
from scope_ui_bridge.core.wire import Refusal

_LOG = logging.getLogger(__name__)
COOKIE = "icu_session"
"""Cookie name without the port, which follows: browsers send a cookie to all ports of a host, also to other robots."""
_BODY_TIMEOUT_S = 5.0
_MAX_FIELDS = 8
_LOOK_S = 1.0
"""Minimum interval between reads of the passwords file that check the accounts of signed-in users."""
_SPEAK_WITHIN_S = 5.0
_MAX_PATH = 200  # characters; far below the limit of a file system
_MAX_GUESSES = 8  # passwords in a queue: each check takes 0.1 s of a processor
_MAX_OF_ONE = 3  # of the queue for one account and address (all tunnels share one): leaves room for others
HEADERS = {
    "Content-Security-Policy": (
        "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob:; connect-src 'self'; "
        "form-action 'self'; base-uri 'none'; frame-ancestors 'none'"
    ),
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
    # not no-referrer: browsers would then send "Origin: null" with forms
    "Referrer-Policy": "same-origin",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Permissions-Policy": "camera=(), microphone=(), geolocation=()",
    "Cache-Control": "no-store",
}
Handler = Callable[[web.Request], Awaitable[web.StreamResponse]]


class _Lane:
    """A queue and a thread that check passwords one by one; signed-in users have their own lane."""

    def __init__(self, name: str) -> None:
        self.checker = ThreadPoolExecutor(1, name)
        self.guesses: list[tuple[str, str]] = []
        self.one_by_one = asyncio.Lock()


class FrontDoor:
    """Sign-in, sign-out and checks of requests; all methods run in the event loop's thread.

    Parameters
    ----------
    config
        Host names, certificates, passwords file.
    sign_in
        Tokens, sessions and back-off.
    record
        Called with each record for the audit file.
    """

    def __init__(self, config: BridgeConfig, sign_in: SignIn, record: Callable[[dict[str, Any]], None]) -> None:
        self._config = config
        self._sign_in = sign_in
        self._record = record
        self.turned_away = TurnedAway(record)
        self._origins: frozenset[str] = frozenset()
        self._hosts: frozenset[str] = frozenset()
        self._passwords = Path(config.passwords_file).expanduser()
        self._strangers, self._known = _Lane("password"), _Lane("password again")
        self._nobody = ""
        self._users: dict[str, User] | None = None
        self._look_s = 0.0
        self._turnstile = Turnstile()
        self._requests = OfUsers(lambda: Bucket(REQUESTS_PER_S, REQUESTS_BURST))
        self._listener: Listener | None = None
        self._failures = Bucket(1.0, 1.0)  # limits tracebacks in the log
        self._seen_s: dict[Any, float] = {}
        self._spoke: set[Any] = set()

    @property
    def speak_within_s(self) -> float:
        """Maximum seconds from a connection's start to its first request, and maximum seconds for its TLS handshake."""
        return _SPEAK_WITHIN_S

    def opened(self, port: int, listener: Listener) -> None:
        """Set the port (part of the allowed origins and hosts) and the listener, which has the connections' users."""
        self._listener = listener
        self._origins = self._config.origins(port)
        self._hosts = frozenset(origin.partition("://")[2] for origin in self._origins)

    def close(self) -> None:
        """Cancel the password checks that have not started."""
        for lane in (self._strangers, self._known):
            lane.checker.shutdown(wait=False, cancel_futures=True)

    def add_routes(self, router: web.UrlDispatcher) -> None:
        """Register the plain requests except the stop."""
        router.add_get("/", self._index, allow_head=False)  # a HEAD request would use the token up
        router.add_post("/sign-in", self._enter)
        router.add_post("/renew", self._renew)
        router.add_post("/sign-out", self._leave)
        router.add_get("/session", self._session_state)
        router.add_static("/page/", PAGE, follow_symlinks=False)
        languages.add_routes(router)

    @web.middleware
    async def guard(self, request: web.Request, handler: Handler) -> web.StreamResponse:
        """Refuse foreign hosts (DNS rebinding) and origins, and add the security headers to every answer."""
        response: web.StreamResponse
        self._spoke.add(request.protocol)
        await self._in_turn(request)
        named = request.method == "POST" or request.path in ("/control", "/video")
        if request.host not in self._hosts:
            self.turned_away.note(request.remote or "", "request", f"host {request.host[:80]!r}")
            response = web.Response(status=421, text="This server is not known by that name.\n")
        elif len(request.path) > _MAX_PATH:
            self.turned_away.note(request.remote or "", "request", f"path of {len(request.path)} characters")
            response = web.Response(status=414, text="Nothing here has such a long name.\n")
        elif named and request.headers.getall("Origin", []) not in [[origin] for origin in self._origins]:
            found = request.headers.get("Origin")
            self._note(request, f"origin {str(found)[:80]!r}")
            response = web.Response(status=403, text="This origin may not do that.\n")
        elif set(request.headers.getall("Content-Encoding", [])) - {"identity"}:
            self._note(request, "an encoded body")
            response = web.Response(status=415, text="Encoded bodies are not accepted.\n")
        else:
            try:
                response = await handler(request)
            except web.HTTPException as error:
                if error.status in (400, 401, 413) or ".." in unquote(request.raw_path):
                    self._note(request, f"{error.status} {error.reason}")
                response = web.Response(status=error.status, text=f"{error.status}: {error.reason}\n")
                if "Allow" in error.headers:
                    response.headers["Allow"] = error.headers["Allow"]
            except Exception as error:  # a fault of the server; a stranger may trigger it at any rate
                if self._failures.take(time.monotonic()):
                    _LOG.exception("a request failed")
                self._note(request, f"500 {type(error).__name__}")
                response = web.Response(status=500, text="500: this request failed.\n")
        if not response.prepared:
            response.headers.update(HEADERS)
        return response

    def _know(self, request: web.Request, user: str) -> None:
        if self._listener is not None and request.transport is not None:
            self._listener.know(request.transport.get_protocol(), user)

    async def _in_turn(self, request: web.Request) -> None:
        """Wait until a request may be handled; a signed-in user's request to stop never waits."""
        session = self.session(request)
        self._know(request, session.name if session is not None else NOBODY)
        if session is None:
            await self._turnstile.wait()
        elif request.path != "/stop":
            while not (rate := self._requests[session.name]).take(time.monotonic()):
                await asyncio.sleep(rate.wait_s())
            await asyncio.sleep(0)  # else consecutive requests of one connection would run in one turn of the loop

    def user_of(self, cookie: str) -> str:
        """Return the user of a session's cookie, ``NOBODY`` if there is none."""
        session = self._sign_in.session(cookie, time.monotonic())
        return session.name if session is not None else NOBODY

    def _note(self, request: web.Request, why: str) -> None:
        # Each served path is a kind of its own. All other paths share one kind, or each invented path would add a
        # record.
        served = request.match_info.route.resource
        kind = served.canonical if served is not None else "request"
        named = why if kind == request.path else f"{request.path!r}: {why}"
        self.turned_away.note(request.remote or "", kind, named)

    def sweep(self, server: web.Server) -> None:
        """End connections without a request, so that slow or silent clients cannot use up all slots; call often.

        It also records the sign-ins that have expired.
        """
        now_s = time.monotonic()
        for ended, why in self._sign_in.take_ended(now_s):
            self._record_done(ended, "sign-out", why)
        connections = server.connections
        self._spoke.intersection_update(connections)
        self._seen_s = {c: self._seen_s.get(c, now_s) for c in connections}
        silent = [c for c in connections if c not in self._spoke]
        for connection in silent:
            if now_s - self._seen_s[connection] > _SPEAK_WITHIN_S:
                self.turned_away.note("somebody", "connection", "nothing was asked in time")
                if connection.transport is not None:
                    connection.transport.abort()

    def session(self, request: web.Request) -> PageSession | None:
        """Return the session of a request; end it if the user's line in the passwords file has changed or is gone."""
        cookie, now_s = _secret(request), time.monotonic()
        session = self._sign_in.session(cookie, now_s)
        if session is not None and session.user is not None and not self._still_let_in(session.user, now_s):
            self._sign_in.leave(cookie)
            self._record_done(session, "sign-out", "its account was changed")
            return None
        return session

    def _still_let_in(self, user: User, now_s: float) -> bool:
        if now_s >= self._look_s:
            self._look_s = now_s + _LOOK_S
            try:
                self._users = read_users(self._passwords)
            except (OSError, PasswordError) as error:  # no new sign-ins, but signed-in users keep working
                self.turned_away.note("the bridge", "passwords_file", str(error))
                self._users = None
        return self._users is None or self._users.get(user.name) == user

    # --- requests --------------------------------------------------------------------------------------------------

    async def _index(self, request: web.Request) -> web.StreamResponse:
        if self.session(request) is not None:
            return web.FileResponse(PAGE / "index.html")
        token = request.query.get("token", "")
        # An <img> or a frame on another site sends no Origin: its wrong tokens would cause waiting times for users.
        part_of_a_page = request.headers.get("Sec-Fetch-Dest", "document") != "document"
        if not token or part_of_a_page:
            return self._sign_in_page(401, "ended" if _cookie(request) in request.cookies else "")
        # Answer with the page, not with a redirect: after a link from another site a browser would not send a
        # SameSite=Strict cookie with the redirected request.
        return await self._try(request, token, "", "", web.FileResponse(PAGE / "index.html"))

    async def _enter(self, request: web.Request) -> web.StreamResponse:
        token, name, password = await _form(request, "token", "name", "password")
        return await self._try(request, token, name, password, web.Response(status=303, headers={"Location": "/"}))

    async def _try(
        self, request: web.Request, token: str, name: str, password: str, welcome: web.StreamResponse
    ) -> web.StreamResponse:
        remote = request.remote or ""
        try:
            if name:
                account = plain(composed(name.strip()), MAX_NAME)
                user = await self._user(self._strangers, account, password, remote)
                secret = self._sign_in.enter_by_password(user, account, remote, time.monotonic())
            else:
                secret = self._sign_in.enter(token.strip(), time.monotonic())
        except Refusal as refusal:
            self.turned_away.note(remote, "sign-in", refusal.code)
            response = self._sign_in_page(429 if refusal.code == "wait" else 401, refusal.code)
            if refusal.code == "wait":
                response.headers["Retry-After"] = str(int(refusal.values["seconds"]) + 1)
            return response
        session = self._sign_in.session(secret, time.monotonic())
        assert session is not None
        self._know(request, session.name)  # else a stranger's connection may replace this one before the answer
        self._record_done(session, "sign-in")
        welcome.set_cookie(
            _cookie(request), secret, httponly=True, samesite="Strict", secure=self._config.tls, path="/"
        )
        return welcome

    async def _renew(self, request: web.Request) -> web.StreamResponse:
        """Extend a session by a new sign-in of the same kind; control, connections and page remain.

        The cookie remains as well: the open connections were opened with it and are checked by it.
        """
        (secret,) = await _form(request, "secret")
        remote, session = request.remote or "", self.session(request)
        try:
            if session is not None and session.user is not None:
                user = await self._user(self._known, session.name, secret, AGAIN)
                self._sign_in.check_user(user, session.name, AGAIN, time.monotonic())
                session = self.session(request)  # it may have ended during the check
            elif session is not None:
                self._sign_in.use_up(secret.strip())
            if session is None or self._sign_in.renew(_secret(request), time.monotonic()) is None:
                raise Refusal("signed_out")
        except Refusal as refusal:
            self.turned_away.note(session.name if session else remote, "sign-in again", refusal.code)
            status = 429 if refusal.code == "wait" else 401
            return web.json_response({"ok": False, **refusal.message()}, status=status)
        self._record_done(session, "sign-in again")
        return web.json_response({"ok": True})

    def _record_done(self, session: PageSession, command: str, why: str = "") -> None:
        done = {"wall_s": round(time.time(), 3), "who": session.name, "command": command, "result": "done"}
        self._record(done | ({"reason": why} if why else {}))

    async def _user(self, lane: _Lane, name: str, password: str, remote: str) -> User | None:
        """Return the user with this name and password, None if there is none; ``wait`` if the queue is full."""
        self._sign_in.check_wait(name, remote, time.monotonic())
        if lane.guesses.count((name, remote)) >= _MAX_OF_ONE or len(lane.guesses) >= _MAX_GUESSES:
            raise Refusal("wait", seconds=1.0)
        lane.guesses.append((name, remote))
        try:
            async with lane.one_by_one:  # a wrong guess before this one causes a waiting time
                self._sign_in.check_wait(name, remote, time.monotonic())
                loop = asyncio.get_running_loop()
                user, problem = await loop.run_in_executor(lane.checker, self._check, name, password)
        finally:
            lane.guesses.remove((name, remote))
        if problem:
            self.turned_away.note("the bridge", "passwords_file", problem)
        return user

    def _check(self, name: str, password: str) -> tuple[User | None, str]:
        """Check a password in the checker's thread; an unknown name takes as long as a known one.

        Return the user if the password is correct, and the problem of the passwords file if there is one.
        """
        problem = ""
        self._nobody = self._nobody or hash_password("nobody has this one", os.urandom(16))
        try:
            user = read_users(self._passwords).get(name)
        except (OSError, PasswordError) as error:
            user, problem = None, str(error)
        good = matches(password, user.hashed if user else self._nobody)
        return user if good else None, problem

    def _sign_in_page(self, status: int, problem: str) -> web.StreamResponse:
        # Codes and flags are constants that only styles show (see sign_in.html): no text of the request is echoed.
        text = (
            (PAGE / "sign_in.html").read_text(encoding="utf-8").replace('data-problem=""', f'data-problem="{problem}"')
        )
        if self._config.passwords_file and self._passwords.is_file():
            text = text.replace('data-passwords="no"', 'data-passwords="yes"')
        return web.Response(status=status, text=text, content_type="text/html")

    async def _leave(self, request: web.Request) -> web.StreamResponse:
        session = self.session(request)
        self._sign_in.leave(_secret(request))
        if session is not None:
            self._record_done(session, "sign-out")
        response = web.Response(status=303, headers={"Location": "/"})
        response.del_cookie(_cookie(request), path="/")
        return response

    async def _session_state(self, request: web.Request) -> web.StreamResponse:
        session = self.session(request)
        if session is None:
            return web.json_response({"signed_in": False}, status=401)
        return web.json_response({"signed_in": True, "name": session.name, "role": session.role.value})


async def _form(request: web.Request, *fields: str) -> tuple[str, ...]:
    """Return the fields of a form as browsers send it; refuse any other body."""
    if request.content_type != "application/x-www-form-urlencoded":
        raise web.HTTPBadRequest(reason="not a readable form")
    try:
        body = await asyncio.wait_for(request.read(), _BODY_TIMEOUT_S)
        text = body.decode(request.charset or "utf-8")
        form = dict(parse_qsl(text, keep_blank_values=True, errors="strict", max_num_fields=_MAX_FIELDS))
    except asyncio.TimeoutError:
        raise web.HTTPRequestTimeout from None
    except web.HTTPException:
        raise
    except Exception as error:  # aiohttp and its parsers raise many types, and new ones with each version
        raise web.HTTPBadRequest(reason="not a readable form") from error
    return tuple(form.get(field, "") for field in fields)


def _secret(request: web.Request) -> str:
    return request.cookies.get(_cookie(request), "")


def _cookie(request: web.Request) -> str:
    """Return the cookie's name with the port from the browser's request."""
    return f"{COOKIE}_{request.url.port}"
