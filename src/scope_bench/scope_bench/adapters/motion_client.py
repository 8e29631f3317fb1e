"""Reads the mock board's motor positions from its Unix socket, and connects again when the board has gone."""

from __future__ import annotations

import json
import os
import socket
from dataclasses import dataclass
from pathlib import Path
from typing import Any

MAX_LINE_BYTES = 65536
STEP_ANSWER_S = 10.0
"""Wall seconds within which a stepped board answers."""


@dataclass(frozen=True, slots=True, kw_only=True)
class MotorSample:
    """One line: true positions in mm, tool pins, and when by the monotonic clock, in seconds."""

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
        If something is missing or of the wrong kind.
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
        self.sent = self.received = 0
        """Bytes that the board's serial port has sent and received, as of the newest step."""
        self._buffer = b""

    def connect(self) -> bool:
        """Try once; tell whether the board answers."""
        link = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        try:
            # A Unix socket connects at once or not at all.
            link.setblocking(False)
            link.connect(os.fspath(self.path))
        except OSError:
            link.close()
            return False
        self.socket, self._buffer = link, b""
        return True

    def read(self) -> list[MotorSample]:
        """Return the samples that have come; afterwards ``socket`` is None if the board has gone."""
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
        """Let a stepped board run until ``until_s``, and return the samples on the way there.

        Afterwards ``socket`` is None if the board has gone, or has not answered within ``within_s``.
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
            return [parse_sample(line)]
        except ValueError:
            self.bad_lines += 1
            return []

    def close(self) -> None:
        """Drop the connection."""
        if self.socket is not None:
            self.socket.close()
            self.socket = None
