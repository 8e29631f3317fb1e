"""Recognition and the stylus: a picture is read by the tip of that very picture, or told to be hidden."""

from __future__ import annotations

import time
from typing import Any

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PointStamped
from nodes.recognition_rig import PERIOD, START, Rig
from std_msgs.msg import Header
from unit.harris_perception.bench_scene import AWAY, LAYOUT, Scene

from icu_common.core.geometry.frames import CAMERA_LEFT
from icu_common.core.panel.panel_state import ControlSeen
from icu_common.nodes import qos
from icu_common.nodes.messages.heads import header
from icu_common.nodes.messages.panels import panel_state_of_message
from icu_common.nodes.messages.places import point_message
from icu_simulator.core.instrument import InstrumentState
from icu_simulator.core.renderer import Moment

pytestmark = pytest.mark.long

BUTTON = LAYOUT.control("RUN_STOP")
FRAME = 66_000_000
"""Between two pictures, of which recognition looks at every fourth or so, and the tracker at all."""


class Watched(Rig):
    """With the bench's pictures and camera, and the tracker's two answers."""

    def __init__(self, ros: Any, **parameters: Any) -> None:
        self.scene = Scene()
        once = {"recognition.agreement.frames": 1, "tip_wait_s": 60.0}
        super().__init__(ros, self.scene.camera, **{**once, **parameters})
        self.states: list[DiagnosticArray] = ros.collect(self.probe, DiagnosticArray, "state", qos.RESULTS)
        self.tips = self.probe.create_publisher(PointStamped, "tip", qos.RESULTS)
        self.unseen = self.probe.create_publisher(Header, "unseen", qos.RESULTS)
        for publisher in (self.tips, self.unseen):
            ros.spin_until(lambda p=publisher: p.get_subscription_count() == 1, 10.0)
        ros.spin_until(lambda: self.probe.count_publishers("state"), 10.0)
        self.over = self.scene.panel_from.apply(np.array([*BUTTON.position_mm, BUTTON.height_mm + 2.0]) * 1e-3)

    def look(self, number: int, tip: Any) -> None:
        """Show a picture with the stylus at ``tip`` (m, base_link) and wait until the panel was looked for in it."""
        at = tuple(float(v) for v in tip)
        left, _ = self.scene.renderer.render(Moment(tip=at, state=InstrumentState(), now_s=0.2 * number))
        assert self.show(left, number) > 0.5

    def tell_tip(self, number: int, tip: Any, later_ns: int = 0) -> None:
        stamp = START + number * PERIOD + later_ns
        self.tips.publish(point_message(self.scene.in_camera(tip), header(stamp, CAMERA_LEFT)))

    def tell_unseen(self, number: int) -> None:
        self.unseen.publish(header(START + number * PERIOD, CAMERA_LEFT))

    def told(self, count: int, name: str = BUTTON.name) -> ControlSeen:
        """Return a control in the ``count``-th state, which is the last."""
        self.ros.spin_until(lambda: len(self.states) >= count, 20.0)
        assert len(self.states) == count
        control = panel_state_of_message(self.states[-1]).control(name)
        assert control is not None
        return control


def test_what_the_stylus_hides_is_told_by_the_tip_of_that_very_picture(ros: Any) -> None:
    rig = Watched(ros)
    rig.tell_tip(1, AWAY)
    rig.look(1, AWAY)
    assert (rig.told(1).lamp, rig.told(1).hidden_by) == ("green", "")
    # The picture of the contact; its own tip comes last.
    rig.look(2, rig.over)
    rig.tell_tip(2, rig.over)
    assert (rig.told(2).lamp, rig.told(2).hidden_by) == ("", "stylus")
    rig.look(3, AWAY)
    rig.tell_tip(3, AWAY)
    assert (rig.told(3).lamp, rig.told(3).hidden_by) == ("green", "")


