"""Comparison of a board's ``$`` settings with the wanted ones, the lines that correct them, and profiles as text."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping

from gantry_driver.core.grbl.lines import plain
from icu_common.core.reasons.message import Message, quoted

REPORT_MASK = 10
"""Number of the setting that selects the contents of reports."""
MACHINE_POSITION, WORK_OFFSET = 1, 32
"""Bits of this setting; a report needs one of them."""
_LINE = re.compile(r"\$(\d{1,3})\s*=\s*([-+]?\d+\.?\d*)\s*(?:[;(].*)?\Z")
LARGEST = 1e9
"""Limit of a setting's value: far above every real one, and short enough for a board's line with its decimals."""
_NEEDED_FIRST = 22
"""Number of the homing setting: without it a board rejects soft limits ($20)."""


class ProfileError(ValueError):
    """A profile's text cannot be read; the message names the line."""


def differences(
    found: Mapping[int, str], wanted: Mapping[int, float], who: str = Message("settings.configuration")
) -> list[str]:
    """Return a sentence for each setting of ``wanted`` that differs from a board's ``found`` texts."""
    texts: list[str] = []
    for number, value in wanted.items():
        text = found.get(number)
        if text is None:
            texts.append(Message("settings.missing_says", number=number, who=who, value=value))
        elif not _equal(text, value) and number == REPORT_MASK:
            shown = text.partition(".")[0]
            lacks = Message("settings.bit_0_bit_5", machine_position=MACHINE_POSITION, work_offset=WORK_OFFSET)
            texts.append(
                Message(
                    "settings.reports_tell_no_machine_position",
                    number=number,
                    shown=shown,
                    lacks=lacks,
                    who=who,
                    value=value,
                )
            )
        elif not _equal(text, value):
            texts.append(Message("settings.says", number=number, text=text, who=who, value=value))
    return texts


def lines_to_write(found: Mapping[int, str], wanted: Mapping[int, float]) -> list[str]:
    """Return the ``$n=value`` lines for the settings that differ, in an order that the board accepts."""
    numbers = [n for n, value in wanted.items() if n not in found or not _equal(found[n], value)]
    return [f"${n}={_plain(wanted[n])}" for n in sorted(numbers, key=lambda n: (n != _NEEDED_FIRST, n))]


def parse_profile(lines: Iterable[str]) -> dict[int, float]:
    """Return the settings of a profile: ``$n=value`` lines as a board prints them, ``;`` and ``()`` comments.

    Raises
    ------
    ProfileError
        For an invalid line, a value above all real settings, a repeated number, or a profile without settings.

    Examples
    --------
    >>> parse_profile(["; my stage", "$110=12000.000 (x max rate)"])
    {110: 12000.0}
    """
    profile: dict[int, float] = {}
    for place, raw in enumerate(lines, 1):
        text = raw.strip()
        if not text or text[0] in ";(":
            continue
        match = _LINE.match(text)
        if match is None:
            raise ProfileError(Message("settings.line_not_value", place=place, text=quoted(text)))
        number = int(match[1])
        if number in profile:
            raise ProfileError(Message("settings.line_given_twice", place=place, number=number))
        profile[number] = float(match[2])
        if not abs(profile[number]) <= LARGEST:
            raise ProfileError(
                Message("settings.line_not_within", place=place, text=quoted(text), largest=LARGEST, largest_2=LARGEST)
            )
    if not profile:
        raise ProfileError(Message("settings.profile_no_setting"))
    return profile


def profile_text(found: Mapping[int, str]) -> str:
    """Return a profile of a board's settings; settings that are not numbers (texts of grblHAL) become comments."""
    lines = [f"${number}={value}" for number, value in sorted(found.items())]
    return "".join(f"{line}\n" if _LINE.match(line) else f"; {line}\n" for line in lines)


def _equal(text: str, value: float) -> bool:
    try:
        return math.isclose(float(text), value, rel_tol=1e-5, abs_tol=6e-4)  # boards print three decimals
    except ValueError:
        return False


def _plain(value: float) -> str:
    if not math.isfinite(value):
        raise ProfileError(Message("settings.cannot_written", value=value))
    return plain(value)
