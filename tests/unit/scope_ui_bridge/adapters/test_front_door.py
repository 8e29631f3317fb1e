"""The door: cookies, passwords, floods of sign-ins, and the ends of sessions."""

from __future__ import annotations

import asyncio
import contextlib
import json
import math
import threading
import time
import unicodedata
from collections.abc import AsyncIterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import aiohttp
import pytest
from unit.scope_ui_bridge.web_rig import WITHIN_S, Page, Rig, page, until, with_rig
from yarl import URL

from scope_ui_bridge.adapters.secret_files import AuditFile, read_users, write_secret
from scope_ui_bridge.adapters.web import front_door
from scope_ui_bridge.core.access import Role, hash_password, matches, new_user, sign_in
from scope_ui_bridge.core.records import verify

pytestmark = pytest.mark.slow


def records(path: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in path.read_text().rpartition("\n")[0].splitlines()]


async def comes_in(client: Page) -> None:
    """Sign in as ada by password, and open the page."""
    form = {"name": "ada", "password": "correct horse"}
    async with client.session.post("/sign-in", data=form, headers=client.origin) as answer:
        assert answer.status == 200
    await client.open()


@pytest.fixture
def long_waits(monkeypatch: pytest.MonkeyPatch) -> None:
    """After a failure the next try is looked at so late that a test which is held up does not miss the refusal."""
    monkeypatch.setattr(sign_in, "_FIRST_WAIT_S", 10.0)


@pytest.mark.parametrize("order", ["own last", "own first"])
def test_the_cookie_of_another_robot_on_the_host_does_not_hide_this_ones(order: str) -> None:
    async def scenario(rig: Rig) -> None:
        async with page(rig) as client:
            (cookie,) = client.session.cookie_jar
            own, other = f"{cookie.key}={cookie.value}", f"icu_session_{rig.server.port + 1}={'x' * 43}"
            _, writer = await asyncio.open_connection("127.0.0.1", rig.server.port)
            both = f"{other}; {own}" if order == "own last" else f"{own}; {other}"
            writer.write(
                f"GET /page/x HTTP/1.1\r\nCookie: {both}\r\n".encode()
            )  # the rest of the request is never sent
            port = writer.get_extra_info("sockname")[1]

            def users() -> list[str]:
                open_ones = (g for g in rig.server.door._listener._gates if g.transport is not None)
                return [g.user for g in open_ones if g.transport.get_extra_info("peername")[1] == port]

            await until(lambda: users() == ["Operator 1"], "it is known before its request is complete")
            writer.close()

    with_rig(scenario)


def test_a_flood_of_sign_ins_is_refused_recorded_briefly_and_does_not_delay_a_stop(
    tmp_path: Path, long_waits: None
) -> None:
    path = tmp_path / "audit.jsonl"

    async def scenario(rig: Rig) -> None:
        async with page(rig) as client, aiohttp.ClientSession(rig.url) as attacker:

            async def guess(number: int) -> int:
                form = {"token": f"guess {number}"}
                async with attacker.post("/sign-in", data=form, headers=client.origin) as answer:
                    return answer.status

            flood = [asyncio.ensure_future(guess(number)) for number in range(200)]
            begin = time.monotonic()
            async with client.session.post("/stop", headers=client.origin) as answer:
                assert answer.status == 200
            took, waiting = time.monotonic() - begin, sum(not sign_in.done() for sign_in in flood)
            codes = await asyncio.gather(*flood)
            assert set(codes) == {401}, "a token is compared at once, without a waiting time"
            await client.enter(rig.sign_in.issue_token())
            assert took < 1.0 or waiting > 100, "on a slow machine the stop still overtakes most of the flood"

    with_rig(scenario, audit=AuditFile(path))
    refused = [entry for entry in records(path) if entry["command"] == "sign-in" and "refused" in entry["result"]]
    assert 1 <= len(refused) <= 5
    assert refused[0]["who"] == "127.0.0.1"


