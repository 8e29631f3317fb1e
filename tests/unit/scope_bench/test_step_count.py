"""When a message, and all that followed from it, has been dealt with."""

from __future__ import annotations

from typing import Any

from scope_bench.core.step_count import StepCount


def counts(process: int, listeners: dict[str, int], **others: dict[str, int]) -> dict[str, Any]:
    return {"process": process, "listeners": listeners, "sent": {}, "taken": {}, "readers": {}, **others}


def test_a_message_is_under_way_until_its_results_have_been_taken_too() -> None:
    count = StepCount()
    # The start: a latched message that the second process came too late for.
    count.hear(counts(1, {"/image": 1}, sent={"/state": 1}))
    count.hear(counts(2, {"/corners": 1, "/state": 1}))
    count.begin()
    assert count.under_way() == []

    count.played["/image"] += 1
    assert count.under_way() == ["/image"]
    count.hear(counts(1, {"/image": 1}, sent={"/state": 1, "/corners": 1}, taken={"/image": 1}))
    assert count.under_way() == ["/corners"]
    count.hear(counts(2, {"/corners": 1, "/state": 1}, taken={"/corners": 1}))
    assert count.under_way() == []


def test_a_topic_with_two_listeners_in_a_process_is_taken_twice() -> None:
    count = StepCount()
    count.hear(counts(1, {"/image": 2}))
    count.played["/image"] += 1
    count.hear(counts(1, {"/image": 2}, taken={"/image": 1}))
    assert count.under_way() == ["/image"]
    count.hear(counts(1, {"/image": 2}, taken={"/image": 2}))
    assert count.under_way() == []


def test_who_has_not_found_its_listeners_is_named() -> None:
    count = StepCount()
    count.hear(counts(1, {"/image": 1}, readers={"/corners": 0}))
    count.hear(counts(2, {"/image": 1, "/corners": 1}))
    assert count.processes == 2
    assert count.unmatched({"/image": 1, "/clock": 0}) == ["/corners", "/image"]
    assert count.unmatched({"/image": 2}) == ["/corners"]


def test_what_a_replay_waits_for_is_said_and_nothing_else() -> None:
    count = StepCount()
    assert count.waiting_for(2, {}).startswith("0 of 2 processes play in step (")
    assert count.waiting_for(2, {}).endswith("bring_up --in-step?)")
    count.hear(counts(1, {"/image": 1}))
    assert count.waiting_for(1, {"/image": 0}) == "not all have found each other on /image"
    assert count.waiting_for(1, {"/image": 1}) == ""
    count.played["/image"] += 1
    assert count.waiting_for(1, {"/image": 1}) == "not all has been taken that was sent on /image"
    count.begin()
    assert count.waiting_for(1, {"/image": 1}) == ""
