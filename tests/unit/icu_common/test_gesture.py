"""The command grammar: what is accepted comes back equal, what is not names the reason."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from icu_common.core.gesture import Gesture, GestureError, Point, parse_gesture

names = st.from_regex(r"[A-Za-z][A-Za-z0-9_]{0,20}", fullmatch=True)
numbers = st.floats(-1e4, 1e4, allow_nan=False)
targets = names | st.builds(Point, x=numbers, y=numbers, frame=names)
identifiers = st.just("") | st.from_regex(r"[\w.-]{1,20}", fullmatch=True)
gestures = (
    st.builds(Gesture, kind=st.just("press"), target=targets, id=identifiers)
    | st.builds(Gesture, kind=st.just("hold"), target=targets, argument=st.floats(0.01, 30), id=identifiers)
    | st.builds(
        Gesture,
        kind=st.just("turn"),
        target=targets,
        argument=st.floats(0.5, 360) | st.floats(-360, -0.5),
        id=identifiers,
    )
)


@given(gestures)
def test_text_round_trip(gesture: Gesture) -> None:
    parsed = parse_gesture(gesture.text())
    assert (parsed.kind, parsed.target, parsed.id) == (gesture.kind, gesture.target, gesture.id)
    assert parsed.argument == gesture.argument or (math.isnan(parsed.argument) and math.isnan(gesture.argument))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "expected gesture:target"),
        ("press", "expected gesture:target"),
        ("poke:RUN", "none of press, hold, turn"),
        ("press:RUN:3", "takes no argument"),
        ("press:1x", "neither a control's name nor"),
        ("press:nan,0@base_link", "not finite"),
        ("press:1e999,0@base_link", "not finite"),
        ("press:a,0@base_link", "not a number"),
        ("hold:RUN", "needs seconds"),
        ("hold:RUN:31", "needs seconds"),
        ("hold:RUN:nan", "not finite"),
        ("turn:K:0", "needs an angle"),
        ("turn:K:-361", "needs an angle"),
        ("press:RUN id=a b", "expected id="),
        ("press:RUN now", "expected id="),
        ("press:" + "A" * 300, "at most 200"),
    ],
)
def test_refusals(text: str, message: str) -> None:
    with pytest.raises(GestureError, match=message):
        parse_gesture(text)


@given(st.text(max_size=60))
def test_any_text_is_parsed_or_refused(text: str) -> None:
    try:
        assert parse_gesture(text).kind in ("press", "hold", "turn")
    except GestureError as error:
        assert str(error)