def test_a_flood_of_made_up_paths_fills_no_record(tmp_path: Path) -> None:
    path, many = tmp_path / "audit.jsonl", 300

    async def scenario(rig: Rig) -> None:
        begin_s = time.monotonic()
        async with aiohttp.ClientSession() as stranger:

            async def send(method: str, where: URL) -> int:
                async with stranger.request(method, where, headers={"Origin": "http://elsewhere"}) as answer:
                    return answer.status

            # Any page in any browser that reaches the bridge can send these.
            posts = [send("POST", URL(f"{rig.url}/made-up-{number}")) for number in range(many)]
            climbs = [send("GET", URL(f"{rig.url}/%2e%2e/{number}%0aX", encoded=True)) for number in range(many)]
            assert set(await asyncio.gather(*posts)) == {403}
            assert set(await asyncio.gather(*climbs)) == {404}
        begun.append(time.monotonic() - begin_s)

    begun: list[float] = []
    with_rig(scenario, audit=AuditFile(path))
    found = records(path)
    assert {(entry["who"], entry["command"]) for entry in found} == {("127.0.0.1", "request")}
    assert found[0]["result"] == "refused: '/made-up-0': origin 'http://elsewhere'"
    assert 1 <= len(found) <= 2 + begun[0], "one a second, of all together"


@pytest.fixture
def passwords(tmp_path: Path) -> Path:
    path = tmp_path / "passwords"
    users = [
        new_user("ada", "engineer", "correct horse", b"a" * 16),
        new_user("eve", "viewer", "battery staple", b"e" * 16),
    ]
    write_secret(path, "\n".join(user.line() for user in users))
    return path


def test_passwords_open_the_door_with_the_role_of_the_file(passwords: Path) -> None:
    async def scenario(rig: Rig) -> None:
        for name, password, role in (("ada", "correct horse", "engineer"), ("eve", "battery staple", "viewer")):
            async with page(rig, sign_in=False) as client:
                form = {"name": name, "password": password}
                async with client.session.post("/sign-in", data=form, headers=client.origin) as answer:
                    assert answer.status == 200
                    assert 'id="stop"' in await answer.text()
                hello = await client.open()
                assert (hello["you"]["name"], hello["you"]["role"]) == (name, role)
                taken = await client.ask(type="lease", step="take")
                assert taken["ok"] == (role == "engineer")
                if role == "engineer":
                    await client.ask(type="lease", step="release")

    with_rig(scenario, passwords_file=str(passwords))


def test_a_name_with_umlauts_signs_in_and_is_in_the_records(tmp_path: Path) -> None:
    name, path = "Jürgen Groß", tmp_path / "audit.jsonl"
    file = tmp_path / "passwords"
    write_secret(file, unicodedata.normalize("NFD", new_user(name, "operator", "grüne Wörter", b"j" * 16).line()))

    async def scenario(rig: Rig) -> None:
        async with page(rig, sign_in=False) as client:
            form = {"name": unicodedata.normalize("NFD", f" {name} "), "password": "grüne Wörter"}
            async with client.session.post("/sign-in", data=form, headers=client.origin) as answer:
                assert answer.status == 200
            assert (await client.open())["you"]["name"] == name
            assert (await client.ask(type="lease", step="take"))["ok"]
            state = await client.until(lambda m: m["type"] == "state" and m["lease"]["holder"])
            assert state["lease"]["holder_name"] == name
            await until(lambda: [e["who"] for e in records(path) if e["command"] == "sign-in"] == [name], "the record")

    with_rig(scenario, passwords_file=str(file), audit=AuditFile(path))
    assert verify(path.read_text().splitlines())[0] == len(records(path))


