"""Sign-in: tokens, sessions, and waiting times after wrong passwords."""

from __future__ import annotations

import itertools

import pytest

from scope_ui_bridge.core.access import AGAIN, Role, SignIn, User
from scope_ui_bridge.core.wire import Refusal


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
    cookie = door.enter(token, 0.0)
    session = door.session(cookie, 1.0)
    assert session is not None
    assert session.name == "Operator 1"
    assert code(door.enter, token, 1.0) == "wrong_token"
    assert door.session("secret-0", 1.0) is None, "the token is not a cookie"


def test_a_new_token_makes_the_old_one_void_and_names_the_next_operator() -> None:
    door = sign_in()
    old, new = door.issue_token(), door.issue_token()
    assert code(door.enter, old, 0.0) == "wrong_token"
    first = door.enter(new, 0.0)
    second = door.enter(door.issue_token(), 0.0)
    names = [door.session(cookie, 0.0).name for cookie in (first, second)]  # type: ignore[union-attr]
    assert names == ["Operator 1", "Operator 2"]


def test_sessions_end_with_time_and_by_leaving() -> None:
    door = sign_in()
    cookie = door.enter(door.issue_token(), 0.0)
    assert door.session(cookie, 99.9) is not None
    assert door.session(cookie, 100.0) is None
    door.leave(cookie)
    assert door.session(cookie, 1.0) is None
    assert door.session("", 1.0) is None


def test_a_session_that_is_renewed_in_time_lives_as_long_as_a_new_one() -> None:
    door = sign_in()
    cookie, other = (door.enter(door.issue_token(), 0.0) for _ in range(2))
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
    first, second = (door.enter(door.issue_token(), 0.0) for _ in range(2))
    door.renew(first, 1.0)
    for _ in range(255):
        door.enter(door.issue_token(), 2.0)
    assert door.session(first, 3.0) is not None, "it was renewed after the second had begun"
    assert door.session(second, 3.0) is None


def test_wrong_tokens_cause_no_wait() -> None:
    door = sign_in()
    token = door.issue_token()
    for _ in range(2000):
        assert code(door.enter, "guess", 0.0) == "wrong_token"
    cookie = door.enter(token, 0.0)
    second = door.issue_token()
    assert code(door.use_up, "guess") == "wrong_token"
    door.use_up(second)
    assert door.renew(cookie, 1.0) is not None


def test_wrong_passwords_are_answered_with_longer_and_longer_waits_for_that_account_and_address_only() -> None:
    door = sign_in()
    ada = User(name="ada", role=Role.OPERATOR, hashed="")
    now, waits = 0.0, []
    for _ in range(7):
        assert code(door.enter_by_password, None, "ada", "bad", now) == "wrong_password"
        with pytest.raises(Refusal) as caught:
            door.check_wait("ada", "bad", now)
        assert caught.value.code == "wait"
        waits.append(caught.value.values["seconds"])
        for account, remote in (("ada", "good"), ("eve", "bad"), ("ada", AGAIN)):
            door.check_wait(account, remote, now)
        now += waits[-1]
    assert waits == [0.5, 1.0, 2.0, 4.0, 8.0, 10.0, 10.0]
    assert door.enter_by_password(ada, "ada", "bad", now)
    assert code(door.enter_by_password, None, "ada", "bad", now) == "wrong_password"
    with pytest.raises(Refusal) as caught:
        door.check_wait("ada", "bad", now)
    assert caught.value.values["seconds"] == 0.5, "a good password begins again"


def test_the_memory_for_failures_is_bounded() -> None:
    door = sign_in()
    for number in range(3000):
        code(door.enter_by_password, None, "ada", f"host {number}", 0.0)
    assert len(door._failures) == 1024


def test_an_observer_who_signs_in_again_and_again_ends_only_its_own_sessions() -> None:
    door = sign_in()
    eve = User(name="eve", role=Role.VIEWER, hashed="")
    operator = door.enter(door.issue_token(), 0.0)
    entered, waits = [], 0
    for number in range(263):
        try:
            entered.append(door.enter_by_password(eve, "eve", "127.0.0.1", number * 36 / 263))
        except Refusal as refusal:
            assert refusal.code == "wait" and 0 < refusal.values["seconds"] <= 5
            waits += 1
    assert door.session(operator, 36.0) is not None
    assert len(entered) == 17 and waits == 263 - 17, "ten at once, then one each 5 s"
    assert code(door.check_wait, "eve", "another address", 36.0) == "wait", "before the password is looked at"
    door.check_wait("eve", AGAIN, 36.0)
    door.check_wait("ada", "127.0.0.1", 36.0)
    assert [door.session(cookie, 36.0) is not None for cookie in entered] == [False] * 9 + [True] * 8
    assert {(session.name, why) for session, why in door.take_ended(36.0)} == {("eve", "8 newer ones of the same user")}


def test_sessions_of_former_operators_end_last() -> None:
    door = sign_in()
    door.spares = lambda name: name == "Operator 1"
    eve = User(name="eve", role=Role.VIEWER, hashed="")
    operator = door.enter(door.issue_token(), 0.0)
    second = door.enter(door.issue_token(), 0.0)
    own = [door.enter_by_password(eve, "eve", "a", 0.0) for _ in range(3)]
    for _ in range(254):
        door.enter(door.issue_token(), 1.0)
    gone = [session.name for session, _ in door.take_ended(1.0)]
    assert gone == ["eve", "eve", "Operator 2"], "first of the user who has most, then the oldest"
    assert door.session(operator, 1.0) is not None and door.session(second, 1.0) is None
    assert door.session(own[2], 1.0) is not None
