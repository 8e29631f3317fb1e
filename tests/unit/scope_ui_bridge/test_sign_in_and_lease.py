"""Who gets in, and who may move the machine."""

from __future__ import annotations

import itertools

import pytest

from scope_ui_bridge.core.lease import OperatorLease
from scope_ui_bridge.core.refusal import Refusal
from scope_ui_bridge.core.sign_in import SignIn


def sign_in() -> SignIn:
    numbers = itertools.count()
    return SignIn(lambda: f"secret-{next(numbers)}", session_lifetime_s=100.0)


def code(call: object, *arguments: object) -> str:
    with pytest.raises(Refusal) as caught:
        call(*arguments)  # type: ignore[operator]
    return caught.value.code


def test_a_token_signs_in_once() -> None:
    door = sign_in()
    token = door.issue_token()
    cookie = door.enter(token, "a", 0.0)
    session = door.session(cookie, 1.0)
    assert session is not None
    assert session.name == "Operator 1"
    assert code(door.enter, token, "a", 1.0) == "wrong_token"
    assert door.session("secret-0", 1.0) is None, "the token is not a cookie"


def test_a_new_token_makes_the_old_one_void_and_names_the_next_operator() -> None:
    door = sign_in()
    old, new = door.issue_token(), door.issue_token()
    assert code(door.enter, old, "a", 0.0) == "wrong_token"
    first = door.enter(new, "b", 0.0)
    second = door.enter(door.issue_token(), "b", 0.0)
    names = [door.session(cookie, 0.0).name for cookie in (first, second)]  # type: ignore[union-attr]
    assert names == ["Operator 1", "Operator 2"]


def test_sessions_end_with_time_and_by_leaving() -> None:
    door = sign_in()
    cookie = door.enter(door.issue_token(), "a", 0.0)
    assert door.session(cookie, 99.9) is not None
    assert door.session(cookie, 100.0) is None
    door.leave(cookie)
    assert door.session(cookie, 1.0) is None
    assert door.session("", 1.0) is None


def test_a_session_that_is_renewed_in_time_lives_as_long_as_a_new_one() -> None:
    door = sign_in()
    cookie, other = (door.enter(door.issue_token(), "a", 0.0) for _ in range(2))
    before = door.session(cookie, 99.0)
    renewed = door.renew(cookie, 99.0)
    assert before is not None and renewed is not None
    assert (renewed.name, renewed.role, renewed.ends_s) == (before.name, before.role, 199.0)
    assert door.session(cookie, 198.9) == renewed
    assert door.session(other, 100.0) is None, "nobody else's"
    assert door.renew(other, 100.0) is None and door.session(other, 100.0) is None, "what has ended stays ended"
    assert door.renew("", 1.0) is None


def test_the_longest_unused_sessions_go_when_there_are_too_many() -> None:
    door = sign_in()
    first, second = (door.enter(door.issue_token(), "a", 0.0) for _ in range(2))
    door.renew(first, 1.0)
    for _ in range(255):
        door.enter(door.issue_token(), "a", 2.0)
    assert door.session(first, 3.0) is not None, "it was renewed after the second had begun"
    assert door.session(second, 3.0) is None


def test_failures_are_answered_with_longer_and_longer_waits_for_that_address_only() -> None:
    door = sign_in()
    token = door.issue_token()
    now, waits = 0.0, []
    for _ in range(7):
        assert code(door.enter, "guess", "bad", now) == "wrong_token"
        with pytest.raises(Refusal) as caught:
            door.enter(token, "bad", now)  # even the right one is not looked at
        assert caught.value.code == "wait"
        waits.append(caught.value.values["seconds"])
        now += waits[-1]
    assert waits == [0.5, 1.0, 2.0, 4.0, 8.0, 10.0, 10.0]
    assert door.enter(token, "good", 0.0)


def test_the_memory_for_failures_is_bounded() -> None:
    door = sign_in()
    for number in range(3000):
        code(door.enter, "guess", f"host {number}", 0.0)
    assert len(door._failures) <= 1024


def test_one_holder_and_a_new_epoch_with_each_change_of_hands() -> None:
    lease = OperatorLease()
    lease.take("a", 0.0)
    lease.take("a", 1.0)
    assert lease.epoch == 1
    assert code(lease.take, "b", 1.0) == "lease_held"
    lease.request("b", 1.0)
    assert (lease.holder, lease.requester) == ("a", "b")
    assert code(lease.grant, "b", "b", 1.0) == "no_lease"
    lease.grant("a", "b", 2.0)
    assert (lease.holder, lease.requester, lease.epoch) == ("b", "", 2)
    assert code(lease.check, "b", 1) == "stale_epoch"
    assert code(lease.check, "a", 2) == "no_lease"
    lease.check("b", 2)


def test_control_goes_to_nobody_else_than_whose_name_was_read() -> None:
    lease = OperatorLease()
    lease.take("a", 0.0)
    lease.request("b", 1.0)
    lease.request("c", 1.0)  # while "a" reads b's name
    assert code(lease.grant, "a", "b", 1.0) == "other_request"
    assert code(lease.decline, "a", "b") == "other_request"
    assert (lease.holder, lease.requester, lease.epoch) == ("a", "c", 1)
    lease.grant("a", "c", 2.0)
    assert lease.holder == "c"


def test_only_the_holder_keeps_the_lease_alive() -> None:
    lease = OperatorLease()
    assert lease.silence_s(10.0) == float("inf")
    lease.take("a", 10.0)
    lease.alive("b", 10.5)
    assert lease.silence_s(10.75) == 0.75
    lease.alive("a", 10.75)
    assert lease.silence_s(10.75) == 0.0


def test_release_and_decline() -> None:
    lease = OperatorLease()
    lease.take("a", 0.0)
    lease.request("b", 0.0)
    assert not lease.release("b")
    assert lease.requester == ""
    lease.request("c", 0.0)
    lease.decline("a", "c")
    assert lease.requester == ""
    assert code(lease.grant, "a", "c", 0.0) == "no_request"
    assert lease.release("a")
    assert (lease.holder, lease.epoch) == ("", 2)
