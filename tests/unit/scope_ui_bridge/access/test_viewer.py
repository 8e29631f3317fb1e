"""Limits of one page's messages: rate, size, order and role."""

from __future__ import annotations

import pytest

from scope_ui_bridge.core import wire
from scope_ui_bridge.core.access import SHORT, Role, Viewer
from scope_ui_bridge.core.admission import (
    BURST,
    BURST_BYTES,
    BYTES_PER_S,
    DROPPED_BURST,
    MAX_USERS,
    MESSAGES_PER_S,
    STOP_BURST,
    USER_BURST,
    Bucket,
    OfUsers,
    UserBudget,
)
from scope_ui_bridge.core.wire import Refusal

LONG = wire.MAX_BYTES


def alive(seq: int, boot: str = "now") -> wire.PageMessage:
    return wire.decode(f'{{"type": "alive", "boot": "{boot}", "epoch": 0, "seq": {seq}, "client_ms": 0}}')


def limited(viewer: Viewer, now_s: float, size: int = 100, longest: int = LONG) -> str:
    """Return why a message is refused unread, empty when it is not."""
    try:
        viewer.limit(size, longest, now_s)
    except Refusal as refusal:
        return refusal.code
    return ""


def test_a_burst_is_taken_and_then_only_the_rate() -> None:
    viewer, now_s = Viewer("a", Role.OPERATOR), 100.0
    assert [limited(viewer, now_s) for _ in range(int(BURST))] == [""] * int(BURST)
    assert limited(viewer, now_s) == "rate_limited"
    for _ in range(40):
        now_s += 1.0001 / MESSAGES_PER_S
        assert limited(viewer, now_s) == ""
    assert limited(viewer, now_s) == "rate_limited"
    assert [viewer.may_tell_rate(at) for at in (now_s, now_s + 0.9, now_s + 1.0)] == [True, False, True]


def test_a_page_that_ignores_the_warning_is_flooding_and_one_that_slows_down_is_not() -> None:
    viewer, now_s = Viewer("a", Role.OPERATOR), 100.0
    codes = [limited(viewer, now_s) for _ in range(int(BURST + DROPPED_BURST) + 1)]
    assert codes == [""] * int(BURST) + ["rate_limited"] * int(DROPPED_BURST) + ["flooding"]
    quick = Viewer("b", Role.OPERATOR)
    # Half more than is allowed, for ten minutes: reported and dropped, and never ended.
    found = {limited(quick, 100.0 + n / (1.2 * MESSAGES_PER_S)) for n in range(28_800)}
    assert found == {"", "rate_limited"}


def test_all_pages_of_a_user_share_that_users_rate() -> None:
    user, other = UserBudget(), UserBudget()
    pages = [Viewer("a", Role.VIEWER, user=user) for _ in range(6)]
    taken = [limited(page, 100.0) for page in pages for _ in range(40)]
    assert taken.count("") == USER_BURST
    assert limited(Viewer("b", Role.OPERATOR, user=other), 100.0) == ""


def test_bytes_are_limited_as_well_and_what_is_too_long_costs_none() -> None:
    viewer = Viewer("a", Role.OPERATOR)
    assert limited(viewer, 100.0, SHORT + 1, SHORT) == "oversized"
    assert limited(viewer, 100.0, LONG + 1) == "oversized"
    assert [limited(viewer, 100.0, LONG) for _ in range(4)] == ["", "", "", "rate_limited"]
    assert BURST_BYTES == 100e3 and limited(viewer, 100.0 + LONG / BYTES_PER_S, LONG - 1000) == ""


def test_only_short_texts_at_a_limited_rate_are_searched_for_a_stop() -> None:
    viewer = Viewer("a", Role.VIEWER)
    stop = '{"type":"stop","seq":1}'
    assert not viewer.may_stop('{"type":"alive"}', 100.0)
    assert not viewer.may_stop(stop + 600 * " ", 100.0)
    assert viewer.may_stop(stop.encode(), 100.0)
    assert [viewer.may_stop(stop, 100.0) for _ in range(30)].count(True) == STOP_BURST - 1
    assert viewer.may_stop(stop, 100.2)


def test_what_is_refused_is_not_counted_as_heard() -> None:
    viewer = Viewer("a", Role.OPERATOR)
    viewer.admit(alive(5), "now")
    for message, code in ((alive(9, boot="before"), "old_boot"), (alive(5), "replayed")):
        with pytest.raises(Refusal) as refusal:
            viewer.admit(message, "now")
        assert refusal.value.code == code
    viewer.admit(alive(6), "now")


def test_roles() -> None:
    Viewer("a", Role.ENGINEER).need(Role.OPERATOR)
    with pytest.raises(Refusal) as refusal:
        Viewer("a", Role.OPERATOR).need(Role.ENGINEER)
    assert refusal.value.message() == {"code": "role_needed", "values": {"role": "engineer", "found": "operator"}}


def test_a_clock_that_is_set_back_neither_fills_a_bucket_nor_blocks_a_user_for_long() -> None:
    bucket = Bucket(10.0, 1.0)
    assert bucket.take(100.0) and not bucket.take(50.0)
    assert bucket.wait_s() == pytest.approx(0.1)
    assert bucket.take(50.11)


def test_the_memory_for_users_is_bounded_and_keeps_active_users() -> None:
    budgets = OfUsers(lambda: Bucket(1.0, 1.0))
    first = budgets["a"]
    for number in range(2 * MAX_USERS):
        _ = budgets[f"user {number}"]
        assert budgets["a"] is first
    assert len(budgets._of) == MAX_USERS
