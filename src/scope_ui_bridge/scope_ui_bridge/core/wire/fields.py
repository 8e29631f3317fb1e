"""Fields of a page's message, each read with its type and its limits."""

from __future__ import annotations

import unicodedata
from typing import Any, NoReturn

from icu_common.core.goals.sequence import MAX_STEPS
from icu_common.core.reasons.message import Message, quoted
from scope_ui_bridge.core.wire.refusal import Refusal
from scope_ui_bridge.core.wire.requests import CAMERAS

MAX_TEXT = 64
_MAX_INTEGER = 2**53


class Fields:
    """Reads fields of an object; its errors contain the field's name."""

    def __init__(self, raw: dict[str, Any]) -> None:
        self._raw = dict(raw)

    def wrong(self, name: str, value: Any, needed: str) -> NoReturn:
        raise Refusal(
            "malformed", what=Message("request.needed", name=name, value=quoted(str(value)[:40]), needed=needed)
        )

    def integer(self, name: str) -> int:
        value = self._raw.pop(name, None)
        if type(value) is not int or not 0 <= value < _MAX_INTEGER:
            self.wrong(name, value, Message("request.integer_0_2_53"))
        return value

    def number(self, name: str) -> float:
        value = self._raw.pop(name, None)
        if type(value) not in (int, float) or not abs(value) < 1e15:
            self.wrong(name, value, Message("request.number"))
        return float(value)

    def length(self, name: str) -> float:
        """Return a field given in mm as metres; at most 1 m, because no distance on the bench is longer."""
        value = self.number(name)
        if abs(value) > 1000:
            self.wrong(name, value, Message("request.length_most_1000"))
        return value * 1e-3

    def sign(self, name: str) -> int:
        value = self._raw.pop(name, None)
        if type(value) is not int or value not in (-1, 0, 1):
            self.wrong(name, value, Message("request.n_1_0_1"))
        return value

    def picture(self) -> dict[str, Any]:
        return {"camera": self.choice("camera", CAMERAS), "stamp_ns": self.stamp("stamp")}

    def text(self, name: str) -> str:
        """Return a text with composed letters, as names are stored."""
        value = self._raw.pop(name, None)
        composed = unicodedata.normalize("NFC", value) if isinstance(value, str) else ""
        if not isinstance(value, str) or len(composed) > MAX_TEXT or not composed.isprintable():
            self.wrong(name, value, Message("request.text_up_64_characters"))
        return composed

    def texts(self, name: str) -> tuple[str, ...]:
        value = self._raw.pop(name, None)
        if not isinstance(value, list) or not 0 < len(value) <= MAX_STEPS:
            self.wrong(
                name,
                len(value) if isinstance(value, list) else value,
                Message("request.n_1_texts", max_steps=MAX_STEPS),
            )
        for number, text in enumerate(value, 1):
            if not (isinstance(text, str) and len(text) <= 300 and text.isprintable()):
                self.wrong(f"{name} {number}", text, Message("request.text_up_300_characters_each"))
        return tuple(value)

    def rows(self, name: str, length: int, *, texts: int = 0, single: bool = False) -> list[Any]:
        """Return lists of ``length`` values as tuples: first ``texts`` short texts, then numbers."""
        value = self._raw.pop(name, None)
        rows = [value] if single else value
        if not isinstance(rows, list) or len(rows) > 100:
            self.wrong(name, value, Message("request.list"))
        for row in rows:
            good = isinstance(row, list) and len(row) == length
            good = good and all(isinstance(v, str) and len(v) <= 40 and v.isprintable() for v in row[:texts])
            if not good or not all(type(v) in (int, float) and abs(v) < 1e6 for v in row[texts:]):
                self.wrong(
                    name,
                    row,
                    Message("request.texts_numbers", texts=texts, length=length - texts)
                    if texts
                    else Message("request.numbers", length=length),
                )
        return [(*row[:texts], *map(float, row[texts:])) for row in rows]

    def choice(self, name: str, choices: tuple[str, ...]) -> str:
        value = self._raw.pop(name, None)
        if not isinstance(value, str) or value not in choices:
            self.wrong(name, value, Message("request.one_of", choices=", ".join(choices)))
        return value

    def stamp(self, name: str) -> int:
        # Nanoseconds do not fit into a double, so the page returns them as the text it received.
        value = self.text(name)
        if not (value.isascii() and value.isdigit() and len(value) <= 20):
            self.wrong(name, value, Message("request.nanoseconds_text_digits"))
        return int(value)

    def finish(self) -> None:
        if self._raw:
            raise Refusal("malformed", what=Message("request.unknown_field", raw=", ".join(sorted(self._raw))[:60]))
