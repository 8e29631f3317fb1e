"""Forms of bags that other programs write: ROS 1, and MCAP files without an index or without order."""

from __future__ import annotations

import re
import shlex
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from mcap.writer import CompressionType, IndexType, Writer
from rosbags.rosbag1 import Writer as Ros1Writer
from rosbags.typesys import Stores, get_typestore
from support.foreign_bags import FORMS, STRING, bag, text

from icu_bringup.adapters.bag.bag_reader import BagReader
from icu_bringup.adapters.bag.bags import BagError
from icu_bringup.cli import bag_export, bag_info, bag_play
from icu_bringup.nodes.bag_types import type_problem

pytestmark = pytest.mark.slow

START_NS = 1_700_000_000_000_000_000
ROWS = [("/talk" if i % 3 else "/state", START_NS + i * 10_000_000, text(f"{i}")) for i in range(30)]
ROS1 = get_typestore(Stores.ROS1_NOETIC)


def ros1_bag(path: Path) -> Path:
    with Ros1Writer(path) as writer:
        connection = writer.add_connection("/talk", STRING, typestore=ROS1)
        for number in range(5):
            message = ROS1.types[STRING](data=f"{number}")
            writer.write(connection, START_NS + number, ROS1.serialize_ros1(message, STRING))
    return path


@pytest.mark.parametrize("name", ["old.bag", "old"])
@pytest.mark.parametrize("program", [bag_info, bag_play, bag_export], ids=["info", "play", "export"])
def test_a_ros_1_bag_is_recognised_and_the_named_command_converts_it(
    program: object, name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    old = ros1_bag(tmp_path / name)
    more = ["--out", str(tmp_path / "out")] if program is bag_export else []
    assert program.main([str(old), *more]) == 1  # type: ignore[attr-defined]
    error = capsys.readouterr().err
    found = re.fullmatch(
        rf"error: {re.escape(str(old))} is a ROS 1 bag; convert it with: (rosbags-convert .*)\n", error
    )
    assert found, error
    command = shlex.split(found[1])
    command[0] = str(Path(sys.executable).with_name(command[0]))
    if name.endswith(".bag"):  # rosbags knows a bag of ROS 1 by its suffix
        subprocess.run(command, check=True, timeout=100)
        with BagReader(tmp_path / "old_ros2") as new:
            assert [new.decode(data, STRING).data for _, _, data in new.messages(["/talk"])] == list("01234")


MCAP_FORMS = {
    "no chunks": {"use_chunking": False},
    "no message index": {"index_types": IndexType.ALL ^ IndexType.MESSAGE},
    "no chunk index": {"index_types": IndexType.ALL ^ IndexType.CHUNK},
    "no index": {"index_types": IndexType.NONE},
    "no statistics": {"use_statistics": False},
    "no summary": {
        "index_types": IndexType.NONE,
        "use_statistics": False,
        "use_summary_offsets": False,
        "repeat_channels": False,
        "repeat_schemas": False,
    },
    "no chunks, no summary": {
        "use_chunking": False,
        "index_types": IndexType.NONE,
        "use_statistics": False,
        "use_summary_offsets": False,
        "repeat_channels": False,
        "repeat_schemas": False,
    },
}
mcap_forms = pytest.mark.parametrize("form", MCAP_FORMS)


def mcap_file(file: Path, rows: Sequence[tuple[str, int, bytes]], form: str, compression: CompressionType) -> Path:
    with file.open("wb") as stream:
        writer = Writer(stream, chunk_size=300, compression=compression, **MCAP_FORMS[form])
        writer.start("ros2", "test")
        schema = writer.register_schema(STRING, "ros2msg", b"string data\n")
        channels = {name: writer.register_channel(name, "cdr", schema) for name in sorted({row[0] for row in rows})}
        for name, stamp_ns, data in rows:
            writer.add_message(channels[name], stamp_ns, data, stamp_ns)
        writer.finish()
    return file


@mcap_forms
@pytest.mark.parametrize("compression", [CompressionType.NONE, CompressionType.ZSTD], ids=["plain", "zstd"])
def test_an_mcap_file_without_an_index_or_order_is_read_whole_and_in_order(
    tmp_path: Path, form: str, compression: CompressionType
) -> None:
    """rosbag2's storage options noChunking, noMessageIndex and noSummary; a recorder writes as messages come."""
    order = [1, 0, 2, 4, 3, *range(29, 4, -1)]
    file = mcap_file(tmp_path / "bag.mcap", [ROWS[i] for i in order], form, compression)
    with BagReader(file) as found:
        assert found.count == 30 and found.start_ns == START_NS and found.duration_ns == 290_000_000
        assert {topic.name: topic.count for topic in found.topics} == {"/state": 10, "/talk": 20}
        assert list(found.messages()) == ROWS
        assert list(found.messages(["/state"])) == [row for row in ROWS if row[0] == "/state"]
        limits = START_NS + 50_000_000, START_NS + 90_000_000
        assert list(found.messages(None, *limits)) == ROWS[5:9]
        times = found.times()
    for topic in ("/talk", "/state"):
        assert times[topic].tolist() == [row[1] for row in ROWS if row[0] == topic]


@pytest.mark.parametrize("form", FORMS, ids="-".join)
def test_times_of_messages_are_those_of_the_rows(tmp_path: Path, form: tuple[str, str]) -> None:
    with BagReader(bag(tmp_path / "bag", form, ROWS, kinds={"/empty": STRING})) as found:
        times = found.times()
    assert {topic: stamps.tolist() for topic, stamps in times.items()} == {
        topic: [row[1] for row in ROWS if row[0] == topic] for topic in ("/talk", "/state")
    }
    assert all(stamps.dtype == np.int64 for stamps in times.values())


def test_an_overview_reads_only_the_messages_about_goals(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A damaged message does not change it; --check reads all messages and finds the damage."""
    command = ("/gantry/command", START_NS, text("press:RUN_STOP id=a1"))
    file = mcap_file(tmp_path / "bag.mcap", [command, *ROWS], "no statistics", CompressionType.NONE)
    assert bag_info.main([str(file)]) == 0
    whole = capsys.readouterr().out
    assert "goals: 1, without results: the bag lacks /gantry/result" in whole and "press:RUN_STOP" in whole
    data = bytearray(file.read_bytes())
    data[data.index(ROWS[20][2]) + 8] ^= 0xFF
    file.write_bytes(data)
    assert bag_info.main([str(file)]) == 0
    assert capsys.readouterr().out == whole
    assert bag_info.main([str(file), "--check"]) == 1
    assert "broken" in capsys.readouterr().err


def test_a_broken_index_is_an_error_with_advice(tmp_path: Path) -> None:
    file = mcap_file(tmp_path / "bag.mcap", ROWS, "no statistics", CompressionType.NONE)
    with BagReader(file) as found:
        chunk = found._reader.storage.chunks[1]  # type: ignore[union-attr]
    data = bytearray(file.read_bytes())
    data[chunk.chunk_start_offset + chunk.chunk_length] = 0x33
    file.write_bytes(data)
    with BagReader(file) as found, pytest.raises(BagError, match=r"broken: The message index .* is invalid.*--repair"):
        found.times()


def test_an_empty_definition_is_none(tmp_path: Path) -> None:
    """A recorder that does not find a definition writes an empty text; the type was reported as a changed one."""
    folder = bag(tmp_path / "bag", ("humble", "mcap"), ROWS, definitions={STRING: ""})
    with BagReader(folder) as found:
        assert {topic.hash for topic in found.topics} == {""}
        assert [type_problem(found, topic) for topic in found.topics] == ["", ""]
