"""Motions of a recorded session: which positions are commanded at a moment."""

from __future__ import annotations

import numpy as np
import pytest
from unit.icu_bringup.export import recorded_session as recorded

from icu_bringup.export.core.session import RecordedSession

NS = 1_000_000_000


@pytest.mark.parametrize(("frame", "name"), [("", ""), ("press/", ""), ("own", "own"), ("press/own", "own")])
def test_a_rejected_trajectory_commands_nothing_whatever_its_name(frame: str, name: str) -> None:
    session = RecordedSession()
    for topic, seconds, message in recorded.rows():
        if topic == "/gantry/trajectory":
            message.header.frame_id = frame
            name = name or str(message.header.stamp.sec * NS + message.header.stamp.nanosec)
            session.take(topic, recorded.START_NS + round(seconds * NS), message)
            rejection = recorded.answer(0.51, name, "rejected")
            session.take("/gantry/trajectory_result", recorded.START_NS + round(0.51 * NS), rejection)
        elif topic == "/joint_states":
            session.take(topic, recorded.START_NS + round(seconds * NS), message)
    at_ns = recorded.START_NS + round(1.2 * NS)
    state, target = session.state_at(at_ns), session.target_at(at_ns)
    assert state is not None and target is not None
    assert [motion.rejected for motion in session.motions] == [True]
    assert np.array_equal(target, state)
