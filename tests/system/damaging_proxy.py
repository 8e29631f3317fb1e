"""A proxy on the pseudo-terminal between driver and board that damages bytes in both directions."""

from __future__ import annotations

import contextlib
import math
import os
import random
import selectors
import socket
import threading
import tty
from pathlib import Path

from support.deadlines import wait_until

from gantry_driver.mock.pty_port import OPEN_POLL_S, PtyPort
from gantry_driver.mock.serial_line import Damage

PLUGGED_WITHIN_S = 30.0
PIECE_BYTES = 4096
KEPT = 40
"""Damages to keep for a failure's message."""


class Direction:
    """Bytes one way, of which one in ``apart`` is the begin of a damage while ``damaging``."""

    def __init__(self, name: str, apart: int, rng: random.Random) -> None:
        self.name, self.damaging = name, False
        self.passed = self.count = 0
        self.done: list[str] = []
        self._apart, self._rng = apart, rng
        self._next = self._draw()

    def _draw(self) -> Damage:
        after = math.floor(math.log(1.0 - self._rng.random()) / math.log(1.0 - 1.0 / self._apart))
        return Damage(self._rng.choice(Damage.kinds), after, self._rng)

    def apply(self, data: bytes) -> bytes:
        if not (self.damaging or (self._next.begun and not self._next.done)):
            return data
        self.passed += len(data)
        data = self._next.apply(data)
        if self._next.done:
            self.count += 1
            self.done = [*self.done[1 - KEPT :], f"{self._next.kind}: {self._next.was!r} to {self._next.became!r}"]
            self._next = self._draw()
        return data


class DamagingProxy:
    """Opens the board whenever the driver opens the proxy, and passes bytes on; used as a context."""

    def __init__(self, board: Path, link: Path, apart: int, seed: int) -> None:
        self._board_path = board
        self._selector = selectors.DefaultSelector()
        rng = random.Random(seed)
        self.to_board, self.from_board = Direction("to the board", apart, rng), Direction("from the board", apart, rng)
        self._board: int | None = None
        self._port = PtyPort(self._selector, link, self._from_driver, self._opened)
        self._wake_read, self._wake_write = socket.socketpair()
        self._selector.register(self._wake_read, selectors.EVENT_READ, lambda: None)
        self._ended = False
        self._thread = threading.Thread(target=self._run, name="damaging proxy")

    def __enter__(self) -> DamagingProxy:
        self._thread.start()
        return self

    def __exit__(self, *error: object) -> None:
        self._ended = True
        self._wake_write.send(b"\0")
        self._thread.join()
        self._close_board()
        self._port.unplug()
        self._selector.close()
        self._wake_read.close()
        self._wake_write.close()

    def damage(self, on: bool) -> None:
        """Begin or end to damage bytes."""
        self.to_board.damaging = self.from_board.damaging = on

    def described(self) -> str:
        """Return what was damaged, for the message of a failure."""
        ways = (self.to_board, self.from_board)
        return "\n".join(
            line
            for way in ways
            for line in (f"{way.name}: {way.count} damages to {way.passed} bytes, the last:", *way.done)
        )

    def _run(self) -> None:
        while not self._ended:
            for key, _ in self._selector.select(OPEN_POLL_S if self._port.waiting else None):
                if key.fileobj in self._selector.get_map():
                    key.data()
            if self._board is not None and not self._port.is_open:
                self._close_board()  # so that the board's side hangs up, too
            self._port.poll()

    def _opened(self) -> None:
        def opened() -> int | None:
            with contextlib.suppress(FileNotFoundError):
                return os.open(self._board_path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
            return None

        self._board = board = wait_until(opened, f"a board at {self._board_path}", PLUGGED_WITHIN_S)
        tty.setraw(board)
        self._selector.register(board, selectors.EVENT_READ, self._from_board)

    def _close_board(self) -> None:
        if self._board is not None:
            self._selector.unregister(self._board)
            os.close(self._board)
            self._board = None

    def _from_driver(self, data: bytes) -> None:
        if self._board is not None and (data := self.to_board.apply(data)):
            with contextlib.suppress(OSError):  # gone; the driver finds out by the silence
                os.write(self._board, data)

    def _from_board(self) -> None:
        assert self._board is not None
        try:
            data = os.read(self._board, PIECE_BYTES)
        except OSError:
            data = b""
        if not data:
            self._close_board()
        elif data := self.from_board.apply(data):
            self._port.write(data)
