"""Reason why a request was refused: a code for a sentence of the page, and the values in that sentence.

The sentences are only in the page's scripts (``page/language/strings.js``), so that all translations are in one place.
"""

from __future__ import annotations

from typing import Any


class Refusal(Exception):
    """A request is refused; nothing moves.

    Parameters
    ----------
    code
        Key of the sentence, for example ``frame_old``.
    values
        Values in the sentence, such as the value found and the limit, as numbers or text.
    """

    def __init__(self, code: str, **values: Any) -> None:
        super().__init__(code + "".join(f" {key}={value}" for key, value in values.items()))
        self.code = code
        self.values = values

    def message(self) -> dict[str, Any]:
        """Return the message for the page."""
        return {"code": self.code, "values": self.values}
