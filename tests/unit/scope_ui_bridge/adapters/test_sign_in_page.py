"""Sign-in as a browser sees it, and the headers of the page."""

from __future__ import annotations

import asyncio
import re

import aiohttp
import pytest
from unit.scope_ui_bridge.web_rig import WITHIN_S, Page, Rig, page, until, with_rig

from scope_ui_bridge.adapters.web.front_door import COOKIE, PAGE


def test_the_token_gives_a_strict_cookie_once_and_the_page_with_its_headers() -> None:
    async def scenario(rig: Rig) -> None:
        async with page(rig, sign_in=False) as client:
            async with client.session.get("/") as answer:
                assert answer.status == 401
                assert "Sign in" in await answer.text()
            async with client.session.head("/", params={"token": rig.token}) as answer:
                assert answer.status == 405, "a HEAD does not use the token up"
            async with client.session.get("/", params={"token": rig.token}) as answer:
                assert answer.status == 200
                assert 'id="stop"' in await answer.text()
                cookie = answer.headers["Set-Cookie"]
                policy = answer.headers["Content-Security-Policy"]
            assert cookie.startswith(f"{COOKIE}_{rig.server.port}=")
            assert "HttpOnly" in cookie
            assert "SameSite=Strict" in cookie
            assert "frame-ancestors 'none'" in policy
            assert "unsafe" not in policy
            async with client.session.get("/session") as answer:
                assert (answer.status, (await answer.json())["name"]) == (200, "Operator 1")
            async with client.session.get("/", params={"token": "old"}) as answer:
                assert answer.status == 200, "who is signed in needs no token"
        async with page(rig, sign_in=False) as other, other.session.get("/", params={"token": rig.token}) as answer:
            assert answer.status == 401
            assert 'data-problem="wrong_token"' in await answer.text()

    with_rig(scenario)


def test_the_sign_in_form_works() -> None:
    async def scenario(rig: Rig) -> None:
        async with page(rig, sign_in=False) as client:
            bad = {"token": "<script>alert(1)</script>"}
            async with client.session.post("/sign-in", data=bad, headers=client.origin) as answer:
                assert answer.status == 401
                assert "alert(1)" not in await answer.text()
            form = {"token": f" {rig.token}\n"}
            async with client.session.post("/sign-in", data=form, headers=client.origin) as answer:
                assert answer.status == 200
                assert 'id="stop"' in await answer.text()

    with_rig(scenario)


@pytest.mark.parametrize("what", ["image", "iframe", "empty"])
def test_a_foreign_page_that_guesses_tokens_shuts_nobody_out(what: str) -> None:
    async def scenario(rig: Rig) -> None:
        async with page(rig, sign_in=False) as client:
            # Headers of a browser for an image, a frame or a request on a page; an image requires no Origin.
            part = {"Sec-Fetch-Dest": what, "Sec-Fetch-Site": "cross-site"}
            for token in ("guess", rig.token):
                async with client.session.get("/", params={"token": token}, headers=part) as answer:
                    assert answer.status == 401
            async with client.session.get("/", params={"token": rig.token}) as answer:
                assert answer.status == 200, "neither waits, nor was the token used up"

    with_rig(scenario)


def test_one_browser_is_signed_in_at_two_robots_of_one_host() -> None:
    async def scenario(rig: Rig) -> None:
        # Browsers keep cookies by host, whatever the port; so does this jar.
        with Rig() as other:
            async with page(rig) as client, aiohttp.ClientSession(cookie_jar=client.session.cookie_jar) as browser:
                beside = Page(other, browser)
                token = other.sign_in.issue_token()  # the rigs' secrets are numbered: now both sessions' differ
                async with browser.get(f"{other.url}/", params={"token": token}) as answer:
                    assert answer.status == 200
                for bed in (client, beside):
                    async with browser.post(f"{bed.rig.url}/stop", headers=bed.origin) as answer:
                        assert answer.status == 200
                    assert len(bed.rig.graph.named("stop")) == 1
                async with browser.post(f"{other.url}/sign-out", headers=beside.origin) as answer:
                    assert answer.status == 401
                async with client.session.get("/session") as answer:
                    assert answer.status == 200, "who signs out there is still signed in here"

    with_rig(scenario)


@pytest.mark.parametrize("meanwhile", ["speaks", "says nothing", "only pings"])
def test_signing_out_ends_the_session_and_its_connections(meanwhile: str) -> None:
    async def ends(rig: Rig, client: Page) -> None:
        if meanwhile == "speaks":
            await client.send(type="alive", client_ms=1.0)
        elif meanwhile == "only pings":
            await client.control.ping()
        while True:
            message = await client.control.receive(timeout=WITHIN_S)
            if message.type in (aiohttp.WSMsgType.CLOSE, aiohttp.WSMsgType.CLOSED):
                break
            if message.type is aiohttp.WSMsgType.PONG:
                await client.control.ping()
        while not client.video.closed:
            await client.video.receive(timeout=WITHIN_S)

    async def scenario(rig: Rig) -> None:
        async with page(rig, take=True) as client:
            if meanwhile == "only pings":
                assert (await client.ask(type="lease", step="release"))["ok"]
                client.control = await client.session.ws_connect("/control", headers=client.origin, autoping=False)
                client.seq = 0
                assert (await client.ask(type="lease", step="take"))["ok"]
            await client.open_video()
            await until(lambda: rig.server.video._viewers, "the pictures are asked for")
            rig.server.mailbox.each(rig.desk.machine.set_state, "driver", "moving")
            await client.until(lambda m: m["type"] == "state" and m["moving"])
            async with client.session.post("/sign-out", headers=client.origin) as answer:
                assert answer.status == 401
                assert 'data-problem=""' in await answer.text(), "a person who signs out sees no warning"
            await asyncio.wait_for(ends(rig, client), WITHIN_S)
            await until(lambda: rig.desk.lease.holder == "", "the lease is free")
            assert len(rig.graph.named("stop")) == 1
        assert rig.desk.join("Operator 2")[1]["log"][-1]["target"] == "stopped_signed_out"

    with_rig(scenario)


def test_the_page_has_no_inline_script_or_style_and_nothing_from_elsewhere() -> None:
    for name in ("index.html", "sign_in.html"):
        text = (PAGE / name).read_text()
        assert not re.search(r"<script(?![^>]*src=)|<style|\sstyle=|\son\w+=", text)
    scripts = (file for file in PAGE.rglob("*") if file.suffix in (".html", ".js", ".css", ".svg"))
    for file in (
        file for file in scripts if "vendor" not in file.parts
    ):  # a library's comments name its authors' pages
        foreign = re.findall(r"https?://(?!www\.w3\.org/)", file.read_text())
        assert foreign == [], file.name
