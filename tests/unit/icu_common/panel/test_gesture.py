"""The command grammar: what is accepted comes back equal, what is not names the reason."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from icu_common.core.panel.gesture import GESTURES, Gesture, GestureError, Point, parse_gesture

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
    | st.builds(Gesture, kind=st.sampled_from(["long", "double"]), target=targets, id=identifiers)
    | st.builds(Gesture, kind=st.just("click"), target=targets, argument=st.integers(1, 60).map(float), id=identifiers)
    | st.builds(Gesture, kind=st.just("set"), target=names, argument=st.floats(-180, 180), id=identifiers)
    | st.builds(
        Gesture,
        kind=st.just("set"),
        target=names,
        mark=names.filter(lambda n: n.lower() not in ("nan", "inf", "infinity")),
        id=identifiers,
    )
    | st.builds(
        Gesture,
        kind=st.just("drag"),
        target=targets,
        to=st.builds(Point, x=numbers, y=numbers, frame=names),
        id=identifiers,
    )
)


@given(gestures)
def test_text_round_trip(gesture: Gesture) -> None:
    parsed = parse_gesture(gesture.text())
    for field in ("kind", "target", "mark", "to", "id"):
        assert getattr(parsed, field) == getattr(gesture, field)
    assert parsed.argument == gesture.argument or (math.isnan(parsed.argument) and math.isnan(gesture.argument))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "expected gesture:target"),
        ("press", "expected gesture:target"),
        ("poke:RUN", "none of press, long, double, hold, turn, click, set, drag"),
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
        ("long:RUN:1", "long takes no argument"),
        ("double:RUN:2", "double takes no argument"),
        ("turn:K", "turn needs an angle .* found nothing"),
        ("click:K:1.5", "click needs a whole number"),
        ("click:K:61", "at most 60"),
        ("set:K:181", "degrees from -180 to 180"),
        ("set:K:nan", "not finite"),
        ("drag:SCREEN:RUN", "drag needs the point x,y@frame"),
        ("drag:SCREEN", "drag needs the point x,y@frame"),
        ("press:RUN id=a b", "expected id="),
        ("press:RUN now", "expected id="),
        ("press:" + "A" * 300, "limit 200"),
    ],
)
def test_refusals(text: str, message: str) -> None:
    with pytest.raises(GestureError, match=message):
        parse_gesture(text)


@given(st.text(max_size=60))
def test_any_text_is_parsed_or_refused(text: str) -> None:
    try:
        assert parse_gesture(text).kind in GESTURES
    except GestureError as error:
        assert str(error)
