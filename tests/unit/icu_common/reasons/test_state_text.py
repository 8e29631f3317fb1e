"""States of the machine as their topics write them."""

from __future__ import annotations

import pytest

from icu_common.core.reasons.state_text import split_state


@pytest.mark.parametrize(
    ("text", "state", "reason"),
    [
        ("calibrating 3/12, 9 s left", "calibrating", "3/12, 9 s left"),
        (
            "calibrating 3/12, 9 s left (stale: 0.5 s; repetition 1 of 4)",
            "calibrating",
            "3/12, 9 s left (stale: 0.5 s; repetition 1 of 4)",
        ),
        ("stopped: by the operator", "stopped", "by the operator"),
        ("idle", "idle", ""),
    ],
)
def test_progress_keeps_what_it_waits_for_in_one_piece(text: str, state: str, reason: str) -> None:
    assert split_state(text) == (state, reason)
