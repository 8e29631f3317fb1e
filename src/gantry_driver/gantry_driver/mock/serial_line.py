"""The mock board's serial line: both directions take the time of the baud rate, and bytes can be damaged in transit."""

from __future__ import annotations

import random
import re
from collections import deque
from dataclasses import dataclass

BITS_PER_BYTE = 10
_SIGNIFICANT = re.compile(rb"[\n\r?!~\x18\x80-\xff]")


CONTEXT_BYTES = 24
"""Maximum number of bytes before and after the damaged ones in :attr:`Damage.was` and :attr:`Damage.became`."""


class Damage:
    """One damage to the bytes of one direction.

    Parameters
    ----------
    kind
        One of :attr:`kinds`.
    after
        Number of bytes that pass undamaged before it.
    rng
        Source of the damaged values.

    Attributes
    ----------
    was, became
        The bytes around the damage as they were sent and as they arrived; empty before the damage.
    """

    kinds = ("flip", "lost", "doubled", "swapped", "replaced", "burst")
    """One bit flipped, a byte lost, a byte doubled, two neighbours swapped, a byte replaced, 2 to 8 bytes replaced."""

    def __init__(self, kind: str, after: int, rng: random.Random) -> None:
        if kind not in self.kinds:
            raise ValueError(f"kind = {kind!r}: expected one of {', '.join(self.kinds)}")
        self.kind = kind
        self.was = self.became = b""
        self._after = after
        self._rng = rng
        self._left = {"swapped": 2, "burst": rng.randint(2, 8)}.get(kind, 1)
        self._held = b""

    @property
    def done(self) -> bool:
        """Whether the damage is complete."""
        return self._left == 0

    @property
    def begun(self) -> bool:
        """Whether a damaged byte has passed, or is held back."""
        return bool(self.was)

    def apply(self, data: bytes) -> bytes:
        """Return the bytes of ``data`` as they arrive."""
        if self._left == 0:
            return data
        if self._after >= len(data):
            self._after -= len(data)
            return data
        first, out = self._after, bytearray(data[: self._after])
        self._after, at = 0, first
        while self._left and at < len(data):
            self._left -= 1
            out += self._damaged(data[at : at + 1])
            at += 1
        end = len(out)
        out += data[at:]
        begin = max(first - CONTEXT_BYTES, 0)
        self.was += data[begin : at + CONTEXT_BYTES]
        self.became += out[begin : end + CONTEXT_BYTES]
        return bytes(out)

    def _damaged(self, byte: bytes) -> bytes:
        if self.kind == "lost":
            return b""
        if self.kind == "doubled":
            return byte * 2
        if self.kind == "flip":
            return bytes([byte[0] ^ 1 << self._rng.randrange(8)])
        if self.kind == "swapped":
            # The first byte waits for its neighbour, however late that is sent.
            held, self._held = self._held, byte
            return byte + held if self._left == 0 else b""
        return bytes([byte[0] ^ self._rng.randrange(1, 256)])


class Inbound:
    """Bytes in transit from the host to the board."""

    def __init__(self, byte_s: float) -> None:
        self.byte_s = byte_s
        self.damage: Damage | None = None
        self._data = bytearray()
        self._start_s = 0.0

    def push(self, data: bytes, now: float) -> None:
        """Send ``data`` at ``now``, after the bytes that are still on the line."""
        if self.damage is not None:
            data = self.damage.apply(data)
        if not self._data:
            self._start_s = now
        elif self.byte_s == 0:
            self._start_s = max(self._start_s, now)
        self._data += data

    def clear(self) -> int:
        """Drop the bytes that have not arrived; return their number."""
        lost = len(self._data)
        self._data.clear()
        return lost

    def due(self) -> float | None:
        """Return the arrival time of the next byte on which the board may have to act."""
        if not self._data:
            return None
        match = _SIGNIFICANT.search(self._data)
        count = match.end() if match else len(self._data)
        return self._start_s + count * self.byte_s

    def take(self, now: float) -> tuple[float, int] | None:
        """Return the next byte that has arrived by ``now`` with its time, or None."""
        if not self._data or self._start_s + self.byte_s > now + 1e-12:
            return None
        self._start_s += self.byte_s
        return self._start_s, self._data.pop(0)


@dataclass(slots=True)
class AnswerFault:
    """Fault of the next ``count`` answers (``ok``, ``error:N``)."""

    kind: str
    """``lost``, ``delayed``, ``split`` or ``merged``."""
    count: int
    seconds: float = 0.0


class Outbound:
    """Bytes in transit from the board to the host."""

    kinds = ("lost", "delayed", "split", "merged")
    buffer_bytes = 104
    """Size of GRBL's transmit buffer; the firmware waits while it is full."""

    def __init__(self, byte_s: float, rng: random.Random, latency_s: float = 0.0) -> None:
        self.byte_s = byte_s
        self.latency_s = latency_s
        self.rng = rng
        self.damage: Damage | None = None
        self.faults: deque[AnswerFault] = deque()
        self._queue: deque[tuple[float, bytes]] = deque()
        self._free_s = 0.0
        self._arrived_s = 0.0
        self._merge_until = 0.0

    def send(self, data: bytes, now: float, *, after_s: float = 0.0) -> None:
        """Queue bytes; they arrive in order after their time on the line, and ``after_s`` later if they are delayed.

        The delay is on the host's side: the board's transmit buffer empties without it.
        """
        if self.damage is not None:
            data = self.damage.apply(data)
        self._free_s = max(self._free_s, now) + len(data) * self.byte_s
        self._arrived_s = max(self._arrived_s, self._free_s + self.latency_s + after_s)
        self._queue.append((self._arrived_s, data))

    def answer(self, data: bytes, now: float) -> str | None:
        """Queue an answer, subject to the injected faults; return the name of the fault that affected it."""
        if not self.faults:
            self.send(data, now)
            return None
        fault = self.faults[0]
        fault.count -= 1
        if fault.count <= 0:
            self.faults.popleft()
        if fault.kind == "delayed":
            self.send(data, now, after_s=fault.seconds)
        elif fault.kind == "split":
            cut = self.rng.randint(1, len(data) - 1)
            self.send(data[:cut], now)
            self.send(data[cut:], now, after_s=fault.seconds)
        elif fault.kind == "merged":
            # All answers until then wait for the same time, as with a slow USB latency timer.
            if self._merge_until <= now:
                self._merge_until = now + fault.seconds
            self.send(data, now, after_s=self._merge_until - now)
        return fault.kind

    def clear(self) -> None:
        """Drop all bytes, as if the cable were unplugged."""
        self._queue.clear()
        self._merge_until = self._free_s = self._arrived_s = 0.0

    def due(self) -> float | None:
        """Return the arrival time of the next piece at the host."""
        return self._queue[0][0] if self._queue else None

    def take(self, now: float) -> list[bytes]:
        """Return the pieces that have arrived by ``now``."""
        pieces = []
        while self._queue and self._queue[0][0] <= now + 1e-12:
            pieces.append(self._queue.popleft()[1])
        return pieces

    def room_at(self) -> float:
        """Return the time at which the transmit buffer has room again."""
        return self._free_s - self.buffer_bytes * self.byte_s
