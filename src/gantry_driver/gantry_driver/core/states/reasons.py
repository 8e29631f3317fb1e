"""Reasons for a state that other programs decide by: a text for people with its code.

Most reasons of the machine are only shown; they are plain texts.
"""

from __future__ import annotations

from dataclasses import dataclass

from icu_common.core.reasons.codes import DriverCode
from icu_common.core.reasons.message import Message


@dataclass(frozen=True, slots=True, kw_only=True)
class Reason:
    """A reason with a code."""

    code: DriverCode
    text: str

    def __str__(self) -> str:
        return self.text


Why = Reason | str
STOP_REQUESTED = Reason(code=DriverCode.STOP_REQUESTED, text=Message("driver.stop_requested"))


def code_of(why: Why) -> str:
    """Return the code of a reason, empty for one without a code."""
    return why.code.value if isinstance(why, Reason) else ""


def why_of(text: str, code: str) -> Why:
    """Return the reason with this text and code; an unknown code, as of a newer program, counts as none.

    Examples
    --------
    >>> why_of("stop requested", "driver.stop_requested") == STOP_REQUESTED, why_of("the end", "")
    (True, 'the end')
    """
    known = {member.value: member for member in DriverCode}
    return Reason(code=known[code], text=text) if code in known else text
