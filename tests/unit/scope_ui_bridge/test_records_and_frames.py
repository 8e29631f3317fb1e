"""The audit chain, the token's file, the flow control of pictures, and the mailbox between threads."""

from __future__ import annotations

import asyncio
import json
import resource
import signal
import stat
import threading
from collections.abc import Iterator
from pathlib import Path
from types import FrameType

import pytest

from scope_ui_bridge.adapters.mailbox import Mailbox
from scope_ui_bridge.adapters.secret_files import AuditFile, write_secret
from scope_ui_bridge.core.audit import START, AuditError, verify
from scope_ui_bridge.core.frame_window import FrameWindow


def lines(path: Path) -> list[str]:
    return path.read_text(encoding="utf-8").splitlines()


def test_records_are_chained_across_restarts(tmp_path: Path) -> None:
    path = tmp_path / "records" / "audit.jsonl"
    for number in range(2):
        audit = AuditFile(path)
        audit.append({"command": f"press:{number}", "who": "Operator 1"})
        audit.append({"command": "stop", "who": "É"})
        audit.close()
    assert verify(lines(path))[0] == 4
    assert [json.loads(line)["n"] for line in lines(path)] == [1, 2, 3, 4]
    assert json.loads(lines(path)[0])["previous"] == START
    assert stat.S_IMODE(path.stat().st_mode) == 0o600


def test_only_one_bridge_at_a_time_writes_an_audit_file(tmp_path: Path) -> None:
    """A second one, as of a replay in another ROS domain, would break the chain, and no bridge could start any more."""
    path = tmp_path / "audit.jsonl"
    first = AuditFile(path)
    first.append({"command": "press:1"})
    with pytest.raises(OSError, match="is written by another bridge"):
        AuditFile(path)
    first.append({"command": "press:2"})
    first.close()
    second = AuditFile(path)
    second.append({"command": "press:3"})
    second.close()
    assert verify(lines(path))[0] == 3


@pytest.mark.parametrize("damage", ["change", "remove", "swap", "cut"])
def test_damage_is_found_and_refused(tmp_path: Path, damage: str) -> None:
    path = tmp_path / "audit.jsonl"
    audit = AuditFile(path)
    for number in range(4):
        audit.append({"command": f"press:{number}"})
    audit.close()
    text = lines(path)
    if damage == "change":
        text[1] = text[1].replace("press:1", "press:9")
    elif damage == "remove":
        del text[2]
    elif damage == "swap":
        text[1], text[2] = text[2], text[1]
    else:
        text[3] = text[3][:20]
    path.write_text("\n".join(text) + "\n", encoding="utf-8")
    with pytest.raises(AuditError, match=r"line [234]"):
        AuditFile(path)


def test_a_record_that_did_not_fit_on_the_disk_leaves_the_chain_whole(tmp_path: Path) -> None:
    path = tmp_path / "audit.jsonl"
    audit = AuditFile(path)
    audit.append({"command": "press:1"})
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    # Half of the next line fits, as on a disk that becomes full.
    resource.setrlimit(resource.RLIMIT_FSIZE, (path.stat().st_size + 60, hard))
    try:
        for _ in range(2):
            with pytest.raises(OSError, match="File too large"):
                audit.append({"command": "press:2"})
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    audit.append({"command": "press:3"})
    audit.close()
    assert verify(lines(path))[0] == 2
    assert [json.loads(line)["command"] for line in lines(path)] == ["press:1", "press:3"]
    AuditFile(path).close()


def test_the_token_file_is_for_its_owner_only_and_replaces_a_link(tmp_path: Path) -> None:
    elsewhere = tmp_path / "elsewhere"
    elsewhere.write_text("untouched")
    path = tmp_path / "state" / "token"
    path.parent.mkdir()
    path.symlink_to(elsewhere)
    write_secret(path, "abc")
    write_secret(path, "def")
    assert path.read_text() == "def\n"
    assert not path.is_symlink()
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    assert elsewhere.read_text() == "untouched"


def test_at_most_two_pictures_are_under_way_and_none_is_sent_twice() -> None:
    window = FrameWindow()
    assert window.wants(1)
    window.sent(1, 0.0)
    assert not window.wants(1)
    assert window.wants(4)
    window.sent(4, 0.0)
    assert not window.wants(5), "two are under way"
    window.acknowledged(77, 0.1)
    assert not window.open, "a number that was never sent settles nothing"
    window.acknowledged(4, 0.1)
    assert window.wants(5)
    window.acknowledged(1, 0.1)
    window.sent(5, 0.1)
    window.sent(6, 0.1)
    assert not window.open, "an old acknowledgement after a newer one settles nothing"


def test_the_mailbox_keeps_the_newest_picture_and_every_result() -> None:
    async def scenario() -> list[tuple[str, int]]:
        got: list[tuple[str, int]] = []
        box = Mailbox(asyncio.get_running_loop())

        def post() -> None:
            for number in range(50):
                box.newest("picture", lambda n: got.append(("picture", n)), number)
                box.each(lambda n: got.append(("result", n)), number)

        thread = threading.Thread(target=post)  # the loop is blocked by the join: a late loop
        thread.start()
        thread.join()
        await asyncio.sleep(0)
        return got

    got = asyncio.run(scenario())
    assert [n for kind, n in got if kind == "picture"] == [49]
    assert [n for kind, n in got if kind == "result"] == list(range(50))


class Interrupting(str):
    """A name during whose keeping the process gets a signal."""

    __slots__ = ()

    def __hash__(self) -> int:
        signal.raise_signal(signal.SIGUSR1)
        return super().__hash__()


@pytest.fixture
def given_up() -> Iterator[None]:
    """End a call that hangs, with an error."""

    def give_up(number: int, frame: FrameType | None) -> None:
        raise TimeoutError("it hangs")

    before = signal.signal(signal.SIGALRM, give_up)
    signal.setitimer(signal.ITIMER_REAL, 5.0)
    yield
    signal.setitimer(signal.ITIMER_REAL, 0.0)
    signal.signal(signal.SIGALRM, before)


def test_a_signal_for_a_new_token_may_come_while_a_picture_is_handed_over(given_up: None) -> None:
    got: list[str] = []

    async def scenario() -> None:
        box = Mailbox(asyncio.get_running_loop())
        before = signal.signal(signal.SIGUSR1, lambda number, frame: box.each(got.append, "token"))
        try:
            box.newest(Interrupting("picture"), got.append, "picture")
        finally:
            signal.signal(signal.SIGUSR1, before)
        await asyncio.sleep(0)

    asyncio.run(scenario())
    assert sorted(got) == ["picture", "token"]


def test_what_fails_does_not_take_the_others_along(caplog: pytest.LogCaptureFixture) -> None:
    got: list[str] = []

    async def scenario() -> None:
        box = Mailbox(asyncio.get_running_loop())
        box.each(got.append, "first")
        box.each(float, "no number")
        box.each(got.append, "second")
        box.newest("picture", got.append, "picture")
        await asyncio.sleep(0)

    asyncio.run(scenario())
    assert got == ["first", "second", "picture"]
    assert "could not convert string to float: 'no number'" in caplog.text


def test_posting_to_a_closed_loop_does_nothing() -> None:
    loop = asyncio.new_event_loop()
    loop.close()
    got: list[int] = []
    Mailbox(loop).each(got.append, 1)
    assert got == []
