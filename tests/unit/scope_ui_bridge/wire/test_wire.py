"""Messages of the page: what is taken, and that nothing else gets through."""

from __future__ import annotations

import json
import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from scope_ui_bridge.core import wire
from scope_ui_bridge.core.wire import Refusal

HEAD = {"seq": 1, "boot": "b", "epoch": 0}


def text(**fields: object) -> str:
    return json.dumps({**HEAD, **fields})


def test_each_kind_of_message_is_typed() -> None:
    assert wire.decode(text(type="alive", client_ms=12.5)) == wire.Alive(seq=1, boot="b", epoch=0, client_ms=12.5)
    assert wire.decode(text(type="hidden")) == wire.Hidden(seq=1, boot="b", epoch=0)
    assert wire.decode(text(type="stop")) == wire.StopAll(seq=1, boot="b", epoch=0)
    assert wire.decode(text(type="stop", press="x7")) == wire.StopAll(seq=1, boot="b", epoch=0, press="x7")
    assert wire.decode(text(type="lease", step="take")) == wire.Lease(seq=1, boot="b", epoch=0, step="take")
    granted = wire.decode(text(type="lease", step="grant", to="v2"))
    assert granted == wire.Lease(seq=1, boot="b", epoch=0, step="grant", to="v2")
    assert wire.decode(text(type="call", service="home")) == wire.Call(seq=1, boot="b", epoch=0, service="home")
    sent = wire.decode(text(type="call", service="home", sent_ms=1500.5))
    assert sent == wire.Call(seq=1, boot="b", epoch=0, service="home", sent_s=1.5005)
    stamp = "1795225165871340849"  # does not fit into a double
    select = wire.decode(text(type="select", camera="left", stamp=stamp, u=10.5, v=3))
    assert isinstance(select, wire.Select)
    assert (select.point_px, select.control, select.stamp_ns) == ((10.5, 3.0), "", 1795225165871340849)
    act = wire.decode(text(type="act", gesture="turn", argument=-15, selection=4, camera="left", stamp=stamp))
    assert isinstance(act, wire.Act)
    assert (act.gesture, act.argument, act.selection) == ("turn", -15.0, 4)


@pytest.mark.parametrize(
    ("bad", "named"),
    [
        ('{"type":"alive","seq":1,"boot":"b","epoch":0,"client_ms":NaN}', "NaN"),
        ('{"type":"alive","seq":1,"boot":"b","epoch":0,"client_ms":-Infinity}', "Infinity"),
        ('{"type":"alive","seq":1,"boot":"b","epoch":0,"client_ms":1e999}', "1e999"),
        ('{"type":"alive","seq":' + "9" * 400 + "}", "400 digits"),
        ('{"type":"stop","type":"alive","seq":1}', "twice"),
        ("[" * 30000, "more than 8 open brackets"),
        ("", "Expecting"),
        ("[1]", "object"),
        (text(type="fly"), "fly"),
        (text(type="stop", extra=1), "extra"),
        (text(type="alive", client_ms="5"), "client_ms"),
        (text(type="alive", client_ms=True), "client_ms"),
        (text(type="stop", seq=-1), "seq"),
        (text(type="stop", seq=1.0), "seq"),
        (text(type="stop", boot="x" * 65), "boot"),
        (text(type="call", service="rm -rf"), "service"),
        (text(type="select", camera="up", stamp="1"), "camera"),
        (text(type="select", camera="left", stamp="1.5"), "stamp"),
        (text(type="select", camera="left", stamp="٣"), "stamp"),
        (text(type="select", camera="left", stamp="1", control="A", u=1, v=1), "control"),
        (text(type="select", camera="left", stamp="1", u=1), "v"),
        (text(type="act", gesture="hold", selection=1, camera="left", stamp="1"), "argument"),
    ],
)
def test_bad_messages_are_refused_by_name(bad: str, named: str) -> None:
    with pytest.raises(Refusal) as caught:
        wire.decode(bad)
    assert caught.value.code == "malformed"
    assert named in str(caught.value)


def test_a_message_of_more_than_32_kib_is_refused_with_the_bound() -> None:
    with pytest.raises(Refusal) as caught:
        wire.decode(" " * 32769)
    assert caught.value.message() == {"code": "oversized", "values": {"size": 32769, "limit": 32768}}


@settings(max_examples=150, deadline=None)
@given(
    st.one_of(
        st.binary(max_size=200),
        st.text(max_size=200),
        st.recursive(
            st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=8),
            lambda inner: (
                st.lists(inner, max_size=4) | st.dictionaries(st.sampled_from(["type", "seq", "u", "boot"]), inner)
            ),
            max_leaves=8,
        ).map(json.dumps),
    )
)
def test_anything_else_is_refused_and_never_raises_otherwise(garbage: str | bytes) -> None:
    with pytest.raises(Refusal):
        wire.decode(garbage)


def test_what_goes_out_is_json_even_with_nan_inside() -> None:
    sent = wire.encode({"a": math.nan, "b": [math.inf, 1.5], "c": {"d": -math.inf}, "e": (1, None)})
    assert sent == '{"a":null,"b":[null,1.5],"c":{"d":null},"e":[1,null]}'
