"""Messages: texts that keep their code and values on every way to another program."""

from __future__ import annotations

import copy
import json
import math
import pickle

import pytest

from icu_common.core.reasons.catalogue import Catalogue
from icu_common.core.reasons.message import MAX_DEPTH, Message, decoded, encoded, joined, quoted
from icu_common.core.reasons.state_text import as_message, because, split_state, state_name
from icu_common.nodes.messages.answers import answer_of, answer_text

OFF = Message("servo.touched_beside_target_allowed", error_mm=0.304, bound_mm=0.2)


def same(found: object, wanted: Message) -> bool:
    return isinstance(found, Message) and (found, found.code, found.values) == (wanted, wanted.code, wanted.values)


def test_a_message_is_its_english_text() -> None:
    assert OFF == "touched 0.30 mm off the target (limit 0.2 mm)"
    assert OFF.values == {"error_mm": 0.304, "bound_mm": 0.2}


def test_a_message_with_an_unknown_code_is_shown_with_its_values() -> None:
    assert Message("motion.never_heard_of", limit_mm=2) == "motion.never_heard_of limit_mm=2"


def test_an_error_keeps_the_message_it_was_raised_with() -> None:
    with pytest.raises(ValueError) as caught:
        raise ValueError(OFF)
    assert same(str(caught.value), OFF)


def test_a_message_inside_another_keeps_its_code() -> None:
    whole = Message("controller.machine_told_stop", cause=OFF)
    assert same(whole.values["cause"], OFF)
    assert whole == f"{OFF}; the controller has ordered a stop"


@pytest.mark.parametrize("copied", [copy.copy, copy.deepcopy, lambda m: pickle.loads(pickle.dumps(m))])
def test_a_copy_is_a_message(copied: object) -> None:
    assert callable(copied) and same(copied(OFF), OFF)


def test_messages_cross_json_inside_other_values() -> None:
    whole = {"reason": Message("controller.machine_told_stop", cause=OFF), "name": "text", "numbers": [1, OFF]}
    found = decoded(json.loads(json.dumps(encoded(whole))))
    assert same(found["reason"], whole["reason"]) and same(found["numbers"][1], OFF)
    assert type(found["name"]) is str


def test_a_value_that_is_no_finite_number_crosses_json_as_a_text() -> None:
    found = decoded(json.loads(json.dumps(encoded(Message("wait.for_s", age_s=math.nan)))))
    assert found == "for nan s" and found.values == {"age_s": "nan"}


def test_a_code_of_another_version_keeps_its_own_english() -> None:
    found = decoded({"code": "motion.new_cause", "values": {"limit_mm": 2}, "text": "a new cause (limit 2 mm)"})
    assert found == "a new cause (limit 2 mm)" and found.code == "motion.new_cause"


def deep(levels: int) -> dict[str, object]:
    inner: dict[str, object] = {"code": "text.more", "values": {}}
    for _ in range(levels):
        inner = {"code": "text.more", "values": {"first": inner}}
    return {**inner, "text": "shown instead"}


@pytest.mark.parametrize(
    "found",
    [
        {"code": "Wrong Code", "values": {}, "text": "shown instead"},
        {"code": "text.more", "values": {"first": [1]}, "text": "shown instead"},
        {"code": "text.more", "values": {"__class__": "x"}, "text": "shown instead"},
        {"code": "text.more", "values": {"first": True}, "text": "shown instead"},
        deep(MAX_DEPTH + 1),
    ],
)
def test_what_is_no_message_is_its_text_alone(found: dict[str, object]) -> None:
    text = decoded(found)
    assert text == "shown instead" and not isinstance(text, Message)


def test_texts_are_joined_into_one_message() -> None:
    assert joined(["", OFF, ""]) is OFF
    assert joined([]) == ""
    both = joined([OFF, "and a name"])
    assert both == f"{OFF}; and a name" and isinstance(both, Message) and same(both.values["first"], OFF)


def test_a_quoted_message_keeps_its_code_and_a_quoted_name_is_escaped() -> None:
    assert same(getattr(quoted(OFF), "values", {})["text"], OFF)
    assert quoted("a\nb") == r"'a\nb'"


def test_the_reason_of_a_state_is_a_message() -> None:
    state = because("stopped", OFF)
    assert state == f"stopped: {OFF}" and state_name(state) == "stopped"
    assert same(split_state(state)[1], OFF)
    assert because("idle", "") == "idle"


@pytest.mark.parametrize("text", ["idle", "stopped: stop requested", "calibrating 3/12, 9 s left"])
def test_a_received_state_in_a_sentence_has_its_text(text: str) -> None:
    assert as_message(text) == text


def test_the_answer_of_a_service_has_its_code_on_a_second_line() -> None:
    text = answer_text(OFF)
    assert text.splitlines()[0] == OFF and same(answer_of(text), OFF)
    assert answer_of("enabled") == "enabled"
    assert answer_of("two\nlines") == r"two\x0alines"
    assert answer_of('one\n{"code": 1}') == "one"


def test_a_sentence_chooses_by_number_and_by_word() -> None:
    lines = Catalogue(
        "a-b = { $n ->\n    [one] { $n } line\n   *[other] { $n } lines\n}"
        " of { $kind ->\n    [x] an x\n   *[y] a y\n}\n"
    )
    assert lines.sentence("a.b", {"n": 1, "kind": "x"}) == "1 line of an x"
    assert lines.sentence("a.b", {"n": 2, "kind": "z"}) == "2 lines of a y"
