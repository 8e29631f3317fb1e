"""Texts from outside: their nesting depth, and their cut and escaped form."""

from __future__ import annotations

import pytest

from icu_common.core.configuration.text_bounds import deepest_line, plain


def test_the_line_that_opens_too_many_brackets_is_found() -> None:
    assert deepest_line("[[]]\n{[{", 3) == 0
    assert deepest_line("[[]]\n{[{[", 3) == 2
    assert deepest_line("]]]\n[[[\n[", 3) == 3, "more that close than open"


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("moving: 3 of 5", "moving: 3 of 5"),
        ("Jürgen 示波器 \u05d0", "Jürgen 示波器 \u05d0"),
        ("\x1b[2J\x1b[31mstop\x07", "\\x1b[2J\\x1b[31mstop\\x07"),
        ("idle\nERROR all is well\r", "idle\\x0aERROR all is well\\x0d"),
        ("a\u202egnp\u2066\u2028\x9b", "a\\u202egnp\\u2066\\u2028\\x9b"),
        ("\ud800", "\\ud800"),
        ("x" * 1_000_000, "x" * 400 + " (999600 more characters)"),
    ],
)
def test_what_a_terminal_would_obey_is_escaped_and_the_rest_is_cut(text: str, shown: str) -> None:
    assert plain(text) == shown
    assert plain(shown, 1000) == shown, "once is enough"
