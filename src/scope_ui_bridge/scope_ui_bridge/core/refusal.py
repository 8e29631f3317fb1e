"""Why something was not done: a code that the page has a sentence for, and the values in that sentence.

The sentences live in ``page/strings.js`` alone, so that a translation has one place.
"""

from __future__ import annotations

from typing import Any


class Refusal(Exception):
    """A request that is not carried out; nothing moves.

    Parameters
    ----------
    code
        Key of the sentence, for example ``frame_old``.
    values
        What the sentence names: the value found and the bound, as numbers or text.
    """

    def __init__(self, code: str, **values: Any) -> None:
        super().__init__(code + "".join(f" {key}={value}" for key, value in values.items()))
        self.code = code
        self.values = values

    def message(self) -> dict[str, Any]:
        """Return what is sent to the page."""
        return {"code": self.code, "values": self.values}
