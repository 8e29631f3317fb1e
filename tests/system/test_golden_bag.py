"""The golden bag through perception, hand-eye and controller: the same results as recorded, at any speed.

`make golden` makes the bag and the recorded results anew; a difference is printed as a table, with a picture in
artifacts/golden.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from golden import replay
from golden.replay import ReplayGraph, Results
from ros_rig import domain_of_worker

from scope_bench.adapters.bags import BagReader

EXPECTED = json.loads(replay.EXPECTED.read_text(encoding="utf-8"))
BEGINNING_S = 3.0
ARTIFACTS = Path(__file__).resolve().parents[2] / "artifacts" / "golden"

pytestmark = [pytest.mark.system, pytest.mark.timeout(400)]


@pytest.fixture(scope="module")
def graph(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ReplayGraph]:
    graph = ReplayGraph(tmp_path_factory.mktemp("replay"), domain=domain_of_worker())
    try:
        yield graph
    finally:
        assert graph.stop() == 0, graph.tail()


@pytest.fixture(scope="module")
def replayed(graph: ReplayGraph) -> Results:
    """The whole bag, as fast as it goes."""
    return graph.play()


def difference(found: Results, name: str) -> str:
    """Return the table of what differs, empty when nothing does; with it the picture."""
    rows = replay.compare(EXPECTED, found)
    if not any(row.off for row in rows):
        return ""
    return f"\n{replay.table(rows)}\npicture: {replay.draw(EXPECTED, found, rows, ARTIFACTS / name)}"


def test_the_replay_gives_the_recorded_results(replayed: Results) -> None:
    print("\n" + replay.table(replay.compare(EXPECTED, replayed), everything=True))
    found = difference(replayed, "replay.png")
    assert not found, found


def test_the_documentation_replays_it_with_the_same_settings() -> None:
    text = (replay.ROOT / "docs" / "recording.md").read_text(encoding="utf-8")
    told = re.findall(r"--set ([\w.]+)=([\d.]+)", text)
    assert {name: float(value) for name, value in told} == replay.settings()
    with BagReader(replay.BAG) as bag:
        assert f"`{bag.count - trajectories(bag)} messages played`" in text


def trajectories(bag: BagReader) -> int:
    return next(topic.count for topic in bag.topics if topic.name == "/gantry/trajectory")


def test_no_picture_is_dropped_and_speed_changes_nothing(graph: ReplayGraph, replayed: Results) -> None:
    slow = graph.play(rate=1.0, duration_s=BEGINNING_S)
    pictures = replay.pictures(BEGINNING_S)
    for side in replay.SIDES:
        assert sorted(slow.corners[side]) == pictures[side]
        assert set(pictures[side]) <= set(replayed.corners[side])
        for stamp, corners in slow.corners[side].items():
            assert np.array_equal(corners, replayed.corners[side][stamp])
    assert slow.tips and slow.planes
    for mine, whole in ((slow.tips, replayed.tips), (slow.planes, replayed.planes)):
        last = max(pictures["left"])
        assert sorted(mine) == sorted(stamp for stamp in whole if stamp <= last)
        assert all(np.array_equal(value, whole[stamp]) for stamp, value in mine.items())


def test_a_changed_parameter_shows(replayed: Results, graph: ReplayGraph) -> None:
    graph.set_parameter("/stereo/left/corners_left", "k", 0.2)
    changed = graph.play(duration_s=1.0)
    mixed = replay.with_corners(replayed, changed)
    text = difference(mixed, "changed_k.png")
    print(text)
    first = min(EXPECTED["corners"]["left"], key=int)
    assert "corners, count, left picture 0" in text and str(EXPECTED["corners"]["left"][first]["count"]) in text
    assert "right" not in text.partition("picture: ")[0] and "goal" not in text
    assert (ARTIFACTS / "changed_k.png").stat().st_size > 10_000
