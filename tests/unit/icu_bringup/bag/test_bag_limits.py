"""Messages that an overloaded recorder leaves out; bags in several files, or with compressed chunks."""

from __future__ import annotations

import struct
import threading
from pathlib import Path

import pytest
import yaml
from mcap.reader import make_reader
from support.foreign_bags import STRING, text

from icu_bringup.adapters.bag.bag_reader import BagReader
from icu_bringup.adapters.bag.bag_sink import BagSink
from icu_bringup.adapters.bag.bag_writer import BagWriter
from icu_bringup.adapters.bag.bags import BagError, BagTopic
from icu_bringup.core.bag.image_gate import ImageGate, other_side

LEFT, RIGHT = "/stereo/left/image_raw", "/stereo/right/image_raw"
IMAGE = "sensor_msgs/msg/Image"
MB = 1 << 20


def image(stamp_ms: int, size: int = MB) -> bytes:
    return b"\0\1\0\0" + struct.pack("<II", stamp_ms // 1000, stamp_ms % 1000 * 1_000_000) + bytes(size - 12)


def test_a_side_is_found_by_a_whole_part_of_the_name() -> None:
    assert other_side(LEFT) == RIGHT and other_side(RIGHT) == LEFT
    assert other_side("/leftover/image") == other_side("/eye") == ""


@pytest.mark.parametrize(("waiting", "every"), [(0.5, 1), (0.8, 2), (0.9, 3), (0.95, 4)])
def test_whole_pairs_are_left_out_evenly(waiting: float, every: int) -> None:
    gate, room = ImageGate(), 1000 * MB
    kept: dict[str, list[int]] = {LEFT: [], RIGHT: []}
    for number in range(24):
        for topic in (LEFT, RIGHT):
            if not gate.decide(topic, image(33 * number), round(waiting * room), room, {LEFT, RIGHT}):
                kept[topic].append(number)
    assert kept[LEFT] == kept[RIGHT] == list(range(0, 24, every))


def test_no_half_pair_is_kept_where_only_one_image_has_room() -> None:
    gate = ImageGate()
    assert gate.decide(LEFT, image(5), 0, 3 * MB // 2, {LEFT, RIGHT}) == "room"
    assert gate.decide(RIGHT, image(5), 0, 3 * MB // 2, {LEFT, RIGHT}) == "room"
    assert gate.decide(LEFT, image(6), 0, 3 * MB // 2, {LEFT}) == ""


@pytest.mark.parametrize("limited", [LEFT, RIGHT])
def test_a_rate_is_kept_by_the_stamps_of_both_sides(limited: str) -> None:
    gate = ImageGate({limited: 10.0})
    decided = [[gate.decide(t, image(33 * n), 0, 100 * MB, {LEFT, RIGHT}) for t in (RIGHT, LEFT)] for n in range(31)]
    assert all(one == other for one, other in decided)
    assert sum(one == "" for one, _ in decided) == 10 and {one for one, _ in decided} == {"", "rate"}


@pytest.mark.parametrize("room", [16, 18], ids="{} MB".format)
def test_a_slow_disk_loses_whole_pairs_and_counts_each_topic(tmp_path: Path, room: int) -> None:
    """Seven eighths of the second room fit 15 images, so that the last pair would lose its right image."""
    gate = threading.Event()

    def opened() -> BagWriter:
        writer = BagWriter(tmp_path / "bag", keep_free=0)
        add = writer.add_topic

        def waits(topic: BagTopic) -> None:
            gate.wait()
            add(topic)

        writer.add_topic = waits  # type: ignore[method-assign]
        return writer

    sink = BagSink(opened, limit_bytes=room * MB)
    for topic in (LEFT, RIGHT):
        sink.add_topic(BagTopic(name=topic, type=IMAGE))
    for number in range(30):
        for topic in (LEFT, RIGHT):
            sink.put(topic, number, image(33 * number))
    gate.set()
    sink.close()
    with BagReader(tmp_path / "bag") as bag:
        kept = {topic: [ns for _, ns, _ in bag.messages([topic])] for topic in (LEFT, RIGHT)}
    assert kept[LEFT] == kept[RIGHT] and 5 <= len(kept[LEFT]) <= 8 and not sink.failure
    assert sink.dropped_by_topic == {LEFT: 30 - len(kept[LEFT]), RIGHT: 30 - len(kept[RIGHT])}
    assert sink.dropped == 60 - sink.messages


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
@pytest.mark.parametrize("limit", [{"split_ns": 100}, {"split_bytes": 10 * len(text("00"))}], ids=["time", "size"])
def test_a_bag_in_several_files_is_read_as_one(tmp_path: Path, storage: str, limit: dict[str, int]) -> None:
    rows = [("/a", 1000 + 10 * i, text(f"{i:02}")) for i in range(35)]
    with BagWriter(tmp_path / "bag", storage, keep_free=0, **limit) as writer:  # type: ignore[arg-type]
        for name in ("/a", "/silent"):
            writer.add_topic(BagTopic(name=name, type=STRING))
        for row in rows:
            writer.write(*row)
    described = yaml.safe_load((tmp_path / "bag" / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    suffix = "mcap" if storage == "mcap" else "db3"
    assert described["relative_file_paths"] == [f"bag_{i}.{suffix}" for i in range(4)]
    assert [part["message_count"] for part in described["files"]] == [10, 10, 10, 5]
    starts = [part["starting_time"]["nanoseconds_since_epoch"] for part in described["files"]]
    assert starts == [1000, 1100, 1200, 1300]
    assert (described["message_count"], described["duration"]) == (35, {"nanoseconds": 340})
    with BagReader(tmp_path / "bag") as bag:
        assert list(bag.messages()) == rows and bag.check() == 35
        assert [(topic.name, topic.count) for topic in bag.topics] == [("/a", 35), ("/silent", 0)]
    for file in (tmp_path / "bag").glob("*.mcap"):
        with file.open("rb") as stream:
            seen = [m.data for _, _, m in make_reader(stream, validate_crcs=True).iter_messages()]
        number = int(file.stem[-1])
        assert seen == [data for _, _, data in rows[10 * number : 10 * number + 10]]


def test_compressed_chunks_are_read_by_the_official_library(tmp_path: Path) -> None:
    rows = [("/eye", i, image(i)) for i in range(5)]
    with BagWriter(tmp_path / "bag", keep_free=0, zstd_chunks=True) as writer:
        writer.add_topic(BagTopic(name="/eye", type=IMAGE))
        for row in rows:
            writer.write(*row)
    file = tmp_path / "bag" / "bag.mcap"
    assert file.stat().st_size < MB
    with file.open("rb") as stream:
        seen = [(c.topic, m.log_time, m.data) for _, c, m in make_reader(stream, validate_crcs=True).iter_messages()]
    assert seen == rows
    with BagReader(tmp_path / "bag") as bag:
        assert list(bag.messages()) == rows
    with pytest.raises(BagError, match="not sqlite3"):
        BagWriter(tmp_path / "other", "sqlite3", zstd_chunks=True)


def test_a_rate_of_what_is_small_is_kept_by_the_time_of_reception(tmp_path: Path) -> None:
    sink = BagSink(lambda: BagWriter(tmp_path / "bag", keep_free=0), rates_hz={"/a": 10.0})
    for name in ("/a", "/b"):
        sink.add_topic(BagTopic(name=name, type=STRING))
        for number in range(30):
            sink.put(name, 10_000_000 * number, text(f"{number}"))
    sink.close()
    with BagReader(tmp_path / "bag") as bag:
        assert [bag.decode(data, STRING).data for _, _, data in bag.messages(["/a"])] == ["0", "10", "20"]
        assert len(list(bag.messages(["/b"]))) == 30
    assert (sink.thinned, sink.dropped) == (27, 0)