@pytest.mark.parametrize("how", ["own wish", "time is over", "account changed", "pushed out"])
def test_the_end_of_each_sign_in_is_recorded_once_and_that_control_went_with_it(
    passwords: Path, tmp_path: Path, how: str
) -> None:
    path = tmp_path / "audit.jsonl"

    async def scenario(rig: Rig) -> None:
        async with page(rig, sign_in=False) as client:
            await comes_in(client)
            assert (await client.ask(type="lease", step="take"))["ok"]
            if how == "own wish":
                for _ in range(2):
                    async with client.session.post("/sign-out", headers=client.origin):
                        pass
            elif how == "time is over":
                (key,) = rig.sign_in._sessions
                rig.sign_in._sessions[key] = replace(rig.sign_in._sessions[key], ends_s=time.monotonic())
            elif how == "account changed":
                write_secret(passwords, new_user("eve", "operator", "battery staple", b"2" * 16).line())
                rig.server.door._look_s = 0.0  # else once a second
            else:
                user = read_users(passwords)["ada"]
                for _ in range(8):
                    again = partial(rig.sign_in.enter_by_password, user, "ada", "127.0.0.1", time.monotonic())
                    rig.server.mailbox.each(again)
            await until(lambda: rig.desk.lease.holder == "", "the page is sent away")
            async with client.session.get("/session") as answer:
                assert answer.status == 401

    with_rig(scenario, passwords_file=str(passwords), audit=AuditFile(path))
    told = [(e["who"], e["command"], e.get("reason", "")) for e in records(path)]
    assert told[:2] == [("ada", "sign-in", ""), ("ada", "take control", "")]
    why = {
        "own wish": "",
        "time is over": "its time was over",
        "account changed": "its account was changed",
        "pushed out": "8 newer ones of the same user",
    }[how]
    assert told[2:] == [("ada", "sign-out", why), ("ada", "lose control", "signed out")]


@pytest.mark.parametrize("change", ["taken out", "another role", "another password"])
def test_who_is_changed_in_the_file_must_sign_in_anew(passwords: Path, change: str) -> None:
    before = passwords.read_text()
    ada = read_users(passwords)["ada"]
    changed = {
        "taken out": "",
        "another role": replace(ada, role=Role.VIEWER).line(),
        "another password": replace(ada, hashed=hash_password("another horse", b"1" * 16)).line(),
    }[change]

    async def scenario(rig: Rig) -> None:
        async with page(rig, sign_in=False) as client:
            await comes_in(client)
            assert (await client.ask(type="lease", step="take"))["ok"]

            async def signed_in() -> bool:
                rig.server.door._look_s = 0.0  # else once a second
                async with client.session.get("/session") as answer:
                    return answer.status == 200

            write_secret(passwords, before.replace("eve:", "Eve:"))  # another program's line
            assert await signed_in()
            passwords.write_text("ada:nonsense")  # in the middle of an edit
            assert await signed_in()
            write_secret(passwords, before.replace(ada.line(), changed))
            assert not await signed_in()
            await client.send(type="alive", client_ms=1.0)
            await until(lambda: rig.desk.lease.holder == "", "the page is sent away")

    with_rig(scenario, passwords_file=str(passwords))


async def signed_in_s(client: Page) -> float:
    """Return the rest of this page's sign-in, as the bridge reports it; infinite while there is no hurry."""
    await client.send(type="alive", client_ms=1.0)
    answer = await client.until(lambda m: m["type"] == "alive" and m["client_ms"] == 1.0)
    return float(answer.get("sign_in_ends_s", "inf"))


@contextlib.asynccontextmanager
async def kept_alive(client: Page) -> AsyncIterator[None]:
    """Send the page's keep-alives: a password check on a busy computer lasts longer than a page may be silent."""

    async def send() -> None:
        while True:
            await client.send(type="alive", client_ms=0.0)
            await asyncio.sleep(0.2)

    task = asyncio.create_task(send())
    try:
        yield
    finally:
        task.cancel()


