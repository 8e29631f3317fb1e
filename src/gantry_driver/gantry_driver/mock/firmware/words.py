"""Division of a line into its words for the mock board's parser."""

from __future__ import annotations

from collections.abc import Iterator

from gantry_driver.mock.firmware.floats import read_number

LETTER, NUMBER = 1, 2


class FirmwareGcodeError(Exception):
    """The line is rejected with ``error:number``."""

    def __init__(self, number: int) -> None:
        super().__init__(f"error:{number}")
        self.number = number


def split_words(text: str) -> Iterator[tuple[str, float]]:
    """Yield the words of a line (capitals, no blanks) as they are read: a bad word after a conflict is never read."""
    index = 0
    while index < len(text):
        letter = text[index]
        if not "A" <= letter <= "Z":
            raise FirmwareGcodeError(LETTER)
        number = read_number(text, index + 1)
        if number is None:
            raise FirmwareGcodeError(NUMBER)
        value, index = number
        yield letter, value
