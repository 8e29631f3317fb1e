"""Foreign bags are read completely: QoS and times in metadata.yaml exclude no message."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml
from rosbags.interfaces import QosDurability, QosReliability
from support.foreign_bags import FORMS, STRING, STRING_HASH, bag, text

from icu_bringup.adapters.bag.bag_reader import BagReader
from icu_bringup.adapters.bag.bags import BagTopic
from icu_bringup.cli.bag_info import description
from icu_bringup.core.bag.account import Account
from icu_bringup.core.bag.sequence_gaps import SequenceGaps

START_NS = 1_700_000_000_000_000_000
ROWS = [("/talk" if i % 3 else "/state", START_NS + i * 10_000_000, text(f"{i}")) for i in range(30)]
forms = pytest.mark.parametrize("form", FORMS, ids="-".join)


@forms
def test_the_qos_of_metadata_wins_and_hides_no_message(tmp_path: Path, form: tuple[str, str]) -> None:
    edited = {"/state": {"durability": 1, "depth": 1}, "/talk": {"reliability": 2}}
    with BagReader(bag(tmp_path / "bag", form, ROWS, metadata_qos=edited)) as found:
        assert list(found.messages()) == ROWS
        assert [(t.name, t.count, t.announced) for t in found.topics] == [("/state", 10, 10), ("/talk", 20, 20)]
        profiles = {t.name: [(q.reliability, q.durability) for q in t.qos] for t in found.topics}
        assert found.check() == 30
    assert profiles == {
        "/state": [(QosReliability.RELIABLE, QosDurability.TRANSIENT_LOCAL)],
        "/talk": [(QosReliability.BEST_EFFORT, QosDurability.VOLATILE)],
    }


@forms
def test_a_starting_time_after_the_first_message_hides_none(tmp_path: Path, form: tuple[str, str]) -> None:
    with BagReader(bag(tmp_path / "bag", form, ROWS, starting_ns=START_NS + 200_000_000)) as found:
        assert (found.start_ns, found.duration_ns, found.count) == (START_NS, 290_000_000, 30)
        assert list(found.messages()) == ROWS


@forms
def test_a_topic_that_metadata_does_not_name_is_read(tmp_path: Path, form: tuple[str, str]) -> None:
    folder = bag(tmp_path / "bag", form, ROWS)
    described = yaml.safe_load((folder / "metadata.yaml").read_text())
    topics = described["rosbag2_bagfile_information"]["topics_with_message_count"]
    topics[:] = [topic for topic in topics if topic["topic_metadata"]["name"] != "/talk"]
    topics[0]["message_count"] = 12
    (folder / "metadata.yaml").write_text(yaml.safe_dump(described))
    with BagReader(folder) as found:
        assert list(found.messages()) == ROWS
        assert [(t.name, t.count, t.announced) for t in found.topics] == [("/state", 10, 12), ("/talk", 20, 0)]
        assert "metadata.yaml lists 12 messages, the files have 10" in description(found)


@forms
def test_the_hash_of_a_definition_is_known_where_the_bag_has_one(tmp_path: Path, form: tuple[str, str]) -> None:
    with BagReader(bag(tmp_path / "bag", form, ROWS)) as found:
        known = {topic.hash for topic in found.topics}
    assert known == ({""} if form == ("humble", "sqlite3") else {STRING_HASH})


def test_two_channels_of_one_topic_in_a_file_are_one_topic(tmp_path: Path) -> None:
    """Two publishers with different QoS write such a file."""
    from mcap.writer import Writer

    file = tmp_path / "two.mcap"
    with file.open("wb") as stream:
        writer = Writer(stream)
        writer.start("ros2", "test")
        schema = writer.register_schema(STRING, "ros2msg", b"string data\n")
        for number, qos in enumerate(("", "[]")):
            channel = writer.register_channel("/talk", "cdr", schema, {"offered_qos_profiles": qos})
            writer.add_message(channel, START_NS + number, text(f"{number}"), START_NS)
        writer.finish()
    with BagReader(file) as found:
        assert [(topic.name, topic.count) for topic in found.topics] == [("/talk", 2)]
        assert [row[1] - START_NS for row in found.messages(["/talk"])] == [0, 1]


def test_topics_of_one_name_and_two_types_are_read_apart(tmp_path: Path) -> None:
    from mcap.writer import Writer

    file = tmp_path / "two.mcap"
    with file.open("wb") as stream:
        writer = Writer(stream)
        writer.start("ros2", "test")
        for number, (kind, definition) in enumerate(((STRING, b"string data\n"), ("lab_msgs/msg/A", b"string a\n"))):
            schema = writer.register_schema(kind, "ros2msg", definition)
            writer.add_message(writer.register_channel("/talk", "cdr", schema), number, text(f"{number}"), number)
        writer.finish()
    with BagReader(file) as found:
        assert [(topic.type, topic.count) for topic in found.topics] == [("lab_msgs/msg/A", 1), (STRING, 1)]
        chosen = [BagTopic(name="/talk", type=STRING)]
        assert list(found.messages(chosen)) == [("/talk", 0, text("0"))]


def test_an_account_is_complete_without_losses_and_with_allowed_ones() -> None:
    account = Account(["/allowed"])
    assert account.complete and account.lines() == []
    account.miss("/allowed", "too fast", 2, 10)
    account.miss("/allowed", "too fast", 1, 12)
    assert account.complete and account.lines() == ["missing: /allowed: 3 of 12 messages: too fast (allowed)"]
    account.miss("/other", "no room")
    assert not account.complete and account.count == 4
    assert account.lines()[1] == "missing: /other: 1 message: no room"


@pytest.mark.parametrize(
    ("numbers", "publishers", "lost"),
    [
        ([7, 8, 9], 1, 0),
        ([7, 8, 12, 13], 1, 3),
        ([7, 10, 8, 11], 1, 1),
        ([5, 6, 1, 2, 4], 1, 1),
        ([1, 1, 2, 2, 3], 2, 0),
        ([1, 41, 2, 43, 3], 2, 1),
    ],
    ids=["whole", "gap", "out of order", "restarted", "two publishers", "two publishers, a gap"],
)
def test_gaps_in_the_numbers_of_a_publisher_are_losses(numbers: list[int], publishers: int, lost: int) -> None:
    gaps = SequenceGaps()
    for number in numbers:
        gaps.add(number, publishers)
    assert gaps.lost == lost
