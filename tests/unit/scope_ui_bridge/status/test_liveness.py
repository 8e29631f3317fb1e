"""Nodes that report on /diagnostics: late, hanging or ended, one line for each change."""

from __future__ import annotations

import pytest

from scope_ui_bridge.core.status import Change, Condition, LivenessMonitor, Sender, judge


class Monitored:
    """A monitor that is checked every half second, and what is known of each sender."""

    def __init__(self) -> None:
        self.monitor = LivenessMonitor(limit_s=3.0)
        self.now_s = 100.0
        self.known: dict[str, Condition] = {}
        self.asked: list[str] = []

    def heard(self, name: str) -> bool:
        return self.monitor.heard(name, Sender(node=f"/{name}"))

    def check(self, after_s: float = 0.5) -> list[tuple[str, Condition]]:
        self.now_s += after_s
        return [(change.name, change.condition) for change in self.changes()]

    def changes(self) -> list[Change]:
        return self.monitor.check(self.now_s, self._condition)

    def _condition(self, sender: Sender) -> Condition:
        self.asked.append(sender.node)
        return self.known.get(sender.node, Condition.LATE)

    def check_for(self, seconds: float) -> list[tuple[str, Condition]]:
        return [change for _ in range(round(seconds / 0.5)) for change in self.check()]


def test_each_change_is_named_once_and_again_after_a_return() -> None:
    watch = Monitored()
    assert not watch.heard("stereo") and not watch.heard("camera") and watch.check() == []
    assert watch.check_for(2.0) == [] and watch.asked == [], "nothing is looked up while all report"
    assert not watch.heard("camera")
    assert watch.check_for(2.0) == [("stereo", Condition.LATE)]
    watch.known["/stereo"] = Condition.HANGS
    assert watch.check_for(1.0) == [("stereo", Condition.HANGS)]
    watch.known["/stereo"] = Condition.ENDED
    assert watch.check_for(5.0) == [("camera", Condition.LATE), ("stereo", Condition.ENDED)]
    assert watch.check_for(60.0) == [], "a silent node is no news"
    assert watch.heard("stereo") and not watch.heard("stereo")
    assert watch.check_for(10.0) == [("stereo", Condition.ENDED)], "after an end the limit is as before"


def test_a_node_that_is_late_again_and_again_is_named_less_and_less_often() -> None:
    watch = Monitored()

    def late_after_s() -> float:
        for turn in range(200):
            if watch.check():
                return turn * 0.5
        raise AssertionError("never late")

    watch.heard("stereo")
    watch.check()
    found = []
    for _ in range(7):
        found.append(late_after_s())
        assert watch.heard("stereo")
    assert found == [3.0, 6.0, 12.0, 24.0, 48.0, 60.0, 60.0]
    for _ in range(61):
        watch.heard("stereo")
        assert watch.check_for(1.0) == []
    watch.heard("stereo")
    assert late_after_s() == 3.0, "after a minute without news"


def test_a_bridge_that_was_held_up_itself_takes_no_node_for_late() -> None:
    watch = Monitored()
    watch.heard("stereo")
    watch.check()
    assert watch.check(after_s=60.0) == [] and watch.check(after_s=-1000.0) == []
    assert watch.check_for(2.0) == []
    assert watch.check_for(1.0) == [("stereo", Condition.LATE)]


def test_a_change_says_for_how_long_the_node_has_been_silent() -> None:
    watch = Monitored()
    watch.heard("stereo")
    watch.check()
    assert watch.check_for(3.0) == []
    watch.now_s += 0.5
    assert watch.changes() == [Change(name="stereo", condition=Condition.LATE, silent_s=3.5)]


@pytest.mark.parametrize(
    ("alive", "hangs", "in_graph", "condition"),
    [
        (True, False, True, Condition.LATE),
        (True, False, False, Condition.LATE),  # a stopped process leaves the graph and comes back
        (True, True, True, Condition.HANGS),
        (False, True, True, Condition.ENDED),  # the graph keeps a killed node for seconds
        (False, False, False, Condition.ENDED),
        (None, False, True, Condition.LATE),
        (None, False, False, Condition.ENDED),
    ],
)
def test_ended_and_hangs_need_a_reason(alive: bool | None, hangs: bool, in_graph: bool, condition: Condition) -> None:
    assert judge(alive=alive, hangs=hangs, in_graph=in_graph) is condition
