"""The mailbox between the executor's thread and the event loop."""

from __future__ import annotations

import asyncio
import signal
import threading
from collections.abc import Iterator
from types import FrameType

import pytest

from scope_ui_bridge.adapters.mailbox import Mailbox


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
