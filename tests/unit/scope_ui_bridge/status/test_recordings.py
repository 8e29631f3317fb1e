"""Running recordings: those of this bridge, and those of other recorders in the graph."""

from __future__ import annotations

from scope_ui_bridge.core.status import Recordings


def test_a_recorder_of_the_graph_counts_from_when_it_was_first_seen() -> None:
    recordings = Recordings()
    recordings.seen([], 100.0)
    recordings.seen(["/rosbag2_recorder"], 110.0)
    recordings.seen(["/rosbag2_recorder", "/bed_2/bag_recorder"], 111.0)
    told = [
        {"who": "", "program": "/rosbag2_recorder", "for_s": 72, "at_least": False},
        {"who": "", "program": "/bed_2/bag_recorder", "for_s": 71, "at_least": False},
    ]
    assert recordings.message(182.9) == told
    recordings.seen(["/bed_2/bag_recorder"], 183.0)
    assert recordings.message(183.0) == [told[1] | {"for_s": 72}]
    recordings.seen(["/rosbag2_recorder"], 190.0)
    assert recordings.message(190.5) == [told[0] | {"for_s": 0}], "another one"


def test_one_that_was_there_before_the_bridge_has_recorded_for_at_least_so_long() -> None:
    recordings = Recordings()
    recordings.seen([], 100.0)
    recordings.seen(["/a"], 102.0)  # others are not all discovered at once
    recordings.seen(["/a", "/b"], 106.0)
    assert [(one["program"], one["at_least"]) for one in recordings.message(107.0)] == [("/a", True), ("/b", False)]


def test_the_bridges_own_recording_comes_first_with_its_operator() -> None:
    recordings = Recordings()
    recordings.seen(["/a"], 100.0)
    recordings.own = ("Jürgen Groß", 150.0)
    assert recordings.message(160.0) == [
        {"who": "Jürgen Groß", "program": "", "for_s": 10, "at_least": False},
        {"who": "", "program": "/a", "for_s": 60, "at_least": True},
    ]
    recordings.own = None
    assert [one["program"] for one in recordings.message(160.0)] == ["/a"]
