"""KEY=VALUE texts of command lines: what they mean, and which are refused."""

from __future__ import annotations

import re

import pytest

from icu_common.core.configuration.yaml_text import values_of_pairs


def test_values_are_those_of_yaml_and_numbers_with_an_exponent() -> None:
    assert values_of_pairs(["k=0.04", "n=3", "a.b=[1, 2]", "name=gaussian", "on=true"]) == {
        "k": 0.04,
        "n": 3,
        "a.b": [1, 2],
        "name": "gaussian",
        "on": True,
    }
    assert values_of_pairs(["k=4e-2", "text=x=1", "k=-1e6"]) == {"k": -1e6, "text": "x=1"}


@pytest.mark.parametrize(
    ("pair", "message"),
    [
        ("k", "'k': expected KEY=VALUE"),
        ("k=[1", "'k=[1': cannot read the value"),
        ("k=2026-13-45", "'k=2026-13-45': cannot read the value"),
    ],
)
def test_what_cannot_be_read_is_named(pair: str, message: str) -> None:
    with pytest.raises(ValueError, match=re.escape(message)):
        values_of_pairs([pair])
