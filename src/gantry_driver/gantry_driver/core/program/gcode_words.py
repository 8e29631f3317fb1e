"""Words of a G-code line: numbers, comments, modal groups, and the commands that are not part of a program.

The rules are those of GRBL 1.1's parser; messages name its error numbers. Words whose target cannot be known are
rejected: G28, G30, probing, offsets written to the board.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

_GROUPS: dict[str, tuple[str, ...]] = {
    "motion": ("G0", "G1", "G2", "G3", "G80"),
    "plane": ("G17", "G18", "G19"),
    "distance": ("G90", "G91"),
    "arc distance": ("G91.1",),
    "feed_mode": ("G93", "G94"),
    "units": ("G20", "G21"),
    "cutter compensation": ("G40",),
    "tool length": ("G49",),
    "coordinate system": ("G54", "G55", "G56", "G57", "G58", "G59"),
    "control": ("G61",),
    "non-modal": ("G4", "G53", "G92", "G92.1"),
    "program": ("M2", "M30"),
    "spindle": ("M3", "M4", "M5"),
    "coolant": ("M7", "M8", "M9"),
}
GROUP_OF = {word: group for group, words in _GROUPS.items() for word in words}
_AXIS_USERS = frozenset({"G0", "G1", "G2", "G3", "G49", "G92"})
"""Commands that use axis words; GRBL accepts one of them in a line, even without an axis word."""
_REFUSED = {
    "G28": "goes to a stored place that is not known here",
    "G30": "goes to a stored place that is not known here",
    "G28.1": "writes to the board's memory",
    "G30.1": "writes to the board's memory",
    "G10": "writes to the board's memory",
    "G43.1": "moves all targets by a tool length that is not known here",
    "G38.2": "ends where the probe touches",
    "G38.3": "ends where the probe touches",
    "G38.4": "ends where the probe releases",
    "G38.5": "ends where the probe releases",
    "M0": "waits for a person at the board",
    "M1": "waits for a person at the board",
}
_VALUES = "FIJKLNPRSTXYZ"
_WORD = re.compile(r"([A-Z])([+-]?(?:\d+\.?\d*|\.\d+))?")
_LARGEST = {"N": (9_999_999.0, 27), "T": (255.0, 38)}
"""Maximum value of a word, and GRBL's error for a larger one."""
_REALTIME = frozenset("?!~\x18")


class GcodeError(ValueError):
    """A program's line that cannot be sent: ``line`` and ``column`` count from 1."""

    def __init__(self, line: int, column: int, reason: str) -> None:
        super().__init__(f"line {line}, column {column}: {reason}")
        self.line, self.column, self.reason = line, column, reason


@dataclass(frozen=True, slots=True, kw_only=True)
class Word:
    """A letter with its number; ``column`` counts from 1."""

    letter: str
    value: float
    column: int

    @property
    def name(self) -> str:
        return f"{self.letter}{self.value:g}"


@dataclass(frozen=True, slots=True, kw_only=True)
class ParsedLine:
    """A line with at least one word.

    Parameters
    ----------
    number
        Number of the line, from 1.
    words
        All words in order.
    commands
        Modal group -> command.
    values
        Letter -> word, of all words that are no commands.
    """

    number: int
    words: Sequence[Word]
    commands: Mapping[str, str]
    values: Mapping[str, Word]

    @property
    def axes(self) -> list[Word]:
        """The axis words."""
        return [self.values[letter] for letter in "XYZ" if letter in self.values]

    def error(self, word: Word, reason: str) -> GcodeError:
        """Return the error of a word."""
        return GcodeError(self.number, word.column, reason)


def parse_words(number: int, raw: str) -> ParsedLine | None:
    """Return the words of a line; None if it has none.

    Raises
    ------
    GcodeError
        At the first word that no program may have.
    """
    words = _words(number, raw)
    if not words:
        return None
    return ParsedLine(number=number, words=words, commands=_commands(number, words), values=_values(number, words))


def _words(number: int, raw: str) -> list[Word]:
    clean = _without_comments(number, raw.rstrip("\r\n"))
    letters = [(char.upper(), column) for column, char in enumerate(clean, 1) if not char.isspace()]
    packed = "".join(char for char, _ in letters)
    if not packed or packed == "%":
        return []
    if packed[0] == "$":
        raise GcodeError(number, letters[0][1], "settings and system commands are not part of a program")
    words, place = [], 0
    while place < len(packed):
        column = letters[place][1]
        match = _WORD.match(packed, place)
        if match is None:
            raise GcodeError(number, column, f"{packed[place]!r}: a letter is expected (error:1)")
        if match[2] is None:
            raise GcodeError(number, column, f"{match[1]} has no number (error:2)")
        value = float(match[2])
        if math.isinf(value):
            raise GcodeError(number, column, f"{match[1]} has a number that no board can read (error:2)")
        words.append(Word(letter=match[1], value=value, column=column))
        place = match.end()
    return words


def _without_comments(number: int, raw: str) -> str:
    """Replace comments, block delete and real-time bytes by blanks, so that the columns stay the same."""
    out, depth, opened = [], 0, 0
    for column, char in enumerate(raw, 1):
        if depth:
            depth = 0 if char == ")" else 1
            out.append(" ")
        elif char == "(":
            depth, opened = 1, column
            out.append(" ")
        elif char == ";":
            return "".join(out)
        elif char in _REALTIME or char == "/" or 0x80 <= ord(char) <= 0xA0:
            out.append(" ")
        elif ord(char) > 0xA0 and not char.isspace():
            # Boards ignore a typographic minus, which would reverse a move.
            raise GcodeError(number, column, f"{char!r} is no character that a board reads")
        else:
            out.append(char)
    if depth:
        raise GcodeError(number, opened, "the comment has no end")
    return "".join(out)


def _commands(number: int, words: Sequence[Word]) -> dict[str, str]:
    """Return modal group -> command; at most one command of each group."""
    found: dict[str, str] = {}
    for word in words:
        if word.letter not in "GM":
            continue
        if word.name in _REFUSED:
            raise GcodeError(number, word.column, f"{word.name} {_REFUSED[word.name]}")
        group = GROUP_OF.get(word.name)
        if group is None:
            raise GcodeError(number, word.column, f"{word.name} is not supported (error:20)")
        if group in found:
            raise GcodeError(
                number, word.column, f"{found[group]} and {word.name} are both {group.replace('_', ' ')} (error:21)"
            )
        found[group] = word.name
        users = [name for name in found.values() if name in _AXIS_USERS]
        if len(users) > 1:
            raise GcodeError(number, word.column, f"{' and '.join(users)} both use the axis words (error:24)")
    return found


def _values(number: int, words: Sequence[Word]) -> dict[str, Word]:
    found: dict[str, Word] = {}
    for word in words:
        if word.letter in "GM":
            continue
        if word.letter not in _VALUES:
            raise GcodeError(number, word.column, f"{word.letter} is not supported (error:20)")
        if word.letter in found:
            raise GcodeError(number, word.column, f"{word.letter} is given twice (error:25)")
        if word.letter in "FPST" and word.value < 0:
            raise GcodeError(number, word.column, f"{word.letter}{word.value:g} is negative (error:4)")
        most, code = _LARGEST.get(word.letter, (math.inf, 0))
        if word.value > most:
            raise GcodeError(number, word.column, f"{word.letter}{word.value:.0f} is above {most:.0f} (error:{code})")
        found[word.letter] = word
    return found
