"""The proxy between driver and board: it passes every byte on, and damages one in each given number of them."""

from __future__ import annotations

import os
import random
import select
import time
import tty
from pathlib import Path

from nodes.grbl_board import GrblBoard
from support.deadlines import wait_until
from system.damaging_proxy import DamagingProxy, Direction

ANSWER_WITHIN_S = 20.0


def test_one_byte_in_five_hundred_is_damaged_while_it_is_told_to() -> None:
    direction, sent = Direction("to the board", 500, random.Random(1)), os.urandom(100)
    assert b"".join(direction.apply(sent) for _ in range(100)) == sent * 100
    direction.damaging = True
    damaged = sum(direction.apply(sent) != sent for _ in range(2000))
    assert 320 < direction.count < 480, "200,000 bytes have 400 damages, one in 500"
    assert 300 < damaged < 480
    direction.damaging = False
    direction.apply(sent)  # the rest of a swap or burst that has begun
    assert b"".join(direction.apply(sent) for _ in range(100)) == sent * 100


def test_the_proxy_opens_the_board_with_the_driver_and_passes_bytes_on(tmp_path: Path) -> None:
    board, link = GrblBoard(tmp_path), tmp_path / "noisy"
    try:
        with DamagingProxy(board.port, link, 500, seed=1) as proxy:
            assert board.log(0, "opened") == [], "the driver has not opened its port yet"
            for number in (1, 2):
                port = os.open(link, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
                tty.setraw(port)
                assert "Grbl 1.1h" in read_until(port, "unlock]\r\n")
                os.write(port, b"$G\n")
                assert "[GC:G0 G54" in read_until(port, "ok\r\n")
                os.close(port)
                wait_until(lambda: not board.ask("state")["open"], "the board's port is closed", ANSWER_WITHIN_S)
                assert len(board.log(0, "opened")) == number
            assert proxy.to_board.count == proxy.from_board.count == 0
            assert [entry["text"] for entry in board.lines()] == ["$G", "$G"]
    finally:
        board.close()


def read_until(port: int, end: str) -> str:
    deadline, text = time.monotonic() + ANSWER_WITHIN_S, ""
    while end not in text:
        assert select.select([port], [], [], max(deadline - time.monotonic(), 0.0))[0], text
        text += os.read(port, 4096).decode()
    return text
