"""Damages of lines, for a time, and by real-time bytes; the mock board's serial line has those of single bytes."""

from __future__ import annotations

import random
from collections.abc import Callable

from gantry_driver.mock.serial_line import CONTEXT_BYTES, Damage

REALTIME = bytes([*b"!~?\x18\x84\x85", *range(0x90, 0x98), *range(0x99, 0x9F), 0xA0, 0xA1])
LATE_S = 0.2
"""Longest time that a line waits for the next one to pass it."""


class OtherDamage(Damage):
    """One damage; ``clock`` returns the time in seconds and is set before the first byte passes."""

    kinds = (
        "inserted",
        "realtime",
        "stuck",
        "silent",
        "no questions",
        "line lost",
        "line emptied",
        "line doubled",
        "lines merged",
        "lines swapped",
        "line repeated",
    )
    """A real-time byte inserted, a byte replaced by one, a bit stuck, or nothing or no ``?`` for a time. Or a line
    lost, without its text, twice, without its end, behind the next one, or a second time much later."""
    clock: Callable[[], float]

    def __init__(self, kind: str, after: int, rng: random.Random) -> None:
        super().__init__(kind, after, rng)
        self._for_s = {"stuck": rng.uniform(0.05, 0.4), "silent": rng.uniform(0.05, 1.0), "no questions": 1.0}.get(kind)
        self._bit, self._set = 1 << rng.randrange(8), rng.random() < 0.5
        self._repeat_s = rng.uniform(0.01, 0.5)
        self._until = 0.0
        self._line = bytearray()
        self._kept = b""

    @property
    def done(self) -> bool:
        """Whether it has happened, all of it."""
        if self._for_s is not None and self.begun and self.clock() >= self._until:
            self._left = 0
        return self._left == 0

    def apply(self, data: bytes) -> bytes:
        """Return what arrives of ``data``."""
        out = bytearray()
        for at in range(len(data)):
            byte = data[at : at + 1]
            if self.done or (self._after > 0 and not self._kind_waits(byte)):
                out += byte
            else:
                out += self._one(byte)
        if self._kept and self.clock() >= self._until:
            out[:0] = self._finish(self._kept)
        if self.begun and len(self.was) < 2 * CONTEXT_BYTES:
            self.was, self.became = self.was + data, self.became + bytes(out)
        return bytes(out)

    def _kind_waits(self, byte: bytes) -> bool:
        """Count the bytes that pass before the damage; one of a line begins with the next line."""
        self._after -= 1
        if self.kind.startswith("line") and self._after <= 0 and byte != b"\n":
            self._after = 1
        return False

    def _one(self, byte: bytes) -> bytes:
        of_lines = self.kind.startswith("line")
        if of_lines and byte[0] in REALTIME and not self._line:
            return byte
        if not self.begun:
            self.was = self.became = b" "
            self._until = self.clock() + (self._for_s or 0.0)
        if self.kind == "inserted":
            return self._finish(self._realtime() + byte)
        if self.kind == "realtime":
            return self._finish(self._realtime())
        if self.kind == "stuck":
            return bytes([byte[0] | self._bit if self._set else byte[0] & ~self._bit])
        if self.kind == "silent":
            return b""
        if self.kind == "no questions":
            return b"" if byte == b"?" else byte
        self._line += byte
        if byte != b"\n":
            return b""
        line, self._line = bytes(self._line), bytearray()
        return self._whole(line)

    def _whole(self, line: bytes) -> bytes:
        if self.kind == "line lost":
            return self._finish(b"")
        if self.kind == "line emptied":
            return self._finish(b"\n")
        if self.kind == "line doubled":
            return self._finish(line * 2)
        if self.kind == "lines merged":
            return self._finish(line.rstrip(b"\r\n"))
        if self._kept:  # the second of two
            return self._finish(line + self._kept)
        self._kept = line
        self._until = self.clock() + (LATE_S if self.kind == "lines swapped" else self._repeat_s)
        if self.kind == "line repeated":
            self._left = 0
            return line
        return b""

    def _realtime(self) -> bytes:
        return bytes([self._rng.choice(REALTIME)])

    def _finish(self, arrives: bytes) -> bytes:
        self._left, self._kept = 0, b""
        return arrives