def test_what_the_tip_may_have_come_to_since_it_was_seen_is_not_read(ros: Any) -> None:
    rig = Watched(ros)
    beside = rig.over - (0.04, 0.0, -0.01)
    rig.tell_tip(1, beside)
    rig.look(1, beside)
    assert (rig.told(1).lamp, rig.told(1).hidden_by) == ("green", "")
    rig.look(2, rig.over)
    rig.tell_unseen(2)
    assert (rig.told(2).lamp, rig.told(2).hidden_by) == ("", "stylus")
    seen = {c.name: c for c in panel_state_of_message(rig.states[-1]).controls}
    assert seen["CH1_IN"].hidden_by == "", "too far away"
    # One that the tracker has left out: it works in order, so a later one says that none will come.
    rig.look(3, rig.over)
    rig.tell_tip(3, rig.over, later_ns=FRAME)
    assert (rig.told(3).lamp, rig.told(3).hidden_by) == ("", "stylus")
    # The stylus has left the picture long ago.
    rig.look(7, AWAY)
    rig.tell_unseen(7)
    assert (rig.told(4).lamp, rig.told(4).hidden_by) == ("green", "")


def test_a_picture_does_not_wait_for_a_tracker_that_has_fallen_silent(ros: Any) -> None:
    rig = Watched(ros, tip_wait_s=1.0)
    rig.look(1, AWAY)
    assert rig.told(1).lamp == "green", "no tracker at all: nothing to wait for"
    rig.tell_tip(2, AWAY)
    rig.look(2, AWAY)
    assert rig.told(2).lamp == "green"
    begin = time.monotonic()
    rig.look(3, AWAY)
    assert rig.told(3).lamp == "green", "it was too far away to have come here"
    assert time.monotonic() - begin < 15.0
    rig.look(7, AWAY)
    assert rig.told(4).lamp == "green"


@pytest.mark.parametrize("restart", [0, 1])
def test_a_recording_that_starts_anew_is_not_read_by_the_tips_of_its_end(ros: Any, restart: int) -> None:
    rig = Watched(ros)
    rig.tell_tip(40, AWAY)
    rig.look(40, AWAY)
    assert rig.told(1).lamp == "green"
    rig.look(restart, rig.over)
    rig.tell_tip(restart, rig.over)
    assert rig.told(2).hidden_by == "stylus"


def test_a_tracker_that_is_late_but_at_work_is_waited_for(ros: Any) -> None:
    """Over CH1 its arm is over SINGLE, too: "something (a hand?) hides SINGLE" ended presses on a busy computer."""
    rig = Watched(ros, tip_wait_s=3.0)
    channel = LAYOUT.control("CH1")
    over = rig.scene.panel_from.apply(np.array([*channel.position_mm, channel.height_mm + 4.0]) * 1e-3)
    rig.tell_tip(1, AWAY)
    rig.look(1, AWAY)
    assert rig.told(1).lamp == "green"
    rig.look(2, over)
    for late in range(15):  # 4.5 s, in which it works off older pictures
        until_s = time.monotonic() + 0.3
        ros.spin_until(lambda until_s=until_s: time.monotonic() >= until_s, 5.0)
        rig.tell_tip(1, AWAY, later_ns=late * FRAME // 8)
    assert len(rig.states) == 1, "its own tip has not come yet"
    rig.tell_tip(2, over)
    assert rig.told(2, "SINGLE").hidden_by == "stylus"


def test_a_tracker_that_is_far_behind_gets_fewer_pictures_instead_of_unread_ones(ros: Any) -> None:
    rig = Watched(ros)
    rig.tell_tip(1, AWAY)
    rig.look(1, AWAY)
    assert rig.told(1).lamp == "green"
    for number in range(2, 12):
        rig.look(number, rig.over)
    assert len(rig.states) == 1
    for number in range(2, 10):
        rig.tell_tip(number, rig.over)
        assert rig.told(number).hidden_by == "stylus"
    rig.look(12, AWAY)
    rig.tell_tip(12, AWAY)
    assert rig.told(10).lamp == "green", "those between were left out"
