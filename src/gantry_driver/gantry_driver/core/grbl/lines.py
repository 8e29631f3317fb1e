"""Lines to the board, and their outcomes, as values."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass

from gantry_driver.core.grbl.grbl_messages import Banner, GrblMessage
from gantry_driver.core.grbl.modes import ASK_MODES

MAX_LINE_BYTES = 80
"""Maximum length of a line in bytes, newline included; GRBL answers error:11 to longer ones."""
SYNCHRONISE = "G4P0"
"""Dwell of zero seconds: the board answers it when all motion has ended."""
ARRIVED_S = 0.3
"""Age in seconds at which a line must be in the board's buffer, even on a busy computer and with a slow adapter."""
_WAITS = re.compile(r"[$M]|G0*(?:4|10|43|49|5[4-9]|92)(?!\d)", re.IGNORECASE)
"""Lines with a delayed answer: dwells, spindle, ``$`` commands, and new offsets, which wait for all motion."""
_ACTS = re.compile(r"[$F]|M0*[3478](?!\d)|G0*(?:28|30)(?!\d)|[XYZ](?!.*G0*(?:[123]|92)\Z)", re.IGNORECASE)
"""Lines that a board would execute right after a reset: see docs/decisions/lines-after-a-reset.md."""
_EEPROM = re.compile(r"\$(?!J=)[^=]*=|\$RST|G0*10(?!\d).*L0*20?(?!\d)|G0*28\.10*(?!\d)|G0*30\.10*(?!\d)", re.IGNORECASE)


def plain(value: float, digits: int = 3) -> str:
    """Return a number without trailing zeros, rounded to the given number of decimals."""
    text = f"{value:.{digits}f}".rstrip("0").rstrip(".")
    return "0" if text in ("-0", "") else text


@dataclass(frozen=True, slots=True, kw_only=True)
class GrblLine:
    """A line for the board: ``number`` counts from 1 within the session, ``text`` has no newline.

    Parameters
    ----------
    eeprom
        Whether its execution blocks the board's reception.
    alone
        Whether no other line may be unanswered together with it: ``$`` commands, EEPROM writes, and every line that a
        board would still execute after a reset, such as a move, an order to the stylus, or a feed.
    """

    number: int
    text: str
    answer_within_s: float
    eeprom: bool = False
    alone: bool = False

    @classmethod
    def of(cls, number: int, text: str, answer_within_s: float) -> GrblLine:
        """Return the line with the properties of its text, which are computed only once."""
        eeprom = _EEPROM.search(text) is not None
        alone = eeprom or (_ACTS.search(text) is not None and text != ASK_MODES)
        return cls(number=number, text=text, answer_within_s=answer_within_s, eeprom=eeprom, alone=alone)

    @property
    def waits(self) -> bool:
        """Whether a board may answer it only after a motion, a dwell or a cycle has ended."""
        return self.eeprom or _WAITS.search(self.text) is not None

    @property
    def size(self) -> int:
        """Number of bytes in the receive buffer, newline included."""
        return len(self.text) + 1


@dataclass(frozen=True, slots=True, kw_only=True)
class Acknowledged(GrblMessage):
    """The board has accepted the line (planned, not executed)."""

    line: GrblLine


@dataclass(frozen=True, slots=True, kw_only=True)
class LineRefused(GrblMessage):
    """The board has answered ``error:N`` to the line."""

    line: GrblLine
    code: int


@dataclass(frozen=True, slots=True, kw_only=True)
class WasReset(GrblMessage):
    """A banner arrived; the unanswered lines are lost.

    Parameters
    ----------
    banner
        The received banner.
    expected
        Whether the driver requested the reset, or retried a request that a late board answers as well.
    lost
        Lines sent and not answered: the board may have executed none, some or all of them.
    unsent
        Lines that were queued and not sent.
    """

    banner: Banner
    expected: bool
    lost: tuple[GrblLine, ...]
    unsent: tuple[GrblLine, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class StrayAnswer(GrblMessage):
    """An answer without an unanswered line."""

    answer: GrblMessage


@dataclass(frozen=True, slots=True, kw_only=True)
class CountBroken(GrblMessage):
    """The count of bytes and answers contradicts the board's messages; the unanswered lines must be discarded."""

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
    in_flight: Iterable[tuple[GrblLine, float]], held_bytes: int, now: float, *, idle: bool, full: bool
) -> bool:
    """Return whether a board has removed lines from its buffer that it should have answered before its report.

    Answers and reports arrive in order. The board's buffer holds all lines that were sent long enough ago, except the
    one in execution: there is one with a full planner or a dwell, otherwise none.

    Parameters
    ----------
    in_flight
        Lines sent and not answered, with the times at which they were sent.
    held_bytes
        Number of bytes in the board's receive buffer according to its report.
    idle, full
        Whether it reports that nothing moves, and that its planner is full.
    """
    arrived = [line for line, sent_at in in_flight if now - sent_at > ARRIVED_S]
    missing = sum(line.size for line in arrived) - held_bytes
    if missing <= 0:
        return False
    waits = arrived[0].waits and not (idle and arrived[0].text == SYNCHRONISE)
    return missing > (max(line.size for line in arrived) if waits or full else 0)
