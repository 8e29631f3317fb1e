"""What one page may send, by the rate, the order and the role."""

from __future__ import annotations

import pytest

from scope_ui_bridge.core import wire
from scope_ui_bridge.core.passwords import Role
from scope_ui_bridge.core.refusal import Refusal
from scope_ui_bridge.core.viewer import BURST, MESSAGES_PER_S, Viewer


def alive(seq: int, boot: str = "now") -> wire.Message:
    return wire.decode(f'{{"type": "alive", "boot": "{boot}", "epoch": 0, "seq": {seq}, "client_ms": 0}}')


def refused(viewer: Viewer, message: wire.Message, now_s: float) -> str:
    with pytest.raises(Refusal) as refusal:
        viewer.admit(message, "now", now_s)
    return refusal.value.code


def test_a_burst_is_taken_and_then_only_the_rate() -> None:
    viewer, now_s = Viewer("a", Role.OPERATOR), 100.0
    for seq in range(int(BURST)):
        viewer.admit(alive(seq), "now", now_s)
    assert refused(viewer, alive(100), now_s) == "rate_limited"
    for seq in range(200, 240):
        now_s += 1.0001 / MESSAGES_PER_S
        viewer.admit(alive(seq), "now", now_s)
    assert refused(viewer, alive(300), now_s) == "rate_limited"
    assert [viewer.may_tell_rate(at) for at in (now_s, now_s + 0.9, now_s + 1.0)] == [True, False, True]


def test_what_is_refused_is_not_counted_as_heard() -> None:
    viewer = Viewer("a", Role.OPERATOR)
    viewer.admit(alive(5), "now", 1.0)
    assert refused(viewer, alive(9, boot="before"), 1.0) == "old_boot"
    assert refused(viewer, alive(5), 1.0) == "replayed"
    viewer.admit(alive(6), "now", 1.0)


def test_roles() -> None:
    Viewer("a", Role.ENGINEER).need(Role.OPERATOR)
    with pytest.raises(Refusal) as refusal:
        Viewer("a", Role.OPERATOR).need(Role.ENGINEER)
    assert refusal.value.message() == {"code": "role_needed", "values": {"role": "engineer", "found": "operator"}}
