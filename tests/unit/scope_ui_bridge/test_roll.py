"""The roll of those who report on /diagnostics."""

from __future__ import annotations

from scope_ui_bridge.core.roll import Roll


def test_who_falls_silent_is_named_once_and_again_after_a_return() -> None:
    roll = Roll(limit_s=3.0)
    assert not roll.heard("stereo", 0.0) and not roll.heard("camera", 0.0)
    assert not roll.heard("camera", 2.0)
    assert roll.newly_gone(3.0) == []
    assert roll.newly_gone(3.1) == ["stereo"]
    assert roll.newly_gone(4.0) == []
    assert roll.heard("stereo", 5.0) and not roll.heard("stereo", 5.5)
    assert roll.newly_gone(9.0) == ["camera", "stereo"]
