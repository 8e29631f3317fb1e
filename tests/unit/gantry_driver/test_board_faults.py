"""What the driver says of a board that reports too little, reports what nobody can read, or starts again and again."""

from __future__ import annotations

import pytest
from graph_texts import german_phrases

from gantry_driver.core.grbl_messages import Dialect, alarm_text, error_text

ERRORS = (*range(1, 18), *range(20, 39))
"""All of GRBL 1.1's; doc/csv/error_codes_en_US.csv of gnea/grbl."""
ALARMS = range(1, 10)
"""All of GRBL 1.1's; doc/csv/alarm_codes_en_US.csv of gnea/grbl."""


@pytest.mark.parametrize("text", [error_text(code) for code in ERRORS] + [alarm_text(c, Dialect.GRBL) for c in ALARMS])
def test_every_code_of_grbl_has_a_text_in_both_languages(text: str) -> None:
    _, _, meaning = text.partition(" (")
    assert "see the manual" not in text
    assert meaning.removesuffix(")") in german_phrases()
