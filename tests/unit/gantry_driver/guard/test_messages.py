"""The limits of a frame, to the byte, and what an error says."""

from __future__ import annotations

import json
import re
import struct

import pytest

from gantry_driver.core.guard.messages import MAX_FRAME_BYTES, FrameError, FrameReader, frame
from icu_common.core.reasons.message import Message, decoded

LIMIT = "4194304"


def test_the_limit_is_four_mebibytes() -> None:
    assert int(LIMIT) == MAX_FRAME_BYTES


def test_a_message_as_long_as_the_limit_is_sent_and_read_and_one_byte_more_is_neither() -> None:
    rest = len(json.dumps({"t": ""}, separators=(",", ":")))
    longest = {"t": "x" * (MAX_FRAME_BYTES - rest)}
    data = frame(longest)
    assert len(data) == 4 + MAX_FRAME_BYTES and data[:4] == struct.pack(">I", MAX_FRAME_BYTES)
    assert list(FrameReader().feed(data)) == [longest]
    text = re.escape(f"the frame has {MAX_FRAME_BYTES + 1} bytes (limit {LIMIT})")
    with pytest.raises(FrameError, match=f"^{text}$"):
        frame({"t": longest["t"] + "x"})
    with pytest.raises(FrameError, match=f"^{text}$"):
        list(FrameReader().feed(struct.pack(">I", MAX_FRAME_BYTES + 1)))


def test_an_unreadable_frame_is_named_with_its_cause() -> None:
    with pytest.raises(FrameError, match=r"^the frame is not JSON: Expecting value: line 1 column 1 \(char 0\)$"):
        list(FrameReader().feed(struct.pack(">I", 3) + b"abc"))
    with pytest.raises(FrameError, match=r"^the frame is not a JSON object$"):
        list(FrameReader().feed(struct.pack(">I", 2) + b"[]"))


def test_a_length_waits_for_its_last_byte() -> None:
    reader, data = FrameReader(), frame({"n": 1})
    assert [list(reader.feed(data[at : at + 1])) for at in range(len(data))] == [*([[]] * (len(data) - 1)), [{"n": 1}]]


def test_a_text_with_a_code_keeps_it_and_other_values_arrive_as_they_are() -> None:
    reason = Message("guard.driver_node_silent", silent_s=0.12)
    (message,) = FrameReader().feed(frame({"do": "stop", "reason": reason, "age_s": 0.5, "points": [[1, 2]]}))
    found = decoded(message.pop("reason"))
    assert (found, found.code, dict(found.values)) == (reason, "guard.driver_node_silent", {"silent_s": 0.12})
    assert message == {"do": "stop", "age_s": 0.5, "points": [[1, 2]]}
