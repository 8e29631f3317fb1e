"""The right to move the machine: one page at a time."""

from __future__ import annotations

import pytest

from scope_ui_bridge.core.control import OperatorLease
from scope_ui_bridge.core.wire import Refusal


def code(call: object, *arguments: object) -> str:
    with pytest.raises(Refusal) as caught:
        call(*arguments)  # type: ignore[operator]
    return caught.value.code


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
