"""The golden bag through perception, hand-eye and controller: the same results as recorded, at any speed.

`make golden` makes the bag and its expectation again; the report of a difference is in artifacts/golden.
"""

from __future__ import annotations

import dataclasses
import json
import re
import sys
import threading
from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np
import pytest
from golden.expectation import BAG, BAG_CHECK, EXPECTED, ROOT, bag_check
from golden.make_bag import CONTROLLER, TIPS, TRACKER

from icu_bringup.adapters.bag.bag_reader import BagReader
from icu_bringup.adapters.check.messages import read_messages
from icu_bringup.adapters.check.prepared_bag import played_topics
from icu_bringup.adapters.check.replay import Replay, free_domain
from icu_bringup.core.check.comparison import TopicMessages, compare
from icu_bringup.core.check.expectation import from_yaml
from icu_bringup.core.check.report import table

EXPECTATION = from_yaml(EXPECTED.read_text(encoding="utf-8"))
BEGINNING_S = 3.0
ARTIFACTS = ROOT / "artifacts" / "golden"

pytestmark = [pytest.mark.system, pytest.mark.timeout(400)]


@pytest.fixture(scope="module", autouse=True)
def installed() -> Iterator[None]:
    """Let this process find the installed programs as bag_check does."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "argv", [str(BAG_CHECK)])
        yield


def replayed(folder: Path, *, rate: float = 1000.0, duration_s: float = 0.0) -> dict[str, TopicMessages]:
    """Replay the bag, or its beginning."""
    run = dataclasses.replace(EXPECTATION.run, duration_s=duration_s)
    stop = threading.Event()
    replay = Replay(folder, free_domain(), run, len(run.nodes), ["sequencer"], ROOT / "config")
    try:
        topics = replay.wait_until_started(stop)
        # A part is no calibration.
        played = played_topics(BAG, {*topics.read, *([] if duration_s else ["/bag/cue"])}, topics.published, ())
        out = replay.play(BAG, played, list(EXPECTATION.topics), stop, rate=rate).results
    finally:
        assert replay.stop() == 0, replay.tail()
    return read_messages(out)


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> dict[str, TopicMessages]:
    """The whole bag, as fast as it goes."""
    return replayed(tmp_path_factory.mktemp("replay") / "run")


def test_the_replay_gives_the_recorded_results(whole: dict[str, TopicMessages]) -> None:
    rows = compare(EXPECTATION, read_messages(EXPECTED.parent / EXPECTATION.messages), whole)
    print("\n" + table(rows))
    assert len(rows) > 50 and {row.topic for row in rows} == set(EXPECTATION.topics)
    assert all(row.passed for row in rows), table([row for row in rows if not row.passed])


def test_the_documentation_replays_it_with_the_same_settings() -> None:
    text = (ROOT / "docs" / "how-to" / "recording.md").read_text(encoding="utf-8")
    documented = re.findall(r"--set ([\w.]+)=([\d.]+)", text)
    expected = {"hand_eye.still.tips": TIPS}
    for node, values in (("stylus_tracker", TRACKER), ("gantry_controller", CONTROLLER)):
        expected |= {f"{node}.{name}": value for name, value in values.items()}
    assert {name: float(value) for name, value in documented} == expected
    assert {name: float(value) for name, value in (s.split("=") for s in EXPECTATION.run.settings)} == expected
    with BagReader(BAG) as bag:
        trajectories = next(topic.count for topic in bag.topics if topic.name == "/gantry/trajectory")
        assert f"`{bag.count - trajectories} messages played`" in text


@pytest.mark.long
def test_no_image_is_dropped_and_speed_changes_nothing(whole: dict[str, TopicMessages], tmp_path: Path) -> None:
    slow = replayed(tmp_path / "run", rate=1.0, duration_s=BEGINNING_S)
    for side in ("left", "right"):
        corners = f"/stereo/{side}/corners"
        assert [m.stamp_ns for m in slow[corners].messages] == image_stamps(side)
        assert same(slow, whole, corners)
    assert slow["/stylus/tip"].messages and slow["/stereo/panel_plane"].messages
    for topic in ("/stylus/tip", "/stereo/panel_plane"):
        last = max(image_stamps("left"))
        expected = [m.stamp_ns for m in whole[topic].messages if m.stamp_ns <= last]
        assert [m.stamp_ns for m in slow[topic].messages] == expected
        assert same(slow, whole, topic)


def same(part: Mapping[str, TopicMessages], whole: Mapping[str, TopicMessages], topic: str) -> bool:
    """Return whether each message of a part is in the whole, to the last bit."""
    by_stamp = {m.stamp_ns: m for m in whole[topic].messages}
    return all(
        np.array_equal(value.data, by_stamp[m.stamp_ns].values[path].data)
        for m in part[topic].messages
        for path, value in m.values.items()
    )


def image_stamps(side: str) -> list[int]:
    """Return the stamps of the images that are played within the beginning."""
    topic = f"/stereo/{side}/image_raw/compressed"
    with BagReader(BAG) as bag:
        kind = next(t.type for t in bag.topics if t.name == topic)
        end_ns = bag.start_ns + round(BEGINNING_S * 1e9)
        stamps = [
            bag.decode(data, kind).header.stamp for _, time_ns, data in bag.messages([topic]) if time_ns <= end_ns
        ]
    return [stamp.sec * 1_000_000_000 + stamp.nanosec for stamp in stamps]


def test_a_changed_parameter_is_different_and_the_report_shows_where() -> None:
    done = bag_check("--set", "corners_left.k=0.2", "--out", ARTIFACTS)
    assert done.returncode == 1, f"{done.stdout}{done.stderr}"
    rows = json.loads((ARTIFACTS / "fields.json").read_text(encoding="utf-8"))
    different = {(row["topic"], row["field"]) for row in rows if not row["passed"]}
    assert ("/stereo/left/corners", "points") in different, done.stdout
    assert {topic for topic, _ in different} <= {"/stereo/left/corners", "/stereo/panel_plane"}, done.stdout
    assert "| /stereo/left/corners | points |" in (ARTIFACTS / "summary.md").read_text(encoding="utf-8")
    assert (ARTIFACTS / "stereo_left_corners.points.png").stat().st_size > 10_000
