"""Slots for connections: no user gets all of them, and a former operator always gets one."""

from __future__ import annotations

import pytest

from scope_ui_bridge.core.admission import KEPT_PLACES, OWN_PLACES, Places
from scope_ui_bridge.core.wire import Refusal


def test_a_connection_beyond_the_users_limit_replaces_the_users_oldest() -> None:
    places: Places[str] = Places(48)
    gone = [places.take(f"v{n}", "eve", "/video", kept=False) for n in range(47)]
    assert gone == [None] * OWN_PLACES + [f"v{n}" for n in range(47 - OWN_PLACES)]
    assert places.take("c0", "eve", "/control", kept=False) is None, "another kind"
    assert places.take("v99", "ada", "/video", kept=False) is None
    assert len(places.owners()) == OWN_PLACES + 2


def test_the_connection_in_control_is_never_replaced() -> None:
    places: Places[str] = Places(48)
    for number in range(OWN_PLACES):
        places.take(f"c{number}", "ada", "/control", kept=True)
    assert places.take("c8", "ada", "/control", kept=True, spared="c0") == "c1"
    assert "c0" in places.owners()


def test_former_operators_get_a_reserved_slot_when_all_others_are_taken() -> None:
    places: Places[str] = Places(4)
    for number in range(4):
        places.take(f"p{number}", f"user {number}", "/control", kept=False)
    with pytest.raises(Refusal, match="too_many_viewers limit=2"):
        places.take("p4", "user 4", "/control", kept=False)
    for number in range(2 * KEPT_PLACES):
        assert places.take(f"k{number}", f"ada {number}", "/control", kept=True) is None
    with pytest.raises(Refusal):
        places.take("k8", "ada 8", "/control", kept=True)
    places.leave("p0")
    places.leave("p0")
    with pytest.raises(Refusal):
        places.take("p4", "user 4", "/control", kept=False)