@pytest.mark.parametrize("by", ["password", "token"])
def test_who_signs_in_again_in_time_keeps_control_page_and_motion(
    passwords: Path, tmp_path: Path, by: str, long_waits: None
) -> None:
    """The lifetime is 100 s; the end of the session is set to the last seconds before the next one."""
    path = tmp_path / "audit.jsonl"

    def again() -> list[tuple[str, str]]:
        return [(e["who"], e["result"]) for e in records(path) if e["command"] == "sign-in again"]

    async def scenario(rig: Rig) -> None:
        async with page(rig, sign_in=by == "token", take=by == "token") as client:
            if by == "password":
                await comes_in(client)
                assert (await client.ask(type="lease", step="take"))["ok"]
            assert client.hello["you"]["by_password"] == (by == "password")
            assert await signed_in_s(client) == math.inf
            (cookie,) = rig.sign_in._sessions
            session = rig.sign_in._sessions[cookie]
            rig.sign_in._sessions[cookie] = replace(session, ends_s=time.monotonic() + 30.0)
            assert 20.0 < await signed_in_s(client) <= 30.0
            rig.server.mailbox.each(rig.desk.machine.set_state, "driver", "moving")
            holder, epoch = rig.desk.lease.holder, rig.desk.lease.epoch
            async with kept_alive(client):
                async with client.session.post("/renew", data={"secret": "wrong"}, headers=client.origin) as answer:
                    assert (answer.status, (await answer.json())["code"]) == (401, f"wrong_{by}")
                secret = rig.sign_in.issue_token() if by == "token" else "correct horse"
                if by == "password":
                    async with client.session.post("/renew", data={"secret": secret}, headers=client.origin) as answer:
                        assert (answer.status, (await answer.json())["code"]) == (429, "wait"), (
                            "guesses are slowed down"
                        )
                    rig.sign_in._failures.clear()
                async with client.session.post("/renew", data={"secret": secret}, headers=client.origin) as answer:
                    assert (answer.status, await answer.json()) == (200, {"ok": True})
                    assert "Set-Cookie" not in answer.headers, "open connections go on with the one they have"
                assert await signed_in_s(client) == math.inf
            assert (rig.desk.lease.holder, rig.desk.lease.epoch) == (holder, epoch)
            assert rig.graph.named("stop") == []
            if by == "token":
                async with client.session.post("/renew", data={"secret": secret}, headers=client.origin) as answer:
                    assert answer.status == 401, "a token signs in once"
            async with client.session.post("/sign-out", headers=client.origin):
                pass
            rig.sign_in._failures.clear()
            async with client.session.post("/renew", data={"secret": secret}, headers=client.origin) as answer:
                assert (answer.status, (await answer.json())["code"]) == (401, "signed_out"), "too late"
            await until(lambda: ("127.0.0.1", "refused: signed_out") in again(), "the records")
            who = client.hello["you"]["name"]
            assert again()[:2] == [(who, f"refused: wrong_{by}"), (who, "done")]
            assert again().count((who, "done")) == 1

    with_rig(scenario, passwords_file=str(passwords), sign_in_warning_s=50.0, audit=AuditFile(path))


def test_nobody_is_kept_signed_in_by_another_ones_secret(passwords: Path) -> None:
    async def scenario(rig: Rig) -> None:
        async with page(rig) as client:  # by a token
            (before,) = rig.sign_in._sessions.values()
            for form in ({"secret": "correct horse"}, {"name": "ada", "secret": "correct horse"}, {}):
                rig.sign_in._failures.clear()
                async with client.session.post("/renew", data=form, headers=client.origin) as answer:
                    assert (answer.status, (await answer.json())["code"]) == (401, "wrong_token")
            foreign = {"Origin": "https://elsewhere.example"}
            form = {"secret": rig.sign_in.issue_token()}
            async with client.session.post("/renew", data=form, headers=foreign) as answer:
                assert answer.status == 403
            assert list(rig.sign_in._sessions.values()) == [before]

    with_rig(scenario, passwords_file=str(passwords))


@pytest.mark.parametrize(
    "form", [{"name": "ada", "password": "wrong"}, {"name": "nobody", "password": "correct horse"}]
)
def test_wrong_names_and_passwords_look_alike_and_are_slowed_down(
    passwords: Path, form: dict[str, str], long_waits: None
) -> None:
    async def scenario(rig: Rig) -> None:
        async with page(rig, sign_in=False) as client:
            async with client.session.get("/") as answer:
                assert 'data-passwords="yes"' in await answer.text()
            async with client.session.post("/sign-in", data=form, headers=client.origin) as answer:
                assert answer.status == 401
                text = await answer.text()
            assert 'data-problem="wrong_password"' in text
            assert form["name"] not in text
            good = {"name": "ada", "password": "correct horse"}
            for again in (form, form | {"password": "correct horse"}):
                async with client.session.post("/sign-in", data=again, headers=client.origin) as answer:
                    assert (answer.status, int(answer.headers["Retry-After"]) >= 1) == (429, True)
            other = {"name": "eve", "password": "battery staple"} if form["name"] == "ada" else good
            async with client.session.post("/sign-in", data=other, headers=client.origin) as answer:
                assert answer.status == 200, "guesses at one account do not keep other users out"

    with_rig(scenario, passwords_file=str(passwords))


