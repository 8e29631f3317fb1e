"""Reports without a machine position, and reports that cannot be read.

grblHAL leaves out what ``$10`` does not ask for, the work offset as well (its wiki, Report extensions); GRBL 1.1 and
FluidNC always report the offset now and then.
"""

from __future__ import annotations

from collections.abc import Mapping

from gantry_driver.core.grbl.grbl_messages import Dialect
from gantry_driver.core.grbl.settings_profile import MACHINE_POSITION, REPORT_MASK, WORK_OFFSET
from icu_common.core.reasons.message import Message, quoted

UNPLACED_REPORTS = 40
"""Reports without a machine position after which none is to be expected; GRBL sends its offset with every 30th."""
QUOTED_BYTES = 80


def position_mask(settings: Mapping[int, str], dialect: Dialect) -> dict[int, float]:
    """Return the required ``$10``; empty if the reports already have a machine position or an offset."""
    value = settings.get(REPORT_MASK, "").partition(".")[0]
    if dialect is not Dialect.GRBLHAL or not value.isdecimal() or int(value) & (MACHINE_POSITION | WORK_OFFSET):
        return {}
    return {REPORT_MASK: float(int(value) | MACHINE_POSITION)}


def no_position_text(settings: Mapping[int, str]) -> str:
    """Return why a homed board's position is not known, and what to set."""
    value = settings.get(REPORT_MASK, "?").partition(".")[0]
    return Message(
        "board.board_reports_tell_no_machine", report_mask=REPORT_MASK, value=value, machine_position=MACHINE_POSITION
    )


def with_quote(text: str, unread: bytes) -> str:
    """Return the text with the last report that could not be read, if there was one."""
    return (
        Message("board.cannot_read", text=text, decode=quoted(unread[:QUOTED_BYTES].decode("ascii", "replace")))
        if unread
        else text
    )
