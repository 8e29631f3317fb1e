"""Reads the mock board's motor positions from its Unix socket, and reconnects when the board has ended."""

from __future__ import annotations

import json
import os
import socket
from dataclasses import dataclass
from pathlib import Path
from typing import Any

MAX_LINE_BYTES = 65536
STEP_ANSWER_S = 10.0
"""Maximum wall seconds for the answer of a stepped board."""


@dataclass(frozen=True, slots=True, kw_only=True)
class MotorSample:
    """One line: true positions in mm, tool pins, and time by the monotonic clock in seconds."""

    time_s: float
    mpos_mm: tuple[float, float, float]
    spindle: float
    coolant: bool
    state: str


def parse_sample(line: bytes) -> MotorSample:
    """Read one JSON line.

    Raises
    ------
    ValueError
        If a value is missing or has the wrong type.
    """
    document: Any = json.loads(line)
    try:
        x, y, z = (float(v) for v in document["mpos"])
        return MotorSample(
            time_s=float(document["t"]),
            mpos_mm=(x, y, z),
            spindle=float(document["spindle"]),
            coolant=bool(document["coolant"]),
            state=str(document["state"]),
        )
    except (KeyError, TypeError) as error:
        raise ValueError(f"not a motor sample: {line[:200]!r}: {error!r}") from error


class MotionClient:
    """A connection that may come and go; only :meth:`advance` waits."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.socket: socket.socket | None = None
        self.bad_lines = 0
        self.probe_closed = False
        """The board's probe input as this client has set it; a board forgets it with the connection."""
        self.board_s = 0.0
        """Time that the board has reached, by its newest sample."""
        self.sent = self.received = 0
        """Bytes that the board's serial port has sent and received, as of the newest step."""
        self._buffer = b""

    def connect(self) -> bool:
        """Try once; return whether the board answers."""
        link = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        try:
            # A Unix socket connects at once or not at all.
            link.setblocking(False)
            link.connect(os.fspath(self.path))
        except OSError:
            link.close()
            return False
        self.socket, self._buffer, self.probe_closed = link, b"", False
        return True

    def set_probe(self, closed: bool) -> None:
        """Connect the board's probe input to ground or open it; ``socket`` is then None if the board has ended."""
        if self.socket is None or closed == self.probe_closed:
            return
        try:
            self.socket.sendall(json.dumps({"probe": closed}).encode() + b"\n")
            self.probe_closed = closed
        except OSError:
            self.close()

    def read(self) -> list[MotorSample]:
        """Return the received samples; ``socket`` is then None if the board has ended."""
        data = b""
        try:
            data = self.socket.recv(1 << 20) if self.socket is not None else b""
        except BlockingIOError:
            return []
        except OSError:
            pass
        if not data:
            self.close()
            return []
        *lines, self._buffer = (self._buffer + data).split(b"\n")
        if len(self._buffer) > MAX_LINE_BYTES:
            self.bad_lines += 1
            self._buffer = b""
        samples: list[MotorSample] = []
        for line in filter(None, lines):
            samples += self._parsed(line)
        return samples

    def advance(self, until_s: float, within_s: float = STEP_ANSWER_S) -> list[MotorSample]:
        """Run a stepped board until ``until_s``, and return the samples up to then.

        Afterwards ``socket`` is None if the board has ended, or has not answered within ``within_s``.
        """
        if self.socket is None:
            return []
        samples: list[MotorSample] = []
        self.socket.settimeout(within_s)
        try:
            self.socket.sendall(json.dumps({"until": until_s}).encode() + b"\n")
            while self.socket is not None:
                while (end := self._buffer.find(b"\n")) >= 0:
                    line, self._buffer = self._buffer[:end], self._buffer[end + 1 :]
                    if line.startswith(b'{"until"'):
                        answer = json.loads(line)
                        self.sent, self.received = int(answer["sent"]), int(answer["received"])
                        self.socket.setblocking(False)
                        return samples
                    samples += self._parsed(line)
                data = self.socket.recv(1 << 20)
                if not data:
                    self.close()
                self._buffer += data
        except (OSError, ValueError, KeyError):
            self.close()
        return samples

    def _parsed(self, line: bytes) -> list[MotorSample]:
        try:
            sample = parse_sample(line)
            self.board_s = sample.time_s
            return [sample]
        except ValueError:
            self.bad_lines += 1
            return []

    def close(self) -> None:
        """Drop the connection."""
        if self.socket is not None:
            self.socket.close()
            self.socket = None