@pytest.mark.parametrize("first", ["correct horse", "wrong"])
def test_two_who_sign_in_at_once_from_one_address_both_come_in_unless_the_first_fails(
    passwords: Path, monkeypatch: pytest.MonkeyPatch, long_waits: None, first: str
) -> None:
    """A user of a tunnel has the address of the bridge's own machine; and a button is clicked twice."""
    both_there = threading.Event()
    checked: list[str] = []

    def slow(password: str, hashed: str) -> bool:
        assert both_there.wait(WITHIN_S)
        checked.append(password)
        return matches(password, hashed)

    monkeypatch.setattr(front_door, "matches", slow)

    async def scenario(rig: Rig) -> None:
        async def enters(client: Page, name: str, password: str) -> int:
            form = {"name": name, "password": password}
            async with client.session.post("/sign-in", data=form, headers=client.origin) as answer:
                return answer.status

        async with page(rig, sign_in=False) as one, page(rig, sign_in=False) as other:
            ada = asyncio.ensure_future(enters(one, "ada", first))
            await until(lambda: len(rig.server.door._strangers.guesses) == 1, "the first is looked at")
            second = ("ada", "correct horse") if first == "wrong" else ("eve", "battery staple")
            eve = asyncio.ensure_future(enters(other, *second))
            await until(lambda: len(rig.server.door._strangers.guesses) == 2 or eve.done(), "the second has come")
            both_there.set()
            found = await asyncio.wait_for(asyncio.gather(ada, eve), WITHIN_S)
        if first == "wrong":
            assert (found, checked) == ([401, 429], ["wrong"]), "guesses at once are slowed down as those one by one"
        else:
            assert (found, checked) == ([200, 200], ["correct horse", "battery staple"])
        assert rig.server.door._strangers.guesses == []

    try:
        with_rig(scenario, passwords_file=str(passwords))
    finally:
        both_there.set()


def test_no_more_than_a_few_passwords_of_one_address_wait_and_others_find_a_place(
    passwords: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    all_there = threading.Event()
    monkeypatch.setattr(front_door, "matches", lambda password, hashed: all_there.wait(WITHIN_S) and False)

    async def scenario(rig: Rig) -> None:
        door = rig.server.door
        async with page(rig, sign_in=False) as client:

            async def guess() -> int:
                form = {"name": "ada", "password": "guess"}
                async with client.session.post("/sign-in", data=form, headers=client.origin) as answer:
                    return answer.status

            flood = [asyncio.ensure_future(guess()) for _ in range(20)]
            await until(lambda: sum(one.done() for one in flood) == 17, "those for whom there is no place")
            assert door._strangers.guesses == [("ada", "127.0.0.1")] * 3
            assert front_door._MAX_GUESSES == 8
            all_there.set()
            found = await asyncio.wait_for(asyncio.gather(*flood), WITHIN_S)
            assert sorted(found) == [401] + [429] * 19

    try:
        with_rig(scenario, passwords_file=str(passwords))
    finally:
        all_there.set()


def test_a_file_of_passwords_that_others_may_read_opens_nothing_and_is_recorded(
    passwords: Path, tmp_path: Path
) -> None:
    path = tmp_path / "audit.jsonl"
    passwords.chmod(0o644)

    async def scenario(rig: Rig) -> None:
        rig.server._loop.set_debug(True)  # passwords are checked in a thread, which must not touch the loop's things
        async with page(rig, sign_in=False) as client:
            form = {"name": "ada", "password": "correct horse"}
            async with client.session.post("/sign-in", data=form, headers=client.origin) as answer:
                assert answer.status == 401

    with_rig(scenario, passwords_file=str(passwords), audit=AuditFile(path))
    (found,) = [entry for entry in records(path) if entry["command"] == "passwords_file"]
    assert "has mode 644; 600 is needed" in found["result"]


def test_without_a_file_no_password_is_good() -> None:
    async def scenario(rig: Rig) -> None:
        async with page(rig, sign_in=False) as client:
            form = {"name": "ada", "password": ""}
            async with client.session.post("/sign-in", data=form, headers=client.origin) as answer:
                assert answer.status == 401

    with_rig(scenario)
