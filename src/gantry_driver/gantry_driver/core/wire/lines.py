"""Lines to the board, and what becomes of them, as values."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass

from gantry_driver.core.grbl_messages import Banner, Message
from gantry_driver.core.wire.modes import ASK_MODES

MAX_LINE_BYTES = 80
"""Newline included; GRBL answers error:11 to longer ones."""
SYNCHRONISE = "G4P0"
"""A dwell of no time: it is answered when all motion has ended."""
ARRIVED_S = 0.3
"""Age from which a line must be in the board's buffer, on a busy computer and behind a slow adapter as well."""
_WAITS = re.compile(r"[$M]|G0*(?:4|10|43|49|5[4-9]|92)(?!\d)", re.IGNORECASE)
"""Lines that are answered later: dwells, spindle, ``$`` commands, and new offsets, which wait for all motion."""
_ACTS = re.compile(r"[$F]|M0*[3478](?!\d)|G0*(?:28|30)(?!\d)|[XYZ](?!.*G0*(?:[123]|92)\Z)", re.IGNORECASE)
"""What a board that has just been reset would obey: see docs/decisions/lines-after-a-reset.md."""
_EEPROM = re.compile(r"\$(?!J=)[^=]*=|\$RST|G0*10(?!\d).*L0*20?(?!\d)|G0*28\.10*(?!\d)|G0*30\.10*(?!\d)", re.IGNORECASE)


def plain(value: float, digits: int = 3) -> str:
    """Return a number without needless zeros, rounded to the given number of decimals."""
    text = f"{value:.{digits}f}".rstrip("0").rstrip(".")
    return "0" if text in ("-0", "") else text


@dataclass(frozen=True, slots=True, kw_only=True)
class Line:
    """A line for the board: ``number`` counts from 1 within the session, ``text`` has no newline.

    Parameters
    ----------
    eeprom
        Whether it blocks the board's reception while it is executed.
    alone
        Whether no other line may be under way with it: ``$`` commands, EEPROM writes, and every line that a board would
        still obey after a reset, such as a move, an order to the stylus, or a feed.
    """

    number: int
    text: str
    answer_within_s: float
    eeprom: bool = False
    alone: bool = False

    @classmethod
    def of(cls, number: int, text: str, answer_within_s: float) -> Line:
        """Return the line with what its text says about it; asked once, not at every turn of the link."""
        eeprom = _EEPROM.search(text) is not None
        alone = eeprom or (_ACTS.search(text) is not None and text != ASK_MODES)
        return cls(number=number, text=text, answer_within_s=answer_within_s, eeprom=eeprom, alone=alone)

    @property
    def waits(self) -> bool:
        """Whether a board may answer it only once something else has ended: a motion, a dwell, a cycle."""
        return self.eeprom or _WAITS.search(self.text) is not None

    @property
    def size(self) -> int:
        """Bytes in the receive buffer, newline included."""
        return len(self.text) + 1


@dataclass(frozen=True, slots=True, kw_only=True)
class Acknowledged(Message):
    """The board has taken the line (planned, not executed)."""

    line: Line


@dataclass(frozen=True, slots=True, kw_only=True)
class Refused(Message):
    """The board has answered ``error:N`` to the line."""

    line: Line
    code: int


@dataclass(frozen=True, slots=True, kw_only=True)
class WasReset(Message):
    """A banner came; what was under way is lost.

    Parameters
    ----------
    banner
        As received.
    expected
        Whether the driver requested the reset, or retried a request that a late board answers as well.
    lost
        Lines sent and not answered: the board may have executed none, some or all of them.
    unsent
        Lines that were still queued here.
    """

    banner: Banner
    expected: bool
    lost: tuple[Line, ...]
    unsent: tuple[Line, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class StrayAnswer(Message):
    """An answer to nothing that is under way."""

    answer: Message


@dataclass(frozen=True, slots=True, kw_only=True)
class CountBroken(Message):
    """The counting no longer fits what the board says; the lines under way must be thrown away."""

    reason: str


@dataclass(slots=True, kw_only=True)
class Counts:
    """Running totals since the start of the process."""

    sent: int = 0
    acknowledged: int = 0
    executed: int = 0
    refused: int = 0
    lost: int = 0
    resets: int = 0
    alarms: int = 0
    stray: int = 0
    garbage: int = 0
    reports: int = 0
    disbelieved: int = 0
    bytes_sent: int = 0
    bytes_received: int = 0


def answers_missing(
    in_flight: Iterable[tuple[Line, float]], held_bytes: int, now: float, *, idle: bool, full: bool
) -> bool:
    """Return whether a board has taken lines out of its buffer that it should have answered before its report.

    Answers and reports come in one order. Of what was sent long enough ago the board holds all but the line that it is
    working on: with a full planner, or a dwell, that is one; otherwise none.

    Parameters
    ----------
    in_flight
        Lines sent and not answered, with the times at which they were sent.
    held_bytes
        Bytes in the board's receive buffer by its report.
    idle, full
        Whether it reports that nothing moves, and that its planner has no room.
    """
    arrived = [line for line, sent_at in in_flight if now - sent_at > ARRIVED_S]
    missing = sum(line.size for line in arrived) - held_bytes
    if missing <= 0:
        return False
    waits = arrived[0].waits and not (idle and arrived[0].text == SYNCHRONISE)
    return missing > (max(line.size for line in arrived) if waits or full else 0)
